"""A record of 8 MiB through a channel beside memcpy in and out, from C and from Python.

usage: python -m benchmarks.bench_large [--rounds N] [--json]

One process writes and takes, as in the comparison's sweep of sizes, whose contenders most of these are.
From Python a record is taken as bytes, and into a buffer, which is filled once the copy is known to hold.
Needs gcc.
"""

from __future__ import annotations

import statistics
import tempfile
import time
from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from benchmarks import measure
from benchmarks.bench_dds import interval
from rosplc.shm import OwnedChannel, Reader, Writer
from rosplc_bench.compiling import compile_program
from rosplc_bench.contenders import channels
from rosplc_bench.sweeps import Contender, memcpy_python, program, rosplc_python

SIZE = 8 << 20
REPEATS = 8
PAIRS = {
    "memcpy": ("C", {"C": "rosplc"}),
    "memcpy-python": ("Python", {"Python, as bytes": "bytes", "Python, into a buffer": "rosplc-python"}),
}


def as_bytes(channel: OwnedChannel, size: int) -> Contender:
    """Return the channel from Python: one publication, and one taking as bytes, kept until the next."""
    writer = Writer(channel.region, 0, 1000)
    reader = Reader(channel.region, writer.head)
    record = bytearray(size)
    taken = None

    def measure(count: int) -> Mapping[str, float]:
        nonlocal taken
        record[-1] ^= 1
        began = time.perf_counter_ns()
        for _ in range(count):
            writer.publish(record)
            taken = reader.latest_record()
        spent = time.perf_counter_ns() - began
        if taken is None or taken[0] != record:
            raise RuntimeError("what arrived is not what was sent")
        return {"bytes": spent / count}

    return measure


def run(rounds: int, size: int = SIZE) -> dict[str, Any]:
    """Measure in ``rounds`` rounds; returns a :func:`measure.report`."""
    before = measure.environment()
    found: dict[str, list[float]] = {}
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(dir="/dev/shm")))
        path = channels(folder, 1, size, stack)[0].path
        command = [str(compile_program("sweep", folder)), "payload", str(path), str(size)]
        contenders = [program("sweep payload", command, stack)]
        contenders += [made(channels(folder, 1, size, stack)[0], size) for made in (as_bytes, rosplc_python)]
        contenders.append(memcpy_python(size))
        for _ in range(rounds):
            for contender in contenders:
                contender(2)  # caches and free memory are its own when it counts
                for name, ns in contender(REPEATS).items():
                    found.setdefault(name, []).append(ns / 1000)
    rows = []
    for anchor, (language, ways) in PAIRS.items():
        rows.append(measure.row(f"memcpy, {language}", found[anchor]))
        for way, mine in ways.items():
            speeds = [its / own for its, own in zip(found[anchor], found[mine], strict=True)]
            lowest, highest = interval(speeds)
            more = {"speed": statistics.median(speeds), "lowest": lowest, "highest": highest}
            rows.append(measure.row(f"channel, {way}", found[mine], **more))
    return measure.report([measure.table(f"{size} bytes", "µs in and out", "no waiting", rows)], before)


if __name__ == "__main__":
    measure.main(run, __doc__, 45)
