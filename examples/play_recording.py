"""Play a recording onto ROS 2 topics, as a program of its own that knows nothing of the bridge.

    python examples/play_recording.py FILE.bag --speed 2 --topic /turtle1/pose --wait 10

ROS 1 recordings are translated into ROS 2 types; what is mapped or dropped is printed.
"""

from __future__ import annotations

import argparse
import sys
import time

from rosplc.errors import RosplcError
from rosplc.model import TypeStore
from rosplc.ros import open_backend
from rosplc.ros.backend import Qos
from rosplc.ros.recording import Recording


def main() -> int:
    """Play the recording that the command line names."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("file", help="the recording: a .bag, or the folder of a ROS 2 recording")
    parser.add_argument("--distro", default="jazzy", help="whose message definitions hold on the wire")
    parser.add_argument("--speed", type=float, default=1.0, help="1 is as recorded, 0 as fast as possible")
    parser.add_argument("--topic", action="append", default=[], help="only this topic (may be repeated)")
    parser.add_argument(
        "--wait", type=float, default=30.0, help="seconds to wait for a subscriber of each topic"
    )
    parser.add_argument("--linger", type=float, default=2.0, help="seconds to stay after the last message")
    arguments = parser.parse_args()

    with Recording(arguments.file, arguments.distro) as recording:
        topics = {n: t for n, t in recording.topics.items() if not arguments.topic or n in arguments.topic}
        store = TypeStore.bundled(arguments.distro)
        for topic in topics.values():
            for note in topic.notes:
                print(f"{topic.name}: {note}")
            if not topic.bundled:
                store = store.with_definition(topic.type_name, topic.definition)
                print(f"{topic.name}: {topic.type_name} is defined by the recording")
        backend = open_backend("dds", store, "player")
        qos = Qos(reliability="reliable", durability="transient_local", depth=1000)
        publishers = {name: backend.advertise(name, topic.type_name, qos) for name, topic in topics.items()}
        deadline = time.monotonic() + arguments.wait
        while not all(p.matched for p in publishers.values()):
            if time.monotonic() > deadline:
                missing = ", ".join(name for name, p in publishers.items() if not p.matched)
                print(f"nobody subscribes to {missing}", file=sys.stderr)
                return 1
            time.sleep(0.02)
        start_wall, start_recorded, count = time.monotonic(), None, 0
        for message in recording.messages():
            if message.topic not in publishers:
                continue
            if start_recorded is None:
                start_recorded = message.time_ns
            if arguments.speed > 0:
                due = start_wall + (message.time_ns - start_recorded) / 1e9 / arguments.speed
                time.sleep(max(0.0, due - time.monotonic()))
            publishers[message.topic].write(message.cdr, message.time_ns)
            count += 1
        time.sleep(arguments.linger)
        backend.close()
    print(f"played {count} messages on {len(publishers)} topics")
    return 0


if __name__ == "__main__":
    try:
        sys.exit(main())
    except RosplcError as error:
        sys.exit(str(error))
