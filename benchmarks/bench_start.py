"""What rosplc takes to begin and to be there: `rosplc --help`, the first message, the bridge's memory.

usage: python -m benchmarks.bench_start [--rounds N] [--seconds N] [--queue N] [--json]

In every round: the processor's time of `rosplc --help` and of an empty typer program's; then a bridge with
20 topics over DDS, ten each way, and one more whose message is latched before the bridge is started: how long
until the PLC finds that. After 60 s of traffic (--seconds) its memory is read beside that of Python
with a cyclonedds participant in the same domain: PSS, in which what processes share counts by halves. Cyclone
DDS fills the queue of a topic above 60 Hz, though every message arrives: --queue is its length.
"""

from __future__ import annotations

import resource
import secrets
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from benchmarks import measure
from benchmarks.bench_bridge import begin, load_config
from benchmarks.bench_dds import interval
from benchmarks.peers import STRING, TYPE
from benchmarks.processes import RosGraph, bridge, environment, peers, pss_mb, ros_domain
from rosplc import attach
from rosplc.codec import Codec
from rosplc.layout import Limits, compute_layout
from rosplc.model import TypeStore
from rosplc.ros import PRESETS, open_backend

LOAD = (10, 200)  # topics each way, rate in Hz
QUEUE = 1000  # messages: rosplc's default
FIRST = "/first"
EMPTY = """
import typer
app = typer.Typer()
@app.command()
def one(name: str = "x") -> None: "Say one."
@app.command()
def two(name: str = "x") -> None: "Say two."
app()
"""
PARTICIPANT = """
import sys
from cyclonedds.domain import DomainParticipant
participant = DomainParticipant(int(sys.argv[1]))
print("up", flush=True)
sys.stdin.read()
"""


def processor_ms(*arguments: str) -> float:
    """Return the processor's time that a Python program takes, with its children's."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run([sys.executable, *arguments], check=True, stdout=subprocess.DEVNULL)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return 1e3 * (after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime)


@contextmanager
def participant(domain: int) -> Iterator[int]:
    """Run Python with a participant and nothing else; give its process id."""
    command = [sys.executable, "-c", PARTICIPANT, str(domain)]
    with subprocess.Popen(
        command, env=environment(domain), stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as process:
        assert process.stdout is not None
        process.stdout.readline()
        yield process.pid
        process.communicate()


def carried(topics: int, rate: int, seconds: float, queue: int = QUEUE) -> dict[str, float]:
    """Start a bridge; return the seconds to its first message, and the memory after traffic, in MB."""
    prefix = f"bench-{secrets.token_hex(4)}"
    store = TypeStore.bundled("jazzy")
    message = Codec(layout := compute_layout(store, TYPE, Limits(string=STRING))).encode(layout.initial())
    with ros_domain() as domain, tempfile.TemporaryDirectory() as folder, participant(domain) as bare:
        source = open_backend("dds", store, "source", domain=domain, environment=environment(domain))
        source.advertise(FIRST, TYPE, PRESETS["latched"]).write(message)
        topic = f"  {FIRST}: {{to: plc, latched: true, type: {TYPE}, limits: {{string: {STRING}}}}}"
        text = load_config(prefix, topics, depth=64, more=[topic], queue=queue)
        began = time.monotonic()
        with bridge(Path(folder), text, domain) as process:
            with attach(FIRST, prefix=prefix, latched=True) as channel:
                while channel.read() is None:
                    time.sleep(0.002)
            found = {"first": time.monotonic() - began}
            source.close()
            plan: dict[str, Any] = {
                "topics": topics,
                "count": round(rate * seconds),
                "rate": rate,
                "per_scan": 1,
            }
            plan |= {"qos_depth": 100, "prefix": prefix, **RosGraph(domain).plan()}
            with peers("plc ros", plan, domain) as (plc, ros):
                begin(plc, ros)
                time.sleep(seconds)
                return found | {"bridge": pss_mb(process.pid), "participant": pss_mb(bare)}


def run(
    rounds: int, seconds: float = 60.0, load: tuple[int, int] = LOAD, queue: int = QUEUE
) -> dict[str, Any]:
    """Measure in ``rounds`` rounds; returns a :func:`measure.report`.

    Args:
        rounds: How often.
        seconds: How long messages pass before memory is read.
        load: Topics each way, rate in Hz.
        queue: Messages that a topic's queue in DDS holds.
    """
    before = measure.environment()
    found: dict[str, list[float]] = {}
    for number in range(rounds):
        print(f"round {number + 1} of {rounds}", file=sys.stderr)
        helped = {
            "empty": processor_ms("-c", EMPTY, "--help"),
            "help": processor_ms("-m", "rosplc", "--help"),
        }
        for name, value in (helped | carried(*load, seconds, queue)).items():
            found.setdefault(name, []).append(value)
    rows = []
    for unit, mine, anchor in (
        ("`rosplc --help`, ms of CPU time", "help", "an empty typer program"),
        ("bridge, MB of memory (PSS)", "bridge", "Python with a participant"),
    ):
        its = found["empty" if mine == "help" else "participant"]
        ratios = [one / other for one, other in zip(found[mine], its, strict=True)]
        lowest, highest = interval(ratios)
        rows.append(measure.row(f"{anchor}, {unit.partition(', ')[2]}", its))
        rows.append(
            measure.row(
                unit,
                found[mine],
                ratio=measure.median_ratio(found[mine], its),
                lowest=lowest,
                highest=highest,
            )
        )
    rows.append(measure.row("start to first message, s", found["first"]))
    waiting = "a PLC polls every 2 ms for the first message, then scans every 1 ms"
    return measure.report(
        [measure.table(f"{2 * load[0]} topics, queues of {queue}", "as named", waiting, rows)], before
    )


if __name__ == "__main__":
    measure.main(run, __doc__, 9, seconds=60.0, queue=QUEUE)
