"""Publish and take through a channel: from Python, from C, against plain copies of the same bytes.

usage: python benchmarks/bench_channel.py [--rounds N] [--json]

Part one is one process: nobody waits, every cost is that of the call. A publication is compared with
memcpy (C; in Python an assignment between memoryviews, which is memcpy) into as many rotating
buffers as the channel has slots; publication and taking together with a copy in and a copy out. Part
two is two processes that hand 200 bytes to each other and back, spinning, each on its own core,
against a bare exchange: a flag, and a copy. It needs two cores and a C compiler.
"""

from __future__ import annotations

import json
import os
import secrets
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks import measure
from rosplc.shm import Description, Direction, Namespace, OwnedChannel, Reader

HERE = Path(__file__).resolve().parent
CORE = HERE.parent / "src" / "rosplc" / "include"
SIZES = {"200 B": (200, 4000), "4 KiB": (4096, 2000), "64 KiB": (65536, 250), "1 MiB": (1 << 20, 25)}
SLOTS = 4
EXCHANGED = 200
EXCHANGE_BATCH = 200  # round trips; short, so that most batches meet no other process

Measured = dict[str, list[float]]


@contextmanager
def channels() -> Iterator[Callable[[str, int], OwnedChannel]]:
    """Give a function that makes objects, which are gone at the end."""
    namespace = Namespace(f"bench-{secrets.token_hex(4)}")
    with ExitStack() as stack:

        def make(topic: str, size: int) -> OwnedChannel:
            about = Description(
                topic, "std_msgs/msg/Empty", "jazzy", Direction.TO_PLC, {}, "0" * 16, "bench", "uint8 x"
            )
            channel = OwnedChannel.open(namespace, about, record_size=size, slots=SLOTS)
            stack.callback(namespace.lock_path(topic).unlink)
            stack.callback(channel.retire)
            return channel

        yield make


@contextmanager
def native(program: Path, *arguments: object, prefix: str = "C, ") -> Iterator[Callable[[], Measured]]:
    """Run the C program; give a function that lets it measure once and puts a prefix before its names."""
    process = subprocess.Popen(
        [str(program), *map(str, arguments)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert process.stdin is not None and process.stdout is not None

    def once() -> Measured:
        assert process.stdin is not None and process.stdout is not None
        process.stdin.write("\n")
        process.stdin.flush()
        found = json.loads(process.stdout.readline())
        return {
            f"{prefix}{key}": value if isinstance(value, list) else [value] for key, value in found.items()
        }

    try:
        yield once
    finally:
        process.stdin.close()
        process.wait()
        process.stdout.close()


def build(folder: Path) -> Path | None:
    """Compile the C loop; None without a compiler."""
    compiler = shutil.which("gcc") or shutil.which("cc")
    if compiler is None:
        return None
    program = folder / "channel_loop"
    subprocess.run([compiler, "-O2", "-I", CORE, "-o", program, HERE / "channel_loop.c"], check=True)
    return program


def python_side(channel: OwnedChannel, size: int, batch: int) -> Callable[[], Measured]:
    """Return a function that measures the Python side once."""
    writer, reader = channel.writer(), channel_reader(channel)
    record, out = bytes(range(256)) * (size // 256 + 1), bytearray(size)
    record = record[:size]
    buffers = [memoryview(bytearray(size)) for _ in range(SLOTS)]
    into = memoryview(out)
    publish, latest = writer.publish, reader.latest
    turn = 0

    def copy_in() -> None:
        nonlocal turn
        turn = (turn + 1) % SLOTS
        buffers[turn][:] = record

    def copy_in_and_out() -> None:
        copy_in()
        into[:] = buffers[turn]

    def publish_and_take() -> None:
        publish(record)
        if latest(out) is None:
            raise AssertionError("a message just published was not there")

    def once() -> Measured:
        return {
            "Python, copy in": [measure.mean_ns(copy_in, batch)],
            "Python, publish": [measure.mean_ns(lambda: publish(record), batch)],
            "Python, copy in and out": [measure.mean_ns(copy_in_and_out, batch)],
            "Python, publish and take": [measure.mean_ns(publish_and_take, batch)],
            "Python, an empty call": [measure.mean_ns(lambda: None, batch)],
        }

    return once


def channel_reader(channel: OwnedChannel) -> Reader:
    """Return an observer of the channel."""
    return Reader(channel.region, channel.snapshot().writer.head)


def operations(program: Path | None, rounds: int) -> list[dict[str, Any]]:
    """Measure one process, size by size."""
    tables = []
    for name, (size, batch) in SIZES.items():
        with channels() as make, ExitStack() as stack:
            contenders = {"Python": python_side(make("/python", size), size, batch)}
            if program is not None:
                path = make("/c", size).path
                contenders["C"] = stack.enter_context(native(program, "operations", path, batch))
            values = measure.turns(contenders, rounds)
        base = values.get("C, copy in", values["Python, copy in"])
        both = values.get("C, copy in and out", values["Python, copy in and out"])
        rows = []
        for key, found in sorted(values.items()):
            against = both if key.endswith(("out", "take")) else base
            speed = None if "empty" in key else measure.median_ratio(against, found)
            rows.append(measure.row(key, found, speed=speed))
        tables.append(
            measure.table(f"{name}, one process; speed: memcpy in C is 1", "ns", "nobody waits", rows)
        )
    return tables


def exchange(program: Path, rounds: int) -> dict[str, Any]:
    """Measure the round trip between two processes."""
    first, second = sorted(os.sched_getaffinity(0))[:2]
    with channels() as make:
        paths = make("/forth", EXCHANGED).path, make("/back", EXCHANGED).path
        with native(program, "exchange", *paths, EXCHANGE_BATCH, first, second) as once:
            values = measure.turns({"C": once}, rounds)
    bare = values["C, flag and copy"]
    rows = [measure.row(key, found, ratio=measure.median_ratio(found, bare)) for key, found in values.items()]
    return measure.table(
        f"{EXCHANGED} B there and back, two processes",
        "ns",
        f"both spin, on cores {first} and {second}",
        rows,
    )


def run(rounds: int) -> dict[str, Any]:
    """Measure in ``rounds`` rounds; returns a :func:`measure.report`."""
    before = measure.environment()
    with tempfile.TemporaryDirectory() as folder:
        program = build(Path(folder))
        tables = []
        if program is not None and len(os.sched_getaffinity(0)) > 1:
            tables.append(exchange(program, rounds))
        tables += operations(program, rounds)
    return measure.report(tables, before)


if __name__ == "__main__":
    measure.main(run, __doc__, 40)
