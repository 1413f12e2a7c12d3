"""The bridge over every backend: added latency, messages per second without loss, CPU under load and at rest.

usage: python -m benchmarks.bench_bridge [--rounds N] [--json]

The backends take turns in every round. On each, one publisher sends a PoseStamped of about 200 bytes by
turns to a subscriber without a bridge ("bare": over DDS nothing but the cyclonedds wheel, else rosplc's
backend) and through the bridge. What the bridge adds is the difference of the two within a round. Under load
every message is checked where it arrives. Two rounds take about five minutes. Everything stays on this
machine; a backend whose package is missing is named with the reason.
"""

from __future__ import annotations

import os
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

from benchmarks import measure
from benchmarks.peers import BARE, EVERY, SENT, STRING, TO_PLC, TO_ROS, TYPE, names
from benchmarks.processes import RosGraph, bridge, lost_in_bridge, peers, ros_domain, share
from rosplc_bench.process import Side, pin
from tests.conformance.backends.registry import HARNESSES

MESSAGES = {100: 300, 1000: 1500}  # per round, by rate in Hz
RATES = (1000, 2000, 5000, 10_000, 20_000, 40_000)
LOAD = (20, 1000, 5.0)  # topics each way, rate in Hz, seconds of a round
QUIET = 200
NODES = "the backend wakes subscriber and bridge; the PLC spins; the bridge ticks every 1 ms towards ROS"


def latency_topics() -> list[str]:
    """Return the configuration's lines of the topics whose latency is measured."""
    common = f"type: {TYPE}, limits: {{string: {STRING}}}"
    return [
        f"  {TO_PLC}: {{to: plc, {common}}}",
        f"  {TO_ROS}: {{to: ros, {common}, latched: false}}",
        f"  {EVERY}: {{to: plc, {common}, every: true, slots: 32768, qos: {{depth: 5000}}}}",
    ]


def load_config(
    prefix: str,
    topics: int,
    *,
    depth: int,
    cycle: str = "1ms",
    ros: str = "{backend: dds, distro: jazzy}",
    more: Sequence[str] = (),
    outs: int | None = None,
    queue: int = 5000,
) -> str:
    """Return a configuration with as many topics in each direction, or ``outs`` towards ROS."""
    common = (
        f"type: {TYPE}, limits: {{string: {STRING}}}, slots: {depth}, every: true, qos: {{depth: {queue}}}"
    )
    lines = [f"bridge: {prefix}", f"prefix: {prefix}", f"ros: {ros}"]
    lines += [f"tasks: {{RosTask: {{interval: {cycle}}}}}", "topics:"]
    lines += [f"  {topic}: {{to: plc, {common}}}" for topic in names("in", topics)]
    lines += [f"  {topic}: {{to: ros, {common}, latched: false}}" for topic in names("out", topics)]
    return "\n".join([*lines, *more, ""])


@dataclass
class Contender:
    """A backend with its programs, ready to be measured."""

    title: str
    graph: RosGraph
    plan: dict[str, Any]
    pids: list[int]
    source: Side
    subscriber: Side

    def ages(self, kind: str, rate: int, count: int) -> dict[str, list[float]]:
        """Measure one round of ``in`` or ``out``; return the ages without and with the bridge."""
        if kind == "out":
            self._send(f"out {rate} {count}")
            found = self.subscriber.ask("")["ages"]
            ages = {"bare": found[BARE], "bridge": found[TO_ROS]}
            return {**ages, "without its tick": found[SENT]} if found[SENT] else ages
        cores = sorted(os.sched_getaffinity(0))
        with peers("spinner", self.plan, self.graph.domain, self.graph.variables) as (spinner,):
            if len(cores) > 1:  # a program that spins needs a core of its own
                pin([spinner.pid], cores[-1])
                pin(self.pids, *cores[:-1])
            self._send(f"in {rate} {count}")
            through = spinner.ask("")["ages"][TO_PLC]
        pin(self.pids, *cores)
        return {"bare": self.subscriber.ask("")["ages"][BARE], "bridge": through}

    def _send(self, request: str) -> None:
        self.subscriber.ask("")  # forget what came before
        self.source.ask(request)
        time.sleep(0.2)

    def without_loss(self, rates: Sequence[int], seconds: float) -> dict[str, float]:
        """Return the highest rates, in messages per second, at which everything arrives: bare and bridged."""
        found = {"bare": 0.0, "bridge": 0.0}
        with peers("counter", self.plan, self.graph.domain, self.graph.variables) as (counter,):
            for name, topic in (("bare", BARE), ("bridge", EVERY)):
                for rate in rates:
                    count = round(rate * seconds)
                    self._send(f"flood {topic} {rate} 0")
                    counter.ask("")
                    took = self.source.ask(f"flood {topic} {rate} {count}")["took"]
                    time.sleep(0.5)
                    bare = len(self.subscriber.ask("")["ages"][BARE])
                    if (counter.ask("")["count"] if topic == EVERY else bare) < count:
                        break
                    found[name] = max(found[name], count / took)
                    if took > 1.2 * seconds:  # the publisher itself is at its limit
                        break
        return found


