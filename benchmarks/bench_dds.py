"""The bridge over DDS beside a node written in C by hand: CPU per message, and latency towards the PLC.

usage: python -m benchmarks.bench_dds [--rounds N] [--json]

The node (dds_node.c) uses the same library, the one of the cyclonedds wheel, with the same QoS and ways of
waiting: it takes, copies field by field into the same shared memory, and writes; no other type, no limits,
no checks, no status. Both carry the same load by turns, every message of which is checked where it arrives.
What is compared is the time of the processor per message, which other programs disturb least. Needs gcc.
"""

from __future__ import annotations

import os
import random
import secrets
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, NamedTuple

from benchmarks import measure
from benchmarks.bench_bridge import LOAD, begin, load_config
from benchmarks.peers import STRING, TYPE, names
from benchmarks.processes import RosGraph, bridge, cpu_seconds, environment, peers, pss_mb, ros_domain
from rosplc.demo.processes import remove_objects
from rosplc.described import description_of
from rosplc.layout import Layout, Limits, compute_layout
from rosplc.model import TypeStore
from rosplc.ros.dds import native
from rosplc.ros.dds.backend import domain_config
from rosplc.ros.dds.idl import dds_topic
from rosplc.shm import Direction, Namespace, OwnedChannel
from rosplc_bench.compiling import CORE, FLAGS, SOURCES
from rosplc_bench.process import Side, pin

HERE = Path(__file__).resolve().parent
DEPTH = 5000
MESSAGES = {100: 600, 1000: 3000}  # to each, per round, by rate in Hz
RESAMPLES = 2000


def compiled(compiler: str, *words: str | Path) -> None:
    """Run a compiler."""
    if shutil.which(compiler) is None:
        raise RuntimeError(f"Debian package {compiler} is missing")
    subprocess.run([compiler, *words], check=True)


class Carried(NamedTuple):
    """What the node carries: its word for the type, the layout, an object's slots, DDS' depth."""

    word: str
    layout: Layout
    slots: int
    depth: int


def poses(distro: str) -> Carried:
    """Return what a node carries under load."""
    layout = compute_layout(TypeStore.bundled(distro), TYPE, Limits(string=STRING))
    return Carried("pose", layout, 4096, DEPTH)


class OverDds:
    """The middleware under both, and the node by hand that is made for it."""

    node = "C node"
    distro = "jazzy"
    waiting = "both sleep in a waitset"

    @property
    def contenders(self) -> tuple[str, str]:
        """The names of both."""
        return self.node, "bridge"

    def compile(self, folder: Path) -> None:
        """Compile the node, against the library that the wheel has loaded."""
        library, self.program = Path(native.library._name).resolve(), folder / "dds_node"
        headers = [f"-I{each}" for each in (CORE, SOURCES)]
        link = [str(library), f"-Wl,-rpath,{library.parent}", "-pthread"]
        compiled("gcc", *FLAGS, *headers, "-o", self.program, HERE / "dds_node.c", *link)

    @contextmanager
    def graph(self) -> Iterator[RosGraph]:
        """Give a graph that nobody else uses."""
        with ros_domain() as domain:
            yield RosGraph(domain)

    def command(self, graph: RosGraph, what: Carried) -> list[str]:
        """Return how the node begins its command line."""
        return [str(self.program), str(graph.domain), str(what.depth), what.word]

    def environment(self, graph: RosGraph) -> dict[str, str]:
        """Return the node's environment."""
        variables = environment(graph.domain)
        return variables | {"CYCLONEDDS_URI": domain_config(variables, "jazzy")}

    def name(self, topic: str) -> str:
        """Return a topic's name in the middleware."""
        return dds_topic(topic)

    @contextmanager
    def ros(self, plan: dict[str, Any], graph: RosGraph) -> Iterator[Side]:
        """Run the ROS end of a load."""
        with peers("ros", plan, graph.domain) as (side,):
            yield side


