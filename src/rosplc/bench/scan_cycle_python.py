"""The scan-cycle view's two sides in Python, for what has no PLC side in C: OPC UA, and rosplc beside it.

    python -m rosplc.bench.scan_cycle_python task|peer METHOD JSON

Orders and answers are those of ``c/scan_task.c`` and ``c/scan_peer.c``; so is the message of 25 numbers.
Python's own pauses lie in these figures, so they are compared with each other, not with C.
"""

from __future__ import annotations

import asyncio
import json
import logging
import os
import random
import signal
import struct
import sys
import threading
import time
from collections.abc import Callable
from typing import Any, Protocol

from rosplc.bench.end_to_end_child import in_background, say
from rosplc.shm import Reader, Region, Writer
from rosplc.shm.files import read_header

__all__ = ["WORDS", "Ends", "main"]

WORDS = 25
_MESSAGE = struct.Struct(f"<{WORDS}Q")
_SWITCH_S = 50e-6
_URN = "urn:rosplc:scan-cycle"


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
        from asyncua import Server, ua

        self._in, self._out = [0] * WORDS, [0] * WORDS
        self._before: list[int] = [0] * WORDS

        async def add(server: Any, space: int, way: str, values: list[int], index: int) -> None:
            kind = ua.VariantType.UInt64
            node = await server.nodes.objects.add_variable(
                ua.NodeId(f"{way}.{index}", space), f"{space}:{way}{index}", 0, kind
            )
            await node.set_writable()

            def store(_node: Any, _attribute: Any, value: Any) -> None:
                values[index] = value.Value.Value

            server.set_attribute_value_callback(
                node.nodeid, lambda *_: ua.DataValue(ua.Variant(values[index], kind))
            )
            server.set_attribute_value_setter(node.nodeid, store)

        async def serve(ready: Callable[[], None]) -> None:
            server = Server()
            await server.init()
            server.set_endpoint(f"opc.tcp://127.0.0.1:{port}/")
            server.set_security_policy([ua.SecurityPolicyType.NoSecurity])
            space = await server.register_namespace(_URN)
            for way, values in (("in", self._in), ("out", self._out)):
                for index in range(WORDS):
                    await add(server, space, way, values, index)
            async with server:
                ready()
                await asyncio.Event().wait()

        in_background(serve)

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
        self._port = port
        self._loop: asyncio.AbstractEventLoop
        in_background(self._connect)

    async def _connect(self, ready: Callable[[], None]) -> None:
        from asyncua import Client, ua

        self._loop = asyncio.get_running_loop()
        self._kind = ua
        async with Client(f"opc.tcp://127.0.0.1:{self._port}/") as client:
            space = await client.get_namespace_index(_URN)
            self._client = client
            self._forth, self._back = (
                [client.get_node(ua.NodeId(f"{way}.{index}", space)) for index in range(WORDS)]
                for way in ("in", "out")
            )
            ready()
            await asyncio.Event().wait()

    def read(self) -> tuple[int, ...] | None:
        """Read all nodes."""
        done = asyncio.run_coroutine_threadsafe(self._client.read_values(self._back), self._loop)
        return tuple(done.result(10))

    def write(self, words: tuple[int, ...]) -> None:
        """Write all nodes."""
        ua = self._kind
        values = [ua.DataValue(ua.Variant(word, ua.VariantType.UInt64)) for word in words]
        asyncio.run_coroutine_threadsafe(self._client.write_values(self._forth, values), self._loop).result(
            10
        )


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
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    logging.disable(logging.WARNING)
    role, method, plan = sys.argv[1], sys.argv[2], json.loads(sys.argv[3])
    ends: Ends
    if method == "rosplc":
        ends = Channel(plan["out"], plan["in"])
    else:
        ends = Variables(plan["port"]) if role == "task" else Nodes(plan["port"])
    sys.setswitchinterval(_SWITCH_S)
    sender = Sender(ends) if role == "peer" else None
    say(ready=True, port=plan.get("port", 0))
    for line in sys.stdin:
        word, *numbers = line.split()
        if word == "run":
            say(**scans(ends, *map(int, numbers)))
            continue
        assert sender is not None
        if sender.failed is not None:
            raise sender.failed
        sender.cycle_ns = int(numbers[0]) if word == "go" else 0
        say(sent=sender.sent)


if __name__ == "__main__":
    main()
