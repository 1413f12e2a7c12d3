"""Every backend in one run: latency that the bridge adds, messages per second without loss, CPU under load.

usage: python benchmarks/bench_backends.py [--rounds N] [--json]

The backends take turns in every round. On each, one publisher sends a PoseStamped of about 200 bytes by
turns to a subscriber on the same backend ("bare": both programs use rosplc's backend, with no bridge between)
and through the bridge. What the bridge adds is the difference of the two within a round. Two rounds take
about four minutes. Everything stays on this machine; a backend whose
package is missing is named with the reason. The other backends' bridges and programs run on, idle.
"""

from __future__ import annotations

import secrets
import statistics
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks import measure
from benchmarks.backend_peers import BARE, EVERY, TO_PLC, TO_ROS
from benchmarks.bench_bridge_load import loaded
from benchmarks.load_peers import STRING, TYPE
from benchmarks.processes import Peer, RosGraph, bridge
from tests.conformance.backends.registry import HARNESSES

MESSAGES = {100: 300, 1000: 1500}  # per round, by rate in Hz
RATES = (1000, 2000, 5000, 10_000, 20_000, 40_000)
NODES = "subscriber and bridge: woken by the backend; PLC: spins; towards ROS the bridge ticks every 1 ms"


@dataclass
class Contender:
    """A backend with its programs, ready to be measured."""

    title: str
    graph: RosGraph
    order: dict[str, Any]
    source: Peer
    subscriber: Peer

    def peer(self, role: str) -> Peer:
        """Start one more program beside this bridge."""
        return Peer("backend_peers", role, self.order, self.graph.domain, self.graph.variables)

    def ages(self, kind: str, rate: int, count: int) -> dict[str, list[float]]:
        """Measure one round of ``in`` or ``out``; return the ages without and with the bridge."""
        if kind == "out":
            self._send(f"out {rate} {count}")
            found = _ask(self.subscriber)["ages"]
            return {"bare": found[BARE], "bridge": found[TO_ROS]}
        with self.peer("spinner") as spinner:
            spinner.hear()
            self._send(f"in {rate} {count}")
            through = _ask(spinner)["ages"][TO_PLC]
        return {"bare": _ask(self.subscriber)["ages"][BARE], "bridge": through}

    def _send(self, order: str) -> None:
        _ask(self.subscriber)  # forget what came before
        self.source.tell(order)
        self.source.hear()
        time.sleep(0.2)

    def without_loss(self, rates: Sequence[int], seconds: float) -> dict[str, float]:
        """Return the highest rates, in messages per second, at which everything arrives: bare and bridged."""
        found = {"bare": 0.0, "bridge": 0.0}
        with self.peer("counter") as counter:
            counter.hear()
            for name, topic in (("bare", BARE), ("bridge", EVERY)):
                for rate in rates:
                    count = round(rate * seconds)
                    self._send(f"flood {topic} {rate} 0")
                    _ask(counter)
                    self.source.tell(f"flood {topic} {rate} {count}")
                    took = self.source.hear()["took"]
                    time.sleep(0.5)
                    arrived = (
                        _ask(counter)["count"] if topic == EVERY else len(_ask(self.subscriber)["ages"][BARE])
                    )
                    if arrived < count:
                        break
                    found[name] = max(found[name], count / took)
                    if took > 1.2 * seconds:  # the publisher itself is at its end
                        break
        return found


def _ask(peer: Peer) -> dict[str, Any]:
    peer.tell("")
    return peer.hear()


def config(prefix: str, graph: RosGraph) -> str:
    """Return the configuration of the bridge that is measured."""
    common = f"type: {TYPE}, limits: {{string: {STRING}}}"
    return "\n".join(
        (
            f"bridge: {prefix}",
            f"prefix: {prefix}",
            f"ros: {graph.settings()}",
            "diagnostics: {enabled: false}",
            "topics:",
            f"  {TO_PLC}: {{to: plc, {common}}}",
            f"  {TO_ROS}: {{to: ros, {common}, latched: false}}",
            f"  {EVERY}: {{to: plc, {common}, every: true, slots: 32768, qos: {{depth: 5000}}}}",
            "",
        )
    )