@contextmanager
def node(
    over: OverDds, prefix: str, graph: RosGraph, ins: list[str], outs: list[str], what: Carried
) -> Iterator[int]:
    """Run the node in place of a bridge, over objects that this process owns; give its process id."""
    layout, words = what.layout, []
    with ExitStack() as stack:
        stack.callback(remove_objects, prefix)
        for way, direction, topics in (("in", Direction.TO_PLC, ins), ("out", Direction.TO_ROS, outs)):
            for topic in topics:
                about = description_of(layout, topic, direction, bridge=prefix)
                channel = OwnedChannel.open(
                    Namespace(prefix), about, record_size=layout.size, slots=what.slots
                )
                stack.callback(channel.close)
                words += [way, over.name(topic), str(channel.path)]
        with Side(over.node, [*over.command(graph, what), *words], over.environment(graph)) as side:
            side.receive()
            yield side.pid


@contextmanager
def carrying(
    name: str,
    over: OverDds,
    prefix: str,
    graph: RosGraph,
    config: str,
    ins: list[str],
    outs: list[str],
    what: Carried | None = None,
) -> Iterator[int]:
    """Run a contender for topics each way, which are also those of the configuration; give its process id."""
    with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
        if name == "bridge":
            yield stack.enter_context(bridge(Path(folder), config, graph.domain, graph.variables)).pid
        else:
            yield stack.enter_context(node(over, prefix, graph, ins, outs, what or poses(over.distro)))


def loaded(name: str, over: OverDds, topics: int, rate: int, seconds: float) -> dict[str, float]:
    """Carry a load once; return the processor's time per message in µs, what was lost, and memory in MB."""
    prefix, count = f"bench-{secrets.token_hex(4)}", round(rate * seconds)
    ends = names("in", topics), names("out", topics)
    with over.graph() as graph:
        config = load_config(prefix, topics, depth=4096, ros=graph.settings())
        plan = {"topics": topics, "count": count, "rate": rate, "per_scan": 1, "qos_depth": DEPTH}
        plan |= {"prefix": prefix, **graph.plan()}
        with (
            carrying(name, over, prefix, graph, config, *ends) as pid,
            peers("plc", plan, graph.domain, graph.variables) as (plc,),
            over.ros(plan, graph) as ros,
        ):
            before = cpu_seconds(pid)
            begin(plc, ros)
            sent = [each.receive_json()["sent"] for each in (plc, ros)]
            time.sleep(1.0)
            user, system = (now - then for now, then in zip(cpu_seconds(pid), before, strict=True))
            memory = pss_mb(pid, "Anon", "File")  # without the objects, whose size the load decides
            results = [each.ask("stop") for each in (ros, plc)]
    tallies = [tally for result in results for tally in result["seen"].values()]
    arrived = sum(tally["received"] for tally in tallies)
    lost = topics * sum(sent) - arrived + sum(tally["wrong"] for tally in tallies)
    found = {"user": user, "system": system, "both": user + system}
    return {key: 1e6 * value / arrived for key, value in found.items()} | {"lost": lost, "memory": memory}


def ages(over: OverDds, messages: dict[int, int]) -> dict[int, dict[str, list[float]]]:
    """Return by rate how old messages were, in µs, when a PLC that spins saw them.

    Both are up at once, and every other message is the other's: a slow moment of the machine meets both.
    """
    turns = {f"/bench/in{index}": f"bench-{secrets.token_hex(4)}" for index in range(len(over.contenders))}
    common = f"type: {TYPE}, limits: {{string: {STRING}}}"
    with over.graph() as graph, ExitStack() as stack:
        pids = []
        for name, (topic, prefix) in zip(over.contenders, turns.items(), strict=True):
            back = topic.replace("in", "out")
            head = [f"bridge: {prefix}", f"prefix: {prefix}", f"ros: {graph.settings()}"]
            lines = [f"  {topic}: {{to: plc, {common}}}", f"  {back}: {{to: ros, {common}, latched: false}}"]
            config = "\n".join([*head, "diagnostics: {enabled: false}", "topics:", *lines, ""])
            one = carrying(name, over, prefix, graph, config, [topic], [back])
            pids.append(stack.enter_context(one))
        plan = {"turns": turns, **graph.plan()}
        source, spinner = stack.enter_context(peers("by_turns spinner", plan, graph.domain, graph.variables))
        cores = sorted(os.sched_getaffinity(0))
        if len(cores) > 1:  # a program that spins needs a core of its own
            pin([spinner.pid], cores[-1])
            pin([*pids, source.pid], *cores[:-1])
        found = {}
        for rate, count in ((100, 10), *messages.items()):  # everything has run once before anything counts
            source.ask(f"{rate} {count}")
            time.sleep(0.2)
            seen = spinner.ask("")["ages"]
            found[rate] = {name: seen[topic] for name, topic in zip(over.contenders, turns, strict=True)}
        return found


