"""PLC to ROS: how long after the PLC's store the bridge writes, and what looking for news costs.

usage: python -m benchmarks.bench_to_ros [--rounds N] [--json]

The PLC is a C program (plc_tasks.c) whose tasks keep their own time and note in each message when it was
stored. When the bridge hands it to DDS is noted inside the bridge, in C, just before its call of the library
(write_times.c; about 0.1 µs a message, in all contenders); nothing subscribes, so this is the bridge alone.
Two bridges take turns: "fixed grid" looks every tick, as rosplc 0.2.0 did, "predicting" is rosplc. Both run
throughout; where the tasks' phases lie is drawn for each round. Needs gcc.
"""

from __future__ import annotations

import ctypes
import mmap
import random
import resource
import secrets
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks import measure
from benchmarks.bench_bridge import TYPE, load_config
from benchmarks.bench_dds import interval
from benchmarks.processes import bridge, ros_domain
from rosplc.cli import main as rosplc
from rosplc.codec import Codec
from rosplc.demo.processes import remove_objects
from rosplc.layout import compute_layout
from rosplc.model import TypeStore
from rosplc.shm import Direction, Group, Namespace
from rosplc_bench.compiling import CORE, FLAGS, SOURCES
from rosplc_bench.process import Side, cpu_clock
from tests.lib.channels import open_channel

HERE = Path(__file__).resolve().parent
MODES = ("fixed grid", "predicting")
MS = 1_000_000
JITTER_NS = 50_000
# By name: the tasks' periods in ns and how many topics each writes.
CASES = {"tasks of 4 and 9.798 ms": ((4 * MS, 5), (9_797_959, 5)), "one topic at 100 Hz": ((10 * MS, 1),)}
Times = tuple[float, float]
TIMES = (1.5, 2.0)  # seconds: until the figures of a round begin, and how long they are taken
QUIET = (200, 1000)
ACTIVE = (50, 500, 1000)
SPREAD = ((50, 1), (500, 10), (500, 5), (1000, 10))  # topics, and the scans in which each is written once
MOST = 1 << 20  # as in write_times.c


def compile_all(folder: Path) -> tuple[Path, Path]:
    """Return the PLC and the library that notes times."""
    compiler = shutil.which("gcc")
    if compiler is None:
        raise RuntimeError("Debian package gcc is missing")
    plc, notes = folder / "plc_tasks", folder / "write_times.so"
    core = CORE.parent / "_core"
    for made, source, *more in (
        (plc, "plc_tasks.c", "-pthread"),
        (notes, "write_times.c", "-shared", "-fPIC", f"-I{core}"),
    ):
        headers = [f"-I{each}" for each in (CORE, SOURCES)]
        subprocess.run([compiler, *FLAGS, *headers, "-o", made, HERE / source, *more], check=True)
    return plc, notes


def mapped(path: Path) -> mmap.mmap:
    """Map the notes."""
    with path.open("r+b") as file:
        return mmap.mmap(file.fileno(), 0)


def carry(mode: str, library: str, memory: str, *arguments: str) -> None:
    """Be a bridge whose sinks note when they hand over; with "fixed grid", one that predicts nothing."""
    from rosplc.bridge import channel

    noting = ctypes.CDLL(library)
    place = ctypes.c_int64.from_buffer(mapped(Path(memory)))
    pointer = ctypes.pythonapi.PyCapsule_GetPointer
    pointer.restype, pointer.argtypes = ctypes.c_void_p, [ctypes.py_object, ctypes.c_char_p]
    add = channel.ChannelsToRos.add

    def add_noting(self: channel.ChannelsToRos, port: channel.PortToRos) -> None:
        if port.sink is not None:
            sink = pointer(port.sink.capsule, b"rosplc.sink")
            noting.watch(ctypes.c_void_p(sink), ctypes.byref(place))
        add(self, port)

    channel.ChannelsToRos.add = add_noting
    if mode == "fixed grid":
        group = channel.Group
        channel.Group = lambda **_: group()
    sys.argv = ["rosplc", *arguments]
    rosplc()


@dataclass
class Carrier:
    """A running bridge, and what it noted."""

    prefix: str
    clock: int
    notes: mmap.mmap

    def processor(self) -> float:
        """Return the processor's time that it has used, in seconds."""
        return time.clock_gettime(self.clock)

    def objects(self, way: str, first: int, count: int) -> list[str]:
        """Return the paths of some of its objects, as plc_tasks takes them."""
        lead = "in:" if way == "in" else ""
        return [f"{lead}/dev/shm/{self.prefix}.t.load.{way}_{first + n}" for n in range(count)]

    def ages(self, since_ns: int, until_ns: int) -> list[float]:
        """Return how long after the PLC's store each message was handed over, in µs."""
        with memoryview(self.notes) as view, view.cast("q") as words:
            count = min(words[0], MOST)
            pairs = [(words[1 + 2 * n], words[2 + 2 * n]) for n in range(count)]
        return [(handed - stored) / 1e3 for stored, handed in pairs if since_ns <= stored < until_ns]

    def forget(self) -> None:
        """Let the notes begin again; nothing is being written."""
        self.notes[:8] = bytes(8)


