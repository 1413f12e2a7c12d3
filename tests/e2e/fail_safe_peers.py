"""The peers of the fail-safe tests, each a process that may be killed.

    python fail_safe_peers.py plc PREFIX FIRST      reads /cmd, writes /state, both std_msgs/msg/Int32
    python fail_safe_peers.py ros FIRST             publishes /cmd

Numbers count up from FIRST, twenty a second. The PLC prints a line of JSON whenever something that its
program can see has changed.
"""

from __future__ import annotations

import json
import sys
import time
from itertools import count

from rosplc.codec import Codec, Wire
from rosplc.layout import compute_layout
from rosplc.model import TypeStore
from rosplc.ros import DEFAULT, open_backend
from rosplc.virtual_plc import ReadBlock, VirtualPlc, WriteBlock

INT = "std_msgs/msg/Int32"
SAFE = -5


def plc(prefix: str, first: int) -> None:
    layout = compute_layout(TypeStore.bundled("jazzy"), INT)
    read = ReadBlock(
        "/cmd", layout=layout, prefix=prefix, stale_after=0.6, on_stale="value", stale_value={"data": SAFE},
        mode="every", max_per_cycle=100, beat_ms=200,
    )  # fmt: skip
    write = WriteBlock("/state", layout=layout, prefix=prefix, beat_ms=200)
    machine = VirtualPlc()
    task = machine.task("RosTask", interval=0.01)
    numbers = count(first)
    due = 0.0
    seen: dict[str, object] = {}

    @task.program
    def scan() -> None:
        nonlocal due
        for message in read.each():
            mark = " recovered" if read.xRecovered else ""
            print(json.dumps({"new": f"{message.data}{mark}"}), flush=True)
        now = {
            "stale": read.xStale, "alive": read.xPeerAlive, "source": read.xSourcePresent,
            "substituted": read.xSubstituted, "msg": None if read.xNew or read.msg is None else read.msg.data,
        }  # fmt: skip
        if read.xStale and read.msg is not None:
            assert read.msg.data == SAFE, read.msg
        if now["msg"] is None or not read.xStale:
            now["msg"] = "a message"
        if now != seen:
            seen.update(now)
            print(json.dumps({"state": now}), flush=True)
        write.xEnable = write.xReady and time.monotonic() >= due
        if write.xEnable:
            write.msg.data = next(numbers)
            due = time.monotonic() + 0.05
        write()

    with machine:
        while True:
            machine.check()
            time.sleep(0.05)


def ros(first: int) -> None:
    store = TypeStore.bundled("jazzy")
    layout = compute_layout(store, INT)
    codec = Codec(layout, Wire.CDR)
    publisher = open_backend("dds", store, "commander").advertise("/cmd", INT, DEFAULT)
    for number in count(first):
        publisher.write(codec.encode(layout.pack({"data": number})))
        time.sleep(0.05)


if __name__ == "__main__":
    if sys.argv[1] == "plc":
        plc(sys.argv[2], int(sys.argv[3]))
    else:
        ros(int(sys.argv[2]))