def latencies(rounds: int, over: OverDds, messages: dict[int, int]) -> dict[str, Any]:
    """Return the table of latency towards the PLC; the ratios are medians over rounds, with intervals."""
    found = [ages(over, messages) for _ in range(rounds)]
    rows = []
    for rate in messages:
        for one in over.contenders:
            more = {}
            for part, percent in (("median", 50), ("p99", 99)) if one == "bridge" else ():
                pairs = [
                    [measure.percentile(each[rate][name], percent) for name in over.contenders]
                    for each in found
                ]
                ratios = [mine / its for its, mine in pairs]
                more[f"{part} ratio"] = statistics.median(ratios)
                more[f"{part} from"], more[f"{part} to"] = interval(ratios)
            values = [value for each in found for value in each[rate][one]]
            rows.append(measure.row(f"{one}, {rate} Hz", values, **more))
    waiting = f"{over.waiting}; the PLC spins on its own core; both get messages in turn"
    return measure.table("ROS to PLC, PoseStamped of 200 B", "µs", waiting, rows)


def interval(values: list[float]) -> tuple[float, float]:
    """Return the bootstrapped 95 % interval of the median."""
    draw = random.Random(1)
    medians = sorted(statistics.median(draw.choices(values, k=len(values))) for _ in range(RESAMPLES))
    return medians[RESAMPLES // 40], medians[-RESAMPLES // 40]


def run(
    rounds: int,
    load: tuple[int, int, float] = LOAD,
    messages: dict[int, int] | None = None,
    over: OverDds | None = None,
) -> dict[str, Any]:
    """Measure in ``rounds`` rounds; returns a :func:`measure.report`.

    Args:
        rounds: How often both take their turn.
        load: Topics each way, rate in Hz and seconds of a round.
        messages: Messages of a round by rate in Hz, for latency.
        over: The middleware under both; DDS by default.
    """
    before, over = measure.environment(), over or OverDds()
    topics, rate, seconds = load
    found: dict[str, list[dict[str, float]]] = {name: [] for name in over.contenders}
    with tempfile.TemporaryDirectory() as folder:
        over.compile(Path(folder))
        for number in range(rounds):
            print(f"round {number + 1} of {rounds}", file=sys.stderr)
            for name, kept in found.items():
                kept.append(loaded(name, over, topics, rate, seconds))
        latency = latencies(rounds, over, MESSAGES if messages is None else messages)
    ratios = [mine["both"] / its["both"] for its, mine in zip(*found.values(), strict=True)]
    lowest, highest = interval(ratios)
    more = {"ratio": statistics.median(ratios), "lowest": lowest, "highest": highest}
    rows = [
        measure.row(
            name if part == "both" else f"{name}, {part}",
            [one[part] for one in kept],
            **(more if (name, part) == ("bridge", "both") else {}),
        )
        for name, kept in found.items()
        for part in ("both", "user", "system")
    ]
    waiting = f"{over.waiting} towards the PLC, and poll every 1 ms towards ROS; the PLC scans every 1 ms"
    facts: dict[str, float] = {}
    for name, kept in found.items():
        facts[f"lost, {name}"] = sum(one["lost"] for one in kept)
        facts[f"memory, {name}, MB (PSS)"] = round(statistics.median(one["memory"] for one in kept), 1)
    title = f"{topics} topics x {rate} Hz each way, CPU"
    return measure.report([measure.table(title, "µs per message", waiting, rows, facts), latency], before)


if __name__ == "__main__":
    measure.main(run, __doc__, 9)
