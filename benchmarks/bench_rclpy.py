"""The bridge over rclpy beside nodes of rclpy alone: CPU per message, towards the PLC and each way.

usage: python -m benchmarks.bench_rclpy [--rounds N] [--json]

All carry the same load by turns, with the same QoS and publisher, which sends serialized messages. A node of
rclpy alone has default subscriptions and a SingleThreadedExecutor. Its callbacks do nothing ("empty"), or
copy each field into the same shared memory ("copies"); that one publishes what the PLC writes, too. What is
compared is the time of the processor per message. Run it with the Python of ``make ros2-env``; nine rounds
take about four minutes.
"""

from __future__ import annotations

import importlib.util
import secrets
import statistics
import sys
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from benchmarks import measure
from benchmarks.bench_bridge import begin, load_config
from benchmarks.bench_dds import interval
from benchmarks.processes import RosGraph, bridge, peers, ros_domain
from rosplc.demo.processes import remove_objects
from rosplc_bench.process import cpu_clock

DEPTH = 5000
LOAD = (20, 200, 1.5)  # topics, rate in Hz, seconds of a round
WAYS = {"towards the PLC": ("empty", "copies", "bridge"), "each way": ("copies", "bridge")}


def loaded(name: str, way: str, topics: int, rate: int, seconds: float) -> dict[str, float]:
    """Carry a load once; return the processor's time per message in µs, and what was lost."""
    prefix, outs = f"bench-{secrets.token_hex(4)}", topics if way == "each way" else 0
    with ExitStack() as stack:
        graph = RosGraph(stack.enter_context(ros_domain()), "rclpy", "kilted")
        plan = {"topics": topics, "outs": outs, "count": round(rate * seconds), "rate": rate, "per_scan": 1}
        plan |= {"prefix": prefix, "qos_depth": DEPTH, "copies": name == "copies", **graph.plan()}
        if name == "bridge":
            folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
            config = load_config(prefix, topics, depth=4096, ros=graph.settings(), outs=outs)
            clock = cpu_clock(stack.enter_context(bridge(folder, config, graph.domain)).pid)
        else:
            stack.callback(remove_objects, prefix)
            (node,) = stack.enter_context(peers("plain", plan, graph.domain))
            clock = cpu_clock(node.pid)
        ends = stack.enter_context(peers("ros" if name == "empty" else "plc ros", plan, graph.domain))
        before = time.clock_gettime(clock)
        begin(*ends)
        sent = [topics * end.receive_json()["sent"] for end in ends]
        time.sleep(0.5)
        spent = time.clock_gettime(clock) - before
        if name == "empty":
            arrived = node.ask("")["count"]
        else:
            seen = [tally for end in reversed(ends) for tally in end.ask("stop")["seen"].values()]
            arrived = sum(tally["received"] for tally in seen)
    return {"spent": 1e6 * spent / arrived, "lost": (sum(sent) if outs else sent[-1]) - arrived}


def one_way(way: str, rounds: int, load: tuple[int, int, float]) -> dict[str, Any]:
    """Return the table of a way; the bridge has its ratio to each node of rclpy alone."""
    found: dict[str, list[dict[str, float]]] = {name: [] for name in WAYS[way]}
    for number in range(rounds):
        print(f"{way}: round {number + 1} of {rounds}", file=sys.stderr)
        for name, kept in found.items():
            kept.append(loaded(name, way, *load))
    spent = {name: [one["spent"] for one in kept] for name, kept in found.items()}
    rows = []
    for name, values in spent.items():
        ratios = [mine / its for mine, its in zip(spent["bridge"], values, strict=True)]
        lowest, highest = interval(ratios)
        more = {"bridge to it": statistics.median(ratios), "lowest": lowest, "highest": highest}
        rows.append(measure.row(name, values, **(more if name != "bridge" else {})))
    facts = {f"lost, {name}": sum(one["lost"] for one in kept) for name, kept in found.items()}
    waiting = "all sleep until the middleware wakes them, and poll every 1 ms towards ROS"
    return measure.table(
        f"{load[0]} topics x {load[1]} Hz {way}, CPU", "µs per message", waiting, rows, facts
    )


def run(rounds: int, load: tuple[int, int, float] = LOAD) -> dict[str, Any]:
    """Measure in ``rounds`` rounds; returns a :func:`measure.report`.

    Args:
        rounds: How often each takes its turn.
        load: Topics, each way where both are measured, rate in Hz and seconds of a round.
    """
    before = measure.environment()
    if importlib.util.find_spec("rclpy") is None:
        print("not run: rclpy is not installed (`make ros2-env`)", file=sys.stderr)
        return measure.report([], before)
    return measure.report([one_way(way, rounds, load) for way in WAYS], before)


if __name__ == "__main__":
    measure.main(run, __doc__, 9)
