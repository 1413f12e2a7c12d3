"""What `rosplc top`, `rosplc web` and `rosplc record` cost beside a bridge, and how much record takes.

usage: python -m benchmarks.bench_views [--rounds N] [--json]

The bridge carries 20 topics x 1 kHz, half of them each way, over DDS. In every round each view runs for some
seconds, and so does none: what is compared are the bridge's share of a core and the time from the PLC's
publication to a bare DDS subscriber, as ratios to the same round without a view. Then, without bridge and
ROS, channels are filled at growing rates while a recorder takes them into a file on this machine's
temporary folder: which share of the messages it lost, and what it cost. Last, where Chromium and the
packages of the tests are installed, the page of `rosplc web` with 200 channels (benchmarks/web_page.py).
"""

from __future__ import annotations

import json
import secrets
import statistics
import tempfile
import time
from contextlib import ExitStack
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from benchmarks import measure, web_page
from benchmarks.bench_bridge import begin, latency_topics, load_config
from benchmarks.peers import SENT, TO_ROS
from benchmarks.processes import RosGraph, bridge, cpu_seconds, peers, ros_domain, share
from benchmarks.views import VIEWS, recorder, view
from rosplc.demo.processes import remove_objects
from rosplc_bench.process import Side

TOPICS = 20
RATE = 1000
ROUND_S = 5.0
SETTLE_S = 3.0
PINGS = 100  # a second
RATES = (1000, 4000, 8000, 16000, 32000)
DEPTHS = (4, 16, 64, 256)


def arrived(subscriber: Side, count: int) -> dict[str, list[float]]:
    """Return the ages of the messages through the bridge, once they are there, or after three seconds."""
    got: dict[str, list[float]] = {TO_ROS: [], SENT: []}
    for _ in range(30):
        time.sleep(0.1)
        for name, ages in subscriber.ask("")["ages"].items():
            got.setdefault(name, []).extend(ages)
        if len(got[TO_ROS]) >= count:
            break
    return got


