"""A DDS program that shares no code with rosplc: it prints each Twist of a ROS topic as JSON.

    python listener.py /turtle1/plc_cmd_vel

It uses the typed interface of Cyclone DDS' Python package, which decodes by itself. (No lazy
annotations here: that package reads them as they stand.)
"""

import json
import os
import sys
import threading
import time
from dataclasses import dataclass

os.environ.setdefault(
    "CYCLONEDDS_URI",
    "<CycloneDDS><Domain><General><Interfaces><NetworkInterface name='lo' multicast='false'/></Interfaces>"
    "<AllowMulticast>false</AllowMulticast></General><Discovery><ParticipantIndex>auto</ParticipantIndex>"
    "<MaxAutoParticipantIndex>60</MaxAutoParticipantIndex><Peers><Peer Address='127.0.0.1'/></Peers>"
    "</Discovery></Domain></CycloneDDS>",
)

from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct, types
from cyclonedds.idl.annotations import final
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic


@final
@dataclass
class Vector3(IdlStruct, typename="geometry_msgs.msg.dds_.Vector3_"):
    x: types.float64
    y: types.float64
    z: types.float64


@final
@dataclass
class Twist(IdlStruct, typename="geometry_msgs.msg.dds_.Twist_"):
    linear: Vector3
    angular: Vector3


def main() -> None:
    participant = DomainParticipant(int(os.environ.get("ROS_DOMAIN_ID", "0")))
    qos = Qos(
        Policy.Reliability.Reliable(1_000_000_000),
        Policy.Durability.TransientLocal,
        Policy.History.KeepAll,
        Policy.DataRepresentation(use_cdrv0_representation=True),
    )
    reader = DataReader(participant, Topic(participant, "rt" + sys.argv[1], Twist), qos)
    stop = threading.Event()
    threading.Thread(target=lambda: (sys.stdin.readline(), stop.set()), daemon=True).start()
    heard: list[tuple[float, float]] = []
    announced = False
    quiet = 0.0
    while not stop.is_set() or quiet < 1.0:
        samples = reader.take(1000)
        heard.extend((sample.linear.x, sample.angular.z) for sample in samples)
        if not announced and reader.get_matched_publications():
            announced = True
            print("matched", flush=True)
        time.sleep(0.01)
        quiet = 0.0 if samples else quiet + 0.01
    print(json.dumps(heard), flush=True)


if __name__ == "__main__":
    main()
