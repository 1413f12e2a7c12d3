"""The PLC's half for bench_classic.py: the same message through classic memory and through a channel.

    python -m benchmarks.classic_peers plc ORDERS_JSON

Orders are JSON documents, one a line. ``{"do": "read", "seconds": S, "hold_us": H}`` looks for new messages
every 0.1 ms, and every 10 ms stays inside the classic lock for H microseconds, as a task does that is
preempted there; it answers with the ages. ``{"do": "write", "kind": K, "topics": N, "rate": R, "count": C,
"hold_us": H}`` writes into the first N memories or channels.
"""

from __future__ import annotations

import json
import struct
import sys
import time
from collections.abc import Callable
from typing import Any

from rosplc.shm import Direction, Namespace, attach
from rosplc.shm.classic import ClassicObject, Entry

STAMP = struct.Struct("<q")
HOLD_EVERY_NS = 10_000_000
SCAN_S = 0.0001


def say(**what: Any) -> None:
    """Answer."""
    print(json.dumps(what), flush=True)


def classic(name: str, size: int) -> ClassicObject:
    """Open a classic memory as its peer."""
    made = ClassicObject(name, name, size, write=True, recover_after_ns=10**12)
    made.attach()
    return made


def enter(memory: ClassicObject) -> None:
    """Take the lock, however long that takes."""
    while memory.enter(0) is not Entry.ENTERED:
        pass


def read(order: dict[str, Any], prefix: str, size: int) -> None:
    """Gather the ages of messages of one classic topic and one channel."""
    memory = classic(f"{prefix}-classic-in0", size)
    ages: dict[str, list[float]] = {"classic": [], "channel": []}
    record = bytearray(size)
    with attach(Namespace(prefix), "/channel/in0", direction=Direction.TO_PLC) as attached:
        reader = attached.reader()
        reader.latest(record)
        last, now = memory.peek()[:8], time.monotonic_ns()
        end, hold_at = now + int(order["seconds"] * 1e9), now
        while (now := time.monotonic_ns()) < end:
            if order["hold_us"] and now >= hold_at:
                enter(memory)
                time.sleep(order["hold_us"] / 1e6)
                memory.leave()
                hold_at = now + HOLD_EVERY_NS
            if memory.enter(0) is Entry.ENTERED:
                image = memory.read()
                memory.leave()
                if image is not None and image[:8] != last:
                    last = image[:8]
                    ages["classic"].append((time.monotonic_ns() - STAMP.unpack(last)[0]) / 1000)
            if reader.latest(record) is not None:
                ages["channel"].append((time.monotonic_ns() - STAMP.unpack_from(record)[0]) / 1000)
            time.sleep(SCAN_S)
    memory.close()
    say(ages=ages)


def write(order: dict[str, Any], prefix: str, size: int) -> None:
    """Write stamped messages at a rate."""
    sends: list[Callable[[bytes], None]] = []
    closers: list[Callable[[], None]] = []
    for number in range(order["topics"]):
        if order["kind"] == "classic":
            memory = classic(f"{prefix}-classic-out{number}", size)
            closers.append(memory.close)

            def locked(record: bytes, memory: ClassicObject = memory) -> None:
                enter(memory)
                memory.write(record)
                if order["hold_us"]:
                    time.sleep(order["hold_us"] / 1e6)
                memory.leave()

            sends.append(locked)
        else:
            attached = attach(
                Namespace(prefix), f"/channel/out{number}", direction=Direction.TO_ROS, write=True
            )
            writer = attached.writer(60_000)

            def publish(record: bytes, writer: Any = writer) -> None:
                writer.publish(record)

            sends.append(publish)
            closers.append(attached.close)
    due = time.monotonic()
    for _ in range(order["count"]):
        for send in sends:
            send(STAMP.pack(time.monotonic_ns()) + bytes(size - 8))
        due += 1 / order["rate"]
        time.sleep(max(0.0, due - time.monotonic()))
    for close in closers:
        close()
    say(written=order["count"] * order["topics"])


def main() -> None:
    """Follow orders until there are no more."""
    orders = json.loads(sys.argv[2])
    say(ready=True)
    for line in sys.stdin:
        order = json.loads(line)
        {"read": read, "write": write}[order["do"]](order, orders["prefix"], orders["size"])


if __name__ == "__main__":
    main()