@contextmanager
def carrying(mode: str, library: Path, topics: int, *, inward: bool = True) -> Iterator[Carrier]:
    """Run a bridge with as many topics in each direction; not ``inward``: towards ROS only."""
    prefix = f"bench-{secrets.token_hex(4)}"
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        path = folder / "notes"
        with path.open("wb") as file:
            file.truncate(8 * (1 + 2 * MOST))
        domain = stack.enter_context(ros_domain())
        text = load_config(prefix, topics, depth=64)
        if not inward:
            text = "\n".join(line for line in text.splitlines() if "/load/in_" not in line)
        command = ("-m", "benchmarks.bench_to_ros", "carry", mode, str(library), str(path))
        process = stack.enter_context(bridge(folder, text, domain, command=command))
        yield Carrier(prefix, cpu_clock(process.pid), mapped(path))


@contextmanager
def scanning(plc: Path, *tasks: Sequence[str]) -> Iterator[None]:
    """Run the PLC."""
    words = [word for task in tasks for word in ("task", *task)]
    with Side("plc_tasks", [str(plc), *words]) as side:
        side.receive()
        yield


def handed_over(
    plc: Path, carrier: Carrier, case: str, times: Times, draw: random.Random
) -> tuple[list[float], float]:
    """Measure one round; return the ages in µs and the share of a core in percent."""
    tasks, first = [], 0
    for period, topics in CASES[case]:
        words = [str(number) for number in (period, draw.randrange(period), JITTER_NS, 1)]
        tasks.append([*words, *carrier.objects("out", first, topics)])
        first += topics
    carrier.forget()
    with scanning(plc, *tasks):
        time.sleep(times[0])
        began, before = time.monotonic_ns(), carrier.processor()
        time.sleep(times[1])
        ended, after = time.monotonic_ns(), carrier.processor()
        time.sleep(0.02)
    return carrier.ages(began, ended), 1e11 * (after - before) / (ended - began)


def latencies(rounds: int, times: Times, plc: Path, library: Path) -> list[dict[str, Any]]:
    """Return the tables of latency and of the processor's time beside it."""
    draw = random.Random()
    tables = []
    with ExitStack() as stack:
        carriers = {mode: stack.enter_context(carrying(mode, library, 10)) for mode in MODES}
        found: dict[tuple[str, str], list[tuple[list[float], float]]] = {}
        for number in range(rounds):
            print(f"latency, round {number + 1} of {rounds}", file=sys.stderr)
            for case in CASES:
                for mode, carrier in carriers.items():
                    found.setdefault((case, mode), []).append(handed_over(plc, carrier, case, times, draw))
    waiting = "the bridge sleeps for at most 1 ms; a PLC task sleeps until its next scan (±50 µs)"
    for case in CASES:
        ages, loads = [], []
        for mode in MODES:
            ones = found[case, mode]
            middle = [statistics.median(values) for values, _ in ones]
            more = dict(zip(("lowest", "highest"), interval(middle), strict=True))
            ages.append(measure.row(mode, [age for values, _ in ones for age in values], **more))
            loads.append(measure.row(mode, [load for _, load in ones]))
        ratios = [
            mine / its for (_, its), (_, mine) in zip(*(found[case, mode] for mode in MODES), strict=True)
        ]
        lowest, highest = interval(ratios)
        loads[1] |= {"ratio": statistics.median(ratios), "lowest": lowest, "highest": highest}
        tables.append(measure.table(f"{case}: PLC's store to DDS write", "µs", waiting, ages))
        tables.append(measure.table(f"{case}: CPU of the bridge", "% of a core", waiting, loads))
    return tables


