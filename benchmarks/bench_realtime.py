"""What `realtime:` changes at the PLC while other programs want every processor.

usage: python -m benchmarks.bench_realtime [--rounds N] [--json]

Two bridges run beside each other, one as an ordinary process, one with SCHED_FIFO, locked memory and the
garbage collector off. One publisher sends to both by turns, and one reader, which stands for a PLC task of
1 ms with SCHED_FIFO, measures how old each message is when it finds it; both bridges meet the same machine.
It also measures how late its own scans begin, which is the machine's, and how long they take, which is the
reader's. It is done on the machine as it is and with two endless loops per processor beside it. Publisher
and reader have priorities of their own above the bridge's.
"""

from __future__ import annotations

import os
import secrets
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from benchmarks import measure
from benchmarks.peers import REALTIME_TOPIC, REALTIME_TYPE
from benchmarks.processes import RosGraph, bridge, peers, ros_domain
from rosplc_bench.process import Side

ORDINARY, FIFO = "ordinary", "fifo"
SETTINGS = {ORDINARY: "{}", FIFO: "{policy: fifo, priority: 20, lock_memory: true, gc: off}"}
HOGS_PER_CORE = 2
_HOG = "while True: pass"


def config(name: str, prefix: str) -> str:
    """Return the configuration of one of the bridges."""
    return "\n".join(
        (
            f"bridge: {prefix}",
            f"prefix: {prefix}",
            "ros: {backend: dds, distro: jazzy}",
            f"realtime: {SETTINGS[name]}",
            "topics:",
            f"  {REALTIME_TOPIC.format(name)}: {{type: {REALTIME_TYPE}, to: plc, every: true, slots: 1024}}",
            "",
        )
    )


def permitted() -> bool:
    """Return whether this process may use SCHED_FIFO at all."""
    before = os.sched_getscheduler(0), os.sched_getparam(0)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(60))
    except PermissionError:
        return False
    os.sched_setscheduler(0, *before)
    return True


@contextmanager
def hogs(count: int) -> Iterator[None]:
    """Keep processors busy with endless loops of ordinary priority."""
    running = [subprocess.Popen([sys.executable, "-c", _HOG]) for _ in range(count)]
    try:
        time.sleep(0.2 if running else 0.0)
        yield
    finally:
        for each in running:
            each.kill()
            each.wait()


def one_round(source: Side, plc: Side, rate: int, count: int) -> dict[str, list[float]]:
    """Return the ages in microseconds by bridge."""
    source.ask(f"{rate} {count}")
    time.sleep(0.3)
    ages: dict[str, list[float]] = plc.ask("")["ages"]
    return ages


def table_of(title: str, rounds: list[dict[str, list[float]]]) -> dict[str, Any]:
    """Return a table with the ratio of the 99th percentiles, the median over the rounds."""
    ratio = statistics.median(
        measure.percentile(one[FIFO], 99) / measure.percentile(one[ORDINARY], 99) for one in rounds
    )
    rows = []
    for name, words in ((ORDINARY, "ordinary process"), (FIFO, "SCHED_FIFO 20, memory locked, gc off")):
        values = [value for one in rounds for value in one[name]]
        worst = max(values)
        rows.append(
            {
                **measure.row(words, values),
                "worst": worst,
                "p99_ratio": 1.0 if name == ORDINARY else ratio,
            }
        )
    for name, words in (("late", "a scan of the reader begins late by"), ("scan", "a scan takes")):
        values = [value for one in rounds for value in one[name]]
        rows.append(measure.row(words, values, worst=max(values)))
    return measure.table(title, "µs", "bridge: woken by DDS; PLC: a scan every 1 ms", rows)


def run(rounds: int, rate: int = 200, count: int = 400) -> dict[str, Any]:
    """Measure in ``rounds`` rounds; returns a :func:`measure.report`."""
    if not permitted():
        raise SystemExit("SCHED_FIFO is not permitted (see docs/howto/real-time.md): nothing to compare")
    before = measure.environment()
    prefixes = {name: f"bench-{name[0]}-{secrets.token_hex(4)}" for name in SETTINGS}
    cores = len(os.sched_getaffinity(0))
    loads = {"nothing else started": 0, f"{HOGS_PER_CORE} endless loops per core": HOGS_PER_CORE * cores}
    found: dict[str, list[dict[str, list[float]]]] = {title: [] for title in loads}
    with ExitStack() as stack:
        domain = stack.enter_context(ros_domain())
        for name, prefix in prefixes.items():
            folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
            stack.enter_context(bridge(folder, config(name, prefix), domain))
        plan = {"prefixes": prefixes, **RosGraph(domain).plan()}
        source, plc = stack.enter_context(peers("realtime_source realtime_plc", plan, domain))
        one_round(source, plc, rate, 10)  # everything has run once before anything counts
        for _ in range(rounds):
            for title, number in loads.items():
                with hogs(number):
                    found[title].append(one_round(source, plc, rate, count))
    tables = [table_of(f"Age at the PLC, {rate} Hz, {title}", values) for title, values in found.items()]
    return measure.report(tables, before)


if __name__ == "__main__":
    measure.main(run, __doc__, 5)
