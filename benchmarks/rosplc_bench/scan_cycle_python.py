"""The scan-cycle view's two sides in Python, for what has no PLC side in C: OPC UA, and rosplc beside it.

    python -m rosplc_bench.scan_cycle_python task|peer METHOD JSON

Requests and answers are those of ``c/scan_task.c`` and ``c/scan_peer.c``; so is the message of 25 numbers.
These figures include Python's own pauses: compare them with each other, not with C.
"""

from __future__ import annotations

import json
import logging
import os
import random
import struct
import sys
import threading
import time
from typing import Any, Protocol

from rosplc.shm import Reader, Region, Writer
from rosplc.shm.files import read_header
from rosplc_bench.process import follow_parent, reply
from rosplc_bench.protocols import OpcUaClient, Variable, serve_opcua

WORDS = 25
_MESSAGE = struct.Struct(f"<{WORDS}Q")
_SWITCH_S = 50e-6


class Ends(Protocol):
    """One side's two calls."""

    def read(self) -> tuple[int, ...] | None:
        """Return the newest message, or None if it is known."""

    def write(self, words: tuple[int, ...]) -> None:
        """Send a message."""


class Channel:
    """rosplc's channel through the C extension."""

    def __init__(self, out: str, into: str) -> None:
        self._writer = Writer(_region(out), 0, 1000)
        region = _region(into)
        self._reader = Reader(region, 0)
        self._reader.claim(0, 0, 1000, "scan")
        self._record = bytearray(_MESSAGE.size)

    def read(self) -> tuple[int, ...] | None:
        """Take the newest record."""
        return _MESSAGE.unpack(self._record) if self._reader.latest(self._record) else None

    def write(self, words: tuple[int, ...]) -> None:
        """Publish a record."""
        self._writer.publish(_MESSAGE.pack(*words))


def _region(path: str) -> Region:
    fd = os.open(path, os.O_RDWR)
    try:
        return Region(fd, read_header(fd)[0], True, path)
    finally:
        os.close(fd)


class Variables:
    """The PLC's side of OPC UA: variables in memory, and a server thread with a node for each."""

    def __init__(self, port: int) -> None:
        self._in, self._out, self._before = ([0] * WORDS for _ in range(3))
        images = {"in": self._in, "out": self._out}
        serve_opcua(
            port,
            [
                Variable(f"{way}.{index}", "UInt64", 0, image, index)
                for way, image in images.items()
                for index in range(WORDS)
            ],
        )

    def read(self) -> tuple[int, ...] | None:
        """Copy the variables one by one."""
        found = [value for value in self._in]  # noqa: C416 - one load each, as a PLC program does
        if found == self._before:
            return None
        self._before = found
        return tuple(found)

    def write(self, words: tuple[int, ...]) -> None:
        """Set the variables one by one."""
        for index, word in enumerate(words):
            self._out[index] = word


class Nodes:
    """The other side of OPC UA: a client that writes and reads all nodes in one request."""

    def __init__(self, port: int) -> None:
        self._opcua = OpcUaClient(port)
        self._forth, self._back = (
            [self._opcua.node(f"{way}.{index}") for index in range(WORDS)] for way in ("in", "out")
        )

    def read(self) -> tuple[int, ...] | None:
        """Read all nodes."""
        return tuple(self._opcua.run(self._opcua.client.read_values(self._back)))

    def write(self, words: tuple[int, ...]) -> None:
        """Write all nodes."""
        values = [self._opcua.value(word, "UInt64") for word in words]
        self._opcua.run(self._opcua.client.write_values(self._forth, values))


def words_of(number: int) -> tuple[int, ...]:
    """Return message ``number``, sent now."""
    return (time.monotonic_ns(), *(number,) * (WORDS - 1))


def sleep_until(due_ns: int) -> None:
    """Sleep until a moment of the monotonic clock."""
    time.sleep(max(0, due_ns - time.monotonic_ns()) / 1e9)


def scans(ends: Ends, cycle_ns: int, count: int, priority: int) -> dict[str, Any]:
    """Run the PLC's task for ``count`` scans, as ``run_scans`` in C does."""
    scheduling = _schedule(priority)
    late, calls, ages = [0] * count, [0] * count, []
    seen = torn = missed = 0
    ends.read()
    now = time.monotonic_ns
    due = now() + cycle_ns
    for scan in range(count):
        sleep_until(due)
        began = now()
        late[scan] = began - due
        words = ends.read()
        taken = now()
        if words is not None:
            seen += 1
            if len(set(words[1:])) != 1:
                torn += 1
            elif words[1]:
                ages.append(taken - words[0])
        back = words_of(scan + 1)
        again = now()
        ends.write(back)
        calls[scan] = (now() - again) + (taken - began)
        due += cycle_ns
        if (over := now() - due) > cycle_ns:
            missed += over // cycle_ns
            due += over // cycle_ns * cycle_ns
    _schedule(0)
    return {
        "scheduling": scheduling,
        "seen": seen,
        "torn": torn,
        "missed": missed,
        "late_ns": late,
        "calls_ns": calls,
        "ages_ns": ages,
    }


def _schedule(priority: int) -> str:
    """Set the task's thread to SCHED_FIFO, or with 0 to SCHED_OTHER; return what it became."""
    policy = os.SCHED_FIFO if priority else os.SCHED_OTHER
    try:
        os.sched_setscheduler(0, policy, os.sched_param(priority))
    except PermissionError:
        return "refused"
    return "SCHED_FIFO" if priority else "SCHED_OTHER"


class Sender:
    """The peer's thread: sends at random times, and reads what the PLC has written."""

    def __init__(self, ends: Ends) -> None:
        self._ends = ends
        self.cycle_ns = 0
        self.sent = 0
        self.failed: BaseException | None = None
        threading.Thread(target=self._run, daemon=True).start()

    def _run(self) -> None:
        due = time.monotonic_ns()
        try:
            while True:
                if not self.cycle_ns:
                    due = time.monotonic_ns() + 1_000_000
                    sleep_until(due)
                    continue
                self.sent += 1
                self._ends.write(words_of(self.sent))
                self._ends.read()
                due = max(due + round(self.cycle_ns * random.uniform(1, 2)), time.monotonic_ns())
                sleep_until(due)
        except BaseException as error:
            self.failed = error


def main() -> None:
    """Run one side until its input ends."""
    follow_parent()
    logging.disable(logging.WARNING)
    role, method, plan = sys.argv[1], sys.argv[2], json.loads(sys.argv[3])
    ends: Ends
    if method == "rosplc":
        ends = Channel(plan["out"], plan["in"])
    else:
        ends = Variables(plan["port"]) if role == "task" else Nodes(plan["port"])
    sys.setswitchinterval(_SWITCH_S)
    sender = Sender(ends) if role == "peer" else None
    reply(ready=True, port=plan.get("port", 0))
    for line in sys.stdin:
        word, *numbers = line.split()
        if word == "run":
            reply(**scans(ends, *map(int, numbers)))
            continue
        assert sender is not None
        if sender.failed is not None:
            raise sender.failed
        sender.cycle_ns = int(numbers[0]) if word == "go" else 0
        reply(sent=sender.sent)


if __name__ == "__main__":
    main()