def quiet(sizes: Sequence[int], rounds: int, seconds: float, plc: Path, library: Path) -> dict[str, Any]:
    """Return the table of bridges on whose topics nothing happens while a PLC scans every 10 ms."""
    rows = []
    for topics in sizes:
        with carrying("predicting", library, topics // 2) as carrier:
            objects = [*carrier.objects("out", 0, topics // 2), *carrier.objects("in", 0, topics // 2)]
            for title, tasks in (("no PLC", ()), ("a PLC scans", ([str(10 * MS), "0", "0", "0", *objects],))):
                print(f"{topics} quiet topics, {title}", file=sys.stderr)
                with scanning(plc, *tasks) if tasks else ExitStack():
                    time.sleep(2 * seconds)
                    rows.append(measure.row(f"{topics}, {title}", shares(carrier, rounds, seconds)))
    waiting = "the bridge sleeps until the PLC scans, or for 10 ms"
    return measure.table("Quiet topics, half of them each way", "% of a core", waiting, rows)


def shares(carrier: Carrier, rounds: int, seconds: float) -> list[float]:
    """Return the share of a core in percent, round by round."""
    found = []
    for _ in range(rounds):
        began, before = time.monotonic(), carrier.processor()
        time.sleep(seconds)
        found.append(100 * (carrier.processor() - before) / (time.monotonic() - began))
    return found


def heads(sizes: Sequence[int], rounds: int, seconds: float, plc: Path) -> dict[str, Any]:
    """Return the table of looks at the heads of quiet objects alone, one per tick, while a PLC scans."""
    rows, before = [], None
    most = resource.getrlimit(resource.RLIMIT_NOFILE)[1]
    resource.setrlimit(resource.RLIMIT_NOFILE, (most, most))
    codec = Codec(compute_layout(TypeStore.bundled("jazzy"), TYPE))
    for number in sizes:
        space, group = Namespace(f"bench-{secrets.token_hex(4)}"), Group()
        found = []
        with ExitStack() as stack:
            stack.callback(remove_objects, space.prefix)
            for count in range(number):
                shape = {"topic": f"/t{count}", "record_size": codec.layout.size, "slots": 64}
                own = open_channel(space, Direction.TO_ROS, **shape)
                group.add_reader(stack.enter_context(own).reader(), codec.plan)
            paths = [str(space.path(f"/t{count}")) for count in range(number)]
            stack.enter_context(scanning(plc, [str(10 * MS), "0", "0", "0", *paths]))
            group.wait(MS, round(seconds * 1e9))
            for _ in range(rounds):
                began = time.thread_time_ns()
                group.wait(MS, round(seconds * 1e9))
                found.append((time.thread_time_ns() - began) / seconds / 1e6)
        cost = statistics.median(found)
        more = {} if before is None else {"ns/head": 1e3 * (cost - before[1]) / (number - before[0])}
        before = (number, cost)
        rows.append(measure.row(f"{number} heads", found, **more))
    waiting = "the thread sleeps for 1 ms between polls; the PLC scans every 10 ms and beats on every line"
    return measure.table("A tick: wake up, poll all heads", "µs of CPU time", waiting, rows)


def written(topics: int, every: int, rounds: int, seconds: float, plc: Path, library: Path) -> list[float]:
    """Return the CPU of a bridge in percent, round by round; a PLC writes each topic every so many scans."""
    print(f"{topics} active topics", file=sys.stderr)
    with carrying("predicting", library, topics, inward=False) as carrier:
        objects = carrier.objects("out", 0, topics)
        with scanning(plc, [str(10 * MS), "0", str(JITTER_NS), str(every), *objects]):
            time.sleep(2 * seconds)
            return shares(carrier, rounds, seconds)


def spread(
    loads: Sequence[tuple[int, int]], rounds: int, seconds: float, plc: Path, library: Path
) -> dict[str, Any]:
    """Return the table of the same messages over fewer and more topics: what a message costs, and a topic."""
    rows = []
    for topics, every in loads:
        found = written(topics, every, rounds, seconds, plc, library)
        rate = 100 * topics / every
        more = {"messages/s": rate, "µs/message": 1e4 * statistics.median(found) / rate}
        rows.append(measure.row(f"{topics} topics, {100 / every:g} Hz", found, **more))
    waiting = "the bridge sleeps for at most 1 ms; the PLC scans every 10 ms"
    return measure.table("The same messages over more topics, PLC to ROS", "% of a core", waiting, rows)


def active(sizes: Sequence[int], rounds: int, seconds: float, plc: Path, library: Path) -> dict[str, Any]:
    """Return the table of topics at 10 Hz; a PLC writes a tenth of them in each scan of 10 ms."""
    rows, before = [], None
    for topics in sizes:
        found = written(topics, 10, rounds, seconds, plc, library)
        cost = statistics.median(found)
        more = {"µs/message": 1e4 * cost / (10 * topics)}
        if before is not None:
            more["µs/further"] = 1e4 * (cost - before[1]) / (10 * (topics - before[0]))
        before = (topics, cost)
        rows.append(measure.row(f"{topics} topics", found, **more))
    waiting = "the bridge sleeps for at most 1 ms; the PLC scans every 10 ms"
    return measure.table(
        "Active topics at 10 Hz, PLC to ROS: CPU of the bridge", "% of a core", waiting, rows
    )


def run(
    rounds: int,
    times: Times = TIMES,
    still: Sequence[int] = QUIET,
    busy: Sequence[int] = ACTIVE,
    loads: Sequence[tuple[int, int]] = SPREAD,
) -> dict[str, Any]:
    """Measure in ``rounds`` rounds; returns a :func:`measure.report`.

    Args:
        rounds: How often both ways of looking take their turn, and how often CPU is read.
        times: Seconds of a round: until its figures begin, and how long they are taken.
        still: Numbers of quiet topics.
        busy: Numbers of topics at 10 Hz.
        loads: Numbers of topics, and the scans in which each is written once.
    """
    before = measure.environment()
    with tempfile.TemporaryDirectory() as folder:
        programs = compile_all(Path(folder))
        tables = latencies(rounds, times, *programs)
        tables.append(quiet(still, rounds, times[1], *programs))
        tables.append(heads(still, rounds, times[1], programs[0]))
        tables.append(active(busy, rounds, times[1], *programs))
        tables.append(spread(loads, rounds, times[1], *programs))
    return measure.report(tables, before)


if __name__ == "__main__":
    if sys.argv[1:2] == ["carry"]:
        carry(*sys.argv[2:])
    else:
        measure.main(run, __doc__, 9)
