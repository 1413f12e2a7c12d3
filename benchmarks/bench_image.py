"""Camera images over DDS: the bridge beside a node written in C by hand, processor's time per image.

usage: python -m benchmarks.bench_image [--rounds N] [--json]

The node is that of bench_dds.py (dds_node.c). Images of 1920 x 1080 x 3 bytes pass one way, then the other,
at 30 Hz, by turns through both; every byte is checked where it arrives. Unless CYCLONEDDS_URI is set, DDS has
large packets and receive buffers, in all programs. Needs gcc, and net.core.rmem_max of 4 MiB.
"""

from __future__ import annotations

import os
import secrets
import statistics
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from benchmarks import measure
from benchmarks.bench_bridge import begin
from benchmarks.bench_dds import Carried, OverDds, carrying, interval
from benchmarks.peers import IMAGE, STRING, image_layout, names
from benchmarks.processes import cpu_seconds, peers

SIZE = 1920 * 1080 * 3
LOAD = (30, 4.0)  # images per second, seconds of a round
SLOTS, DEPTH = 8, 32
TUNED = (  # as ROS' pages advise for large messages: with the defaults neither keeps up with 30 Hz
    '<CycloneDDS><Domain id="any"><General><MaxMessageSize>65500B</MaxMessageSize><FragmentSize>64000B'
    '</FragmentSize></General><Internal><SocketReceiveBufferSize min="4MB"/></Internal></Domain></CycloneDDS>'
)
# glibc gives the memory of every image back to the kernel, or of none: that depends on what else a process
# has allocated. A peer that takes it page by page again is too slow for its receive buffer, and its sender
# repeats: that would measure the peer. These hold for the peers alone.
PEERS = {"MALLOC_MMAP_THRESHOLD_": str(32 << 20), "MALLOC_TRIM_THRESHOLD_": str(1 << 30)}
WAYS = {"in": "ROS to PLC", "out": "PLC to ROS"}


def carried(name: str, over: OverDds, way: str, size: int, load: tuple[int, float]) -> tuple[float, int]:
    """Carry images once; return the processor's time per image in ms, and what was lost."""
    prefix, (rate, seconds) = f"bench-{secrets.token_hex(4)}", load
    topics, to = names(way, 1), {"in": "plc", "out": "ros, latched: false"}[way]
    common = f"type: {IMAGE}, limits: {{string: {STRING}, data: {size}}}, slots: {SLOTS}, every: true"
    head = [f"bridge: {prefix}", f"prefix: {prefix}", "ros: {backend: dds, distro: jazzy}", "topics:"]
    config = "\n".join([*head, f"  {topics[0]}: {{to: {to}, {common}, qos: {{depth: {DEPTH}}}}}", ""])
    ends = (topics, []) if way == "in" else ([], topics)
    what = Carried("image", image_layout(size), SLOTS, DEPTH)
    plan = {"topics": 0, f"{way}s": 1, "image": size, "count": round(rate * seconds), "rate": rate}
    plan |= {"per_scan": 1, "qos_depth": DEPTH, "prefix": prefix}
    with (
        over.graph() as graph,
        carrying(name, over, prefix, graph, config, *ends, what) as pid,
        peers("plc ros", plan | graph.plan(), graph.domain, PEERS) as (plc, ros),
    ):
        before = sum(cpu_seconds(pid))
        begin(plc, ros)
        for side in (plc, ros):
            side.receive_json()
        time.sleep(0.5)
        spent = max(0.01, sum(cpu_seconds(pid)) - before)  # it is counted in ticks of 10 ms
        seen = [each.ask("stop")["seen"] for each in (ros, plc)]
    tallies = [tally for found in seen for tally in found.values()]
    arrived = sum(tally["received"] for tally in tallies)
    lost = plan["count"] - arrived + sum(tally["wrong"] for tally in tallies)
    return 1e3 * spent / arrived, lost


def run(rounds: int, size: int = SIZE, load: tuple[int, float] = LOAD) -> dict[str, Any]:
    """Measure in ``rounds`` rounds; returns a :func:`measure.report`. ``load``: images/s, seconds."""
    os.environ.setdefault("CYCLONEDDS_URI", TUNED)
    before, over = measure.environment(), OverDds()
    contenders = over.contenders
    found: dict[tuple[str, str], list[tuple[float, int]]] = {
        (way, name): [] for way in WAYS for name in contenders
    }
    with tempfile.TemporaryDirectory() as folder:
        over.compile(Path(folder))
        for number in range(rounds):
            print(f"round {number + 1} of {rounds}", file=sys.stderr)
            for (way, name), kept in found.items():
                kept.append(carried(name, over, way, size, load))
    rows, facts = [], {}
    for way, words in WAYS.items():
        node, bridge = ([ms for ms, _ in found[way, name]] for name in contenders)
        ratios = [mine / its for mine, its in zip(bridge, node, strict=True)]
        lowest, highest = interval(ratios)
        more = {"ratio": statistics.median(ratios), "lowest": lowest, "highest": highest}
        rows += [measure.row(f"C node, {words}", node), measure.row(f"bridge, {words}", bridge, **more)]
        facts |= {f"lost, {name}, {words}": sum(n for _, n in found[way, name]) for name in contenders}
    waiting = "both sleep in a waitset towards the PLC, and poll every 1 ms towards ROS"
    return measure.report(
        [measure.table(f"{size} B, {load[0]} Hz", "ms of CPU time per image", waiting, rows, facts)], before
    )


if __name__ == "__main__":
    measure.main(run, __doc__, 9)