@contextmanager
def graphs(wanted: Sequence[str] | None) -> Iterator[tuple[dict[str, RosGraph], dict[str, str]]]:
    """Give a graph of each backend that is installed, and why the others are left out."""
    found: dict[str, RosGraph] = {}
    skipped: dict[str, str] = {}
    with ExitStack() as stack:
        for kind in HARNESSES:
            if kind.backend == "memory" or (kind.repeats if wanted is None else kind.title not in wanted):
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
    plan = {"prefix": prefix, **graph.plan()}
    head = [f"bridge: {prefix}", f"prefix: {prefix}", f"ros: {graph.settings()}"]
    text = "\n".join([*head, "diagnostics: {enabled: false}", "topics:", *latency_topics(), ""])
    process = stack.enter_context(bridge(folder, text, graph.domain, graph.variables))
    subscriber, source = stack.enter_context(peers("subscriber source", plan, graph.domain, graph.variables))
    made = Contender(title, graph, plan, [process.pid, source.pid, subscriber.pid], source, subscriber)
    made.ages("out", 100, 10)  # everything has run once before anything counts
    return made


def latency_table(kind: str, rate: int, rounds: dict[str, list[dict[str, list[float]]]]) -> dict[str, Any]:
    """Return the table of one direction and rate; added and ratio are medians over rounds."""
    rows = []
    for title, ones in rounds.items():
        for name in ones[0]:
            more: dict[str, Any] = {}
            if name != "bare":
                middle = [(statistics.median(one[name]), statistics.median(one["bare"])) for one in ones]
                more["added median"] = statistics.median(with_it - bare for with_it, bare in middle)
                more["added p99"] = statistics.median(
                    measure.percentile(one[name], 99) - measure.percentile(one["bare"], 99) for one in ones
                )
                more["ratio"] = statistics.median(with_it / bare for with_it, bare in middle)
            rows.append(
                measure.row(f"{title}, {name}", [value for one in ones for value in one[name]], **more)
            )
    way = "ROS to PLC" if kind == "in" else "PLC to ROS (with the bridge's tick)"
    return measure.table(f"{way}, PoseStamped of 200 B, {rate} Hz", "µs", NODES, rows)


def loaded(topics: int, rate: int, rounds: int, seconds: float, graph: RosGraph) -> dict[str, Any]:
    """Measure CPU with every topic busy; every message is checked, and what is lost is counted."""
    prefix = f"bench-{secrets.token_hex(4)}"
    count = round(rate * (seconds * (rounds + 1) + 1))
    plan = {
        "topics": topics,
        "count": count,
        "rate": rate,
        "per_scan": 1,
        "qos_depth": 5000,
        "prefix": prefix,
    }
    plan |= graph.plan()
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        text = load_config(prefix, topics, depth=4096, ros=graph.settings())
        process = stack.enter_context(bridge(folder, text, graph.domain, graph.variables))
        plc, ros = stack.enter_context(peers("plc ros", plan, graph.domain, graph.variables))
        begin(plc, ros)
        began = time.monotonic()
        time.sleep(min(1.0, seconds))
        found = share({"bridge": process.pid, "ROS peer": ros.pid, "PLC": plc.pid}, seconds, rounds)
        sent = [each.receive_json()["sent"] for each in (plc, ros)]
        took = time.monotonic() - began
        time.sleep(2.0)
        results = [each.ask("stop") for each in (ros, plc)]
        in_bridge = lost_in_bridge(folder)  # what its readers of shared memory have lost is part of it
    tallies = [tally for result in results for tally in result["seen"].values()]
    expected = topics * sum(sent)
    arrived = sum(tally["received"] for tally in tallies)
    outward = set(names("out", topics))
    at_ros, at_plc = (result["lost"] for result in results)
    lost = sum(at_ros.values()) + in_bridge
    lost += sum(count for topic, count in at_plc.items() if topic not in outward)
    facts = {
        "sent": expected,
        "arrived": arrived,
        "wrong": sum(tally["wrong"] for tally in tallies),
        "counted lost": lost,
        # Over Zenoh a gap shows when a later message arrives: what a topic lost at its very end does not.
        "unaccounted for": expected - arrived - lost,
        "Hz reached": round(arrived / took / topics / 2),
    }
    rows = [measure.row(name, values) for name, values in found.items()]
    waiting = (
        "the backend wakes the bridge; towards ROS the bridge ticks every 1 ms; the PLC scans every 1 ms"
    )
    return measure.table(f"{topics} topics x {rate} Hz each way", "% of a core", waiting, rows, facts)