def views(rounds: int, topics: int, rate: int, seconds: float, settle: float) -> list[dict[str, Any]]:
    """Measure every view beside a busy bridge, by turns."""
    prefix = f"bench-{secrets.token_hex(4)}"
    turns = rounds * len(VIEWS)
    # More than can be needed: what a view takes to start is not known.
    count = round(rate * turns * (seconds + settle + 20))
    plan: dict[str, Any] = {"topics": topics // 2, "count": count, "rate": rate, "per_scan": 1}
    cpu: dict[str, list[float]] = {}
    own: dict[str, list[float]] = {}
    ages: dict[str, list[list[float]]] = {}
    recorded: list[dict[str, Any]] = []
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        domain = stack.enter_context(ros_domain())
        plan |= {"qos_depth": 5000, "prefix": prefix, **RosGraph(domain).plan()}
        text = load_config(prefix, topics // 2, depth=4096, more=latency_topics())
        process = stack.enter_context(bridge(folder, text, domain))
        plc, ros, subscriber, source = stack.enter_context(peers("plc ros subscriber source", plan, domain))
        begin(plc, ros)
        for _ in range(rounds):
            for kind in VIEWS:
                with view(kind, prefix, folder, domain) as running:
                    time.sleep(settle)
                    subscriber.ask("")
                    source.send(f"out {PINGS} {round(PINGS * seconds)}")
                    pids = {"bridge": process.pid} | ({"view": running.pid} if running.pid else {})
                    found = share(pids, seconds, 1)
                    source.receive()
                    got = arrived(subscriber, round(PINGS * seconds))
                cpu.setdefault(kind, []).append(found["bridge"][0])
                ages.setdefault(kind, []).append(got[TO_ROS])
                ages.setdefault(f"{kind}, {SENT}", []).append(got[SENT])
                if running.pid:
                    own.setdefault(kind, []).append(found["view"][0])
                if running.facts is not None:
                    recorded.append(running.facts)
    title = f"{topics} topics x {rate} Hz"
    beside = [
        measure.row(f"bridge, beside {kind}", values, ratio=measure.median_ratio(values, cpu["nothing"]))
        for kind, values in cpu.items()
    ]
    beside += [measure.row(f"{kind} itself", values) for kind, values in own.items()]
    facts = {
        "recorded": sum(one["received"] for one in recorded),
        "lost by record": sum(one["lost"] for one in recorded),
    }
    late = []
    for name, groups in ages.items():
        alone = ages["nothing" if SENT not in name else f"nothing, {SENT}"]
        ratios = [
            statistics.median(one) / statistics.median(other)
            for one, other in zip(groups, alone, strict=True)
            if one and other
        ]
        if ratios:  # else the machine is too busy for anything to arrive, and the row is left out
            values = [age for one in groups for age in one]
            late.append(measure.row(f"beside {name}", values, ratio=statistics.median(ratios)))
    waiting = "top polls every 500 ms, web whenever its page requests data, record and the bridge every 1 ms"
    return [
        measure.table(f"{title}: CPU", "% of a core", waiting, beside, facts),
        measure.table(f"{title}: PLC → bridge → DDS", "µs", waiting, late),
    ]


def record(topics: int, rate: int, slots: int, seconds: float, folder: Path) -> dict[str, float]:
    """Fill channels at a rate while a recorder takes them; return what it lost and cost."""
    prefix = f"bench-{secrets.token_hex(4)}"
    out = folder / "rate.mcap"
    out.unlink(missing_ok=True)
    count = round(rate * seconds)
    plan = {"prefix": prefix, "topics": topics, "rate": rate, "count": count, "slots": slots}
    with peers("feeder", plan) as (feeder,), recorder(prefix, out) as process:
        before, began = sum(cpu_seconds(process.pid)), time.monotonic()
        feeder.send("go")
        sent = feeder.receive_json(seconds + 60)
        used = 100 * (sum(cpu_seconds(process.pid)) - before) / (time.monotonic() - began)
        time.sleep(0.5)
        process.terminate()
        facts = json.loads(process.communicate()[0])
    remove_objects(prefix)
    missing = sent["sent"] * topics - facts["received"]
    return {
        "lost": 100 * missing / (sent["sent"] * topics),
        "uncounted": missing - facts["lost"],
        "cpu": used,
        "hz": sent["sent"] / sent["seconds"],
        "mb": out.stat().st_size / 1e6 / seconds,
    }


def rates(
    rounds: int, topics: int, steps: tuple[int, ...], depths: tuple[int, ...], seconds: float
) -> list[dict[str, Any]]:
    """Record at growing rates from deep channels, and at 1 kHz from shallow ones."""
    ways = {f"{rate} Hz, depth 4096": (rate, 4096) for rate in steps}
    ways |= {f"{RATE} Hz, depth {depth}": (RATE, depth) for depth in depths}
    found: dict[str, list[dict[str, float]]] = {}
    with tempfile.TemporaryDirectory() as folder:
        for _ in range(rounds):
            for name, (rate, depth) in ways.items():
                found.setdefault(name, []).append(record(topics, rate, depth, seconds, Path(folder)))
    rows = []
    for name, results in found.items():
        middle = {key: statistics.median(one[key] for one in results) for key in results[0]}
        worst = max(one["lost"] for one in results)
        more = {"worst": worst, "CPU %": middle["cpu"], "Hz reached": middle["hz"], "MB/s": middle["mb"]}
        rows.append(measure.row(name, [one["lost"] for one in results], **more))
    whole = [name for name, results in found.items() if not any(one["lost"] for one in results)]
    facts = {
        "without any loss": "; ".join(whole) or "none",
        "losses that were not counted": sum(
            one["uncounted"] for results in found.values() for one in results
        ),
    }
    title = f"record, {topics} topics of 200 B"
    return [measure.table(title, "% lost", "the recorder polls every 1 ms; nothing else reads", rows, facts)]


def run(
    rounds: int,
    topics: int = TOPICS,
    rate: int = RATE,
    seconds: float = ROUND_S,
    settle: float = SETTLE_S,
    steps: tuple[int, ...] = RATES,
    depths: tuple[int, ...] = DEPTHS,
    browser: bool = True,
) -> dict[str, Any]:
    """Measure in ``rounds`` rounds; returns a :func:`measure.report`."""
    before = measure.environment()
    tables = views(rounds, topics, rate, seconds, settle) + rates(rounds, topics, steps, depths, seconds)
    if browser and Path(web_page.CHROMIUM).exists() and find_spec("playwright") is not None:
        tables += web_page.run(rounds)["tables"]
    return measure.report(tables, before)


if __name__ == "__main__":
    measure.main(run, __doc__, 3)
