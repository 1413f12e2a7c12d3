"""The latency that the bridge adds, against a bare DDS subscriber of the same publisher's messages.

usage: python benchmarks/bench_bridge_latency.py [--rounds N] [--json]

One publisher sends a PoseStamped of about 200 bytes by turns to a bare cyclonedds subscriber and
through the bridge: so both meet the same machine. Towards the PLC the way ends when a spinning
reader holds the record. From the PLC it begins with the publication in shared memory; the time until
the bridge has taken the message, at its next tick, is told apart. Everything stays on this
machine's loopback interface.
"""

from __future__ import annotations

import os
import secrets
import statistics
import sys
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path
from typing import Any

if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks import measure
from benchmarks.latency_peers import BARE, SENT, TO_PLC, TO_ROS
from benchmarks.load_peers import STRING, TYPE
from benchmarks.processes import Peer, bridge, ros_domain

MESSAGES = {1000: 2000, 100: 200}  # per round, by rate in Hz
BARE_WAITS = "publisher: sleeps between messages; bare subscriber: WaitSet"


def config(prefix: str) -> str:
    """Return the configuration of the bridge that is measured."""
    common = f"type: {TYPE}, limits: {{string: {STRING}}}"
    return "\n".join(
        (
            f"bridge: {prefix}",
            f"prefix: {prefix}",
            "ros: {backend: dds, distro: jazzy}",
            "topics:",
            f"  {TO_PLC}: {{to: plc, {common}}}",
            f"  {TO_ROS}: {{to: ros, {common}, latched: false}}",
            "",
        )
    )


def place(pids: list[int], cores: set[int]) -> None:
    """Bind all threads of processes to cores."""
    for pid in pids:
        for thread in os.listdir(f"/proc/{pid}/task"):
            os.sched_setaffinity(int(thread), cores)


def ask(peer: Peer) -> dict[str, list[float]]:
    """Return the ages that a receiver has gathered."""
    peer.tell("")
    ages: dict[str, list[float]] = peer.hear()["ages"]
    return ages


def way_in(source: Peer, subscriber: Peer, spinner: Peer, rate: int, count: int) -> dict[str, list[float]]:
    """Measure one round of DDS → PLC against DDS → subscriber."""
    source.tell(f"in {rate} {count}")
    source.hear()
    time.sleep(0.1)
    return {"bare": ask(subscriber)[BARE], "bridge": ask(spinner)[TO_PLC]}


def way_out(source: Peer, subscriber: Peer, rate: int, count: int) -> dict[str, list[float]]:
    """Measure one round of PLC → DDS against DDS → subscriber."""
    source.tell(f"out {rate} {count}")
    source.hear()
    time.sleep(0.1)
    ages = ask(subscriber)
    whole, after = ages[TO_ROS], ages[SENT]
    tick = [age - later for age, later in zip(whole, after, strict=True)]
    return {"bare": ages[BARE], "whole": whole, "tick": tick, "after": after}


def gather(rounds: list[dict[str, list[float]]]) -> tuple[dict[str, list[float]], Any]:
    """Return all values by name, and a function: the median over rounds of a name's median to bare's."""
    values = {name: [value for one in rounds for value in one[name]] for name in rounds[0]}

    def ratio(name: str) -> float:
        return statistics.median(
            statistics.median(one[name]) / statistics.median(one["bare"]) for one in rounds
        )

    return values, ratio


def tables_of(rate: int, inward: list[dict[str, list[float]]], outward: list[Any]) -> list[dict[str, Any]]:
    """Return both directions' tables for a rate."""
    values, ratio = gather(inward)
    size = "PoseStamped of 200 B"
    first = measure.table(
        f"ROS to PLC, {size}, {rate} Hz on each path",
        "µs",
        f"{BARE_WAITS}; bridge: WaitSet; PLC: spins on a core of its own",
        [
            measure.row("DDS → bare subscriber", values["bare"], ratio=1.0),
            measure.row("DDS → bridge → PLC record", values["bridge"], ratio=ratio("bridge")),
        ],
    )
    values, ratio = gather(outward)
    second = measure.table(
        f"PLC to ROS, {size}, {rate} Hz on each path",
        "µs",
        f"{BARE_WAITS}; bridge: ticks every 1 ms",
        [
            measure.row("DDS → bare subscriber", values["bare"], ratio=1.0),
            measure.row("PLC → bridge → DDS, without tick", values["after"], ratio=ratio("after")),
            measure.row("the bridge's tick", values["tick"]),
            measure.row("PLC → bridge → DDS, whole", values["whole"], ratio=ratio("whole")),
        ],
    )
    return [first, second]


def run(rounds: int, messages: dict[int, int] = MESSAGES) -> dict[str, Any]:
    """Measure in ``rounds`` rounds; returns a :func:`measure.report`."""
    before = measure.environment()
    prefix = f"bench-{secrets.token_hex(4)}"
    inward: dict[int, list[Any]] = {rate: [] for rate in messages}
    outward: dict[int, list[Any]] = {rate: [] for rate in messages}
    order = {"prefix": prefix}
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        domain = stack.enter_context(ros_domain())
        process = stack.enter_context(bridge(folder, config(prefix), domain))
        subscriber = stack.enter_context(Peer("latency_peers", "subscriber", order, domain))
        source = stack.enter_context(Peer("latency_peers", "source", order, domain))
        for peer in (subscriber, source):
            peer.hear()
        for peer_rate in messages:  # everything has run once before anything counts
            way_out(source, subscriber, peer_rate, 10)
        cores = os.sched_getaffinity(0)
        others = cores - {max(cores)} or cores
        for _ in range(rounds):
            place([process.pid, source.pid, subscriber.pid], others)
            with Peer("latency_peers", "spinner", order, domain) as spinner:
                spinner.hear()
                place([spinner.pid], {max(cores)})
                for rate, count in messages.items():
                    inward[rate].append(way_in(source, subscriber, spinner, rate, count))
            place([process.pid, source.pid, subscriber.pid], cores)
            for rate, count in messages.items():
                outward[rate].append(way_out(source, subscriber, rate, count))
    tables = [one for rate in messages for one in tables_of(rate, inward[rate], outward[rate])]
    return measure.report(tables, before)


if __name__ == "__main__":
    measure.main(run, __doc__, 5)