@contextmanager
def graphs(names: Sequence[str] | None) -> Iterator[tuple[dict[str, RosGraph], dict[str, str]]]:
    """Give a graph of each backend that is installed, and why the others are left out."""
    found: dict[str, RosGraph] = {}
    skipped: dict[str, str] = {}
    with ExitStack() as stack:
        for kind in HARNESSES:
            wanted = not kind.repeats if names is None else kind.title in names
            if kind.backend == "memory" or not wanted:
                continue
            if not kind.reaches_out:  # a double in its place has no figures
                skipped[kind.backend] = "not installed"
                continue
            if (why := kind.missing()) is not None:
                skipped[kind.title] = why
                continue
            harness = stack.enter_context(kind())
            found[kind.title] = RosGraph(
                harness.domain or 0, kind.backend, kind.distros[0], harness.options, harness.environment
            )
        yield found, skipped


def contend(stack: ExitStack, title: str, graph: RosGraph) -> Contender:
    """Start a bridge and its programs on a graph."""
    prefix = f"bench-{secrets.token_hex(4)}"
    folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
    order = {"prefix": prefix, **graph.order()}
    stack.enter_context(bridge(folder, config(prefix, graph), graph.domain, graph.variables))
    made = [
        stack.enter_context(Peer("backend_peers", role, order, graph.domain, graph.variables))
        for role in ("subscriber", "source")
    ]
    for peer in made:
        peer.hear()
    one = Contender(title, graph, order, made[1], made[0])
    one.ages("out", 100, 10)  # everything has run once before anything counts
    return one


def latency_table(kind: str, rate: int, rounds: dict[str, list[dict[str, list[float]]]]) -> dict[str, Any]:
    """Return the table of one direction and rate; the added columns are medians over rounds."""
    rows = []
    for title, ones in rounds.items():
        for name in ("bare", "bridge"):
            values = [value for one in ones for value in one[name]]
            more: dict[str, Any] = {}
            if name == "bridge":
                for percent in (50, 99):
                    added = [
                        measure.percentile(o["bridge"], percent) - measure.percentile(o["bare"], percent)
                        for o in ones
                    ]
                    more[f"added {'median' if percent == 50 else 'p99'}"] = statistics.median(added)
            rows.append(measure.row(f"{title}, {name}", values, **more))
    way = "ROS to PLC" if kind == "in" else "PLC to ROS (with the bridge's tick)"
    return measure.table(f"{way}, PoseStamped of 200 B, {rate} Hz", "µs", NODES, rows)


def run(
    rounds: int,
    names: Sequence[str] | None = None,
    messages: dict[int, int] | None = None,
    rates: Sequence[int] = RATES,
    seconds: float = 0.7,
    load: tuple[int, int, float] = (20, 1000, 3.0),
) -> dict[str, Any]:
    """Measure in ``rounds`` rounds; returns a :func:`measure.report`.

    Args:
        rounds: How often all backends take their turn.
        names: The harnesses to take; by default one for each backend that is installed.
        messages: Messages per round by rate in Hz, for latency.
        rates: Messages per second to try, rising.
        seconds: How long each of them is tried.
        load: Topics, rate in Hz and seconds of the measurement of CPU.
    """
    before = measure.environment()
    sizes = messages or MESSAGES
    ages: dict[tuple[str, int], dict[str, list[Any]]] = {(k, r): {} for r in sizes for k in ("in", "out")}
    reached: dict[str, list[float]] = {}
    cpu = []
    with graphs(names) as (found, skipped):
        with ExitStack() as stack:
            contenders = [contend(stack, title, graph) for title, graph in found.items()]
            for number in range(rounds):
                print(f"round {number + 1} of {rounds}", file=sys.stderr)
                for one in contenders:
                    for (kind, rate), kept in ages.items():
                        kept.setdefault(one.title, []).append(one.ages(kind, rate, sizes[rate]))
                    for name, value in one.without_loss(rates, seconds).items():
                        reached.setdefault(f"{one.title}, {name}", []).append(value)
        for title, graph in found.items():
            print(f"load on {title}", file=sys.stderr)
            topics, rate, length = load
            table = loaded(topics, rate, rounds, length, graph)
            cpu.append({**table, "title": f"{title}: {table['title']}"})
    tables = [latency_table(kind, rate, kept) for (kind, rate), kept in ages.items()]
    rows = [measure.row(name, values) for name, values in reached.items()]
    tried = f"{rates[0]} to {rates[-1]} per second, {seconds:g} s each; the publisher sends bursts every 1 ms"
    tables.append(measure.table("Without loss, ROS to PLC", "messages/s", tried, rows, skipped))
    return measure.report([*tables, *cpu], before)


if __name__ == "__main__":
    measure.main(run, __doc__, 2)
