"""A record of 8 MiB through a channel beside memcpy in and out, from C and from Python.

usage: python -m benchmarks.bench_large [--rounds N] [--json]

One process writes and takes, as in the comparison's sweep of sizes, whose contenders these are. Needs gcc.
"""

from __future__ import annotations

import tempfile
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from benchmarks import measure
from benchmarks.bench_dds import interval
from rosplc_bench.compiling import compile_program
from rosplc_bench.sweeps import channels, memcpy_python, program, rosplc_python

SIZE = 8 << 20
REPEATS = 20
PAIRS = {"C": ("memcpy", "rosplc"), "Python": ("memcpy-python", "rosplc-python")}


def run(rounds: int, size: int = SIZE) -> dict[str, Any]:
    """Measure in ``rounds`` rounds; returns a :func:`measure.report`."""
    before = measure.environment()
    found: dict[str, list[float]] = {}
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(dir="/dev/shm")))
        path = channels(folder, 1, size, stack)[0].path
        command = [str(compile_program("sweep", folder)), "payload", str(path), str(size)]
        contenders = [program("sweep payload", command, stack)]
        contenders += [rosplc_python(channels(folder, 1, size, stack)[0], size), memcpy_python(size)]
        for _ in range(rounds):
            for contender in contenders:
                for name, ns in contender(REPEATS).items():
                    found.setdefault(name, []).append(ns / 1000)
    rows = []
    for language, (anchor, mine) in PAIRS.items():
        speeds = [its / own for its, own in zip(found[anchor], found[mine], strict=True)]
        lowest, highest = interval(speeds)
        speed = {"speed": measure.median_ratio(found[anchor], found[mine])}
        rows.append(measure.row(f"memcpy, {language}", found[anchor]))
        rows.append(measure.row(f"channel, {language}", found[mine], **speed, lowest=lowest, highest=highest))
    return measure.report([measure.table(f"{size} bytes", "µs in and out", "no waiting", rows)], before)


if __name__ == "__main__":
    measure.main(run, __doc__, 15)