def begin(*ends: Side) -> None:
    """Have the ends of a load send: first one message of each topic, then the others at their rate."""
    for word in ("go", "more"):
        for side in ends:
            side.send(word)
        if word == "go":
            for side in ends:
                side.receive()


def quiet(topics: int, rounds: int, seconds: float) -> dict[str, Any]:
    """Measure with topics on which nothing happens."""
    prefix = f"bench-{secrets.token_hex(4)}"
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        text = load_config(prefix, topics // 2, depth=4, cycle="10ms")
        domain = stack.enter_context(ros_domain())
        process = stack.enter_context(bridge(folder, text, domain))
        time.sleep(min(3.0, seconds))
        found = share({"bridge, no PLC": process.pid}, seconds, rounds)
        plan = {"topics": topics // 2, "count": 0, "rate": 100, "per_scan": 1, "prefix": prefix}
        with peers("plc", plan, domain):
            time.sleep(min(3.0, seconds))
            found |= share({"bridge, a PLC scans": process.pid}, seconds, rounds)
    rows = [measure.row(name, values) for name, values in found.items()]
    waiting = "the bridge sleeps as above, and towards ROS until the PLC scans, or for 10 ms"
    return measure.table(f"{topics} quiet topics", "% of a core", waiting, rows)


def run(
    rounds: int,
    wanted: Sequence[str] | None = None,
    messages: dict[int, int] | None = None,
    rates: Sequence[int] = RATES,
    seconds: float = 0.7,
    load: tuple[int, int, float] = LOAD,
    still: int = QUIET,
) -> dict[str, Any]:
    """Measure in ``rounds`` rounds; returns a :func:`measure.report`.

    Args:
        rounds: How often all backends take their turn.
        wanted: The harnesses to take; by default one for each backend that is installed.
        messages: Messages per round by rate in Hz, for latency.
        rates: Messages per second to try, rising.
        seconds: How long each of them is tried.
        load: Topics each way, rate in Hz and seconds of the measurement of CPU.
        still: Topics of the measurement at rest.
    """
    before = measure.environment()
    sizes = messages or MESSAGES
    ages: dict[tuple[str, int], dict[str, list[Any]]] = {(k, r): {} for r in sizes for k in ("in", "out")}
    reached: dict[str, list[float]] = {}
    cpu = []
    with graphs(wanted) as (found, skipped):
        with ExitStack() as stack:
            contenders = [contend(stack, title, graph) for title, graph in found.items()]
            for number in range(rounds):
                print(f"round {number + 1} of {rounds}", file=sys.stderr)
                for one in contenders:
                    for (kind, rate), kept in ages.items():
                        kept.setdefault(one.title, []).append(one.ages(kind, rate, sizes[rate]))
                    for name, value in one.without_loss(rates, seconds).items():
                        reached.setdefault(f"{one.title}, {name}", []).append(value)
        topics, rate, length = load
        for title, graph in found.items():
            print(f"load on {title}", file=sys.stderr)
            table = loaded(topics, rate, rounds, length, graph)
            cpu.append({**table, "title": f"{title}: {table['title']}"})
    if "dds" in found:
        cpu.append(quiet(still, rounds, length))
    tables = [latency_table(kind, rate, kept) for (kind, rate), kept in ages.items()]
    rows = [measure.row(name, values) for name, values in reached.items()]
    tried = f"{rates[0]} to {rates[-1]} per second, {seconds:g} s each; the publisher sends bursts every 1 ms"
    tables.append(measure.table("Without loss, ROS to PLC", "messages/s", tried, rows, skipped))
    return measure.report([*tables, *cpu], before)


if __name__ == "__main__":
    measure.main(run, __doc__, 2)
