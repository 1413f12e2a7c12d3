"""A service's round trip ROS, PLC's block, ROS, beside servers without a bridge.

usage: python -m benchmarks.bench_services [--rounds N] [--json]

One client calls all servers by turns, one call at a time: one in the same backend (bare), one of rclpy alone
where that is installed, and function blocks behind a bridge, in a task of 1 ms and in one of 10 ms. Run it
with the Python of ``make ros2-env`` for rclpy; Fast DDS and the backend ``dds`` do not speak to each other.
"""

from __future__ import annotations

import importlib.util
import os
import statistics
import tempfile
import threading
import time
from collections.abc import Sequence
from contextlib import ExitStack
from itertools import chain
from pathlib import Path
from typing import Any
from unittest.mock import patch

from benchmarks import measure, peers, processes
from rosplc.codec import Codec, Wire
from rosplc.layout import compute_layout
from rosplc.model import TypeStore
from rosplc.ros import SERVICES, Reply, ServiceClient

TYPE = "std_srvs/srv/SetBool"
SCANS = {"block, scan of 1 ms": 0.001, "block, scan of 10 ms": 0.01}
CALLS = 200
WATCHDOG_S = 60.0


def available(wanted: Sequence[str] | None) -> tuple[list[str], dict[str, str]]:
    """Return the backends to measure on, and why others are not."""
    needed = {"dds": "cyclonedds", "rclpy": "rclpy"}
    absent = {
        name: f"{what} is not installed"
        for name, what in needed.items()
        if not importlib.util.find_spec(what)
    }
    return [name for name in wanted or needed if name not in absent], absent


def ready(client: ServiceClient, what: str) -> None:
    """Wait until a server answers."""
    deadline = time.monotonic() + WATCHDOG_S
    while not client.ready:
        if time.monotonic() > deadline:
            raise RuntimeError(f"{what}: no server was found")
        time.sleep(0.01)


def call(client: ServiceClient, request: bytes) -> float | None:
    """Return how long a call took, in microseconds; None if no answer came."""
    came, answers = threading.Event(), []

    def on_reply(reply: Reply) -> None:
        answers.append(reply)
        came.set()

    began = time.perf_counter_ns()
    number = client.call(request, on_reply)
    if not came.wait(5):
        client.forget(number)
        return None
    spent = (time.perf_counter_ns() - began) / 1000
    return spent if answers[0].payload is not None else None


def one_backend(name: str, rounds: int, calls: int) -> dict[str, Any]:
    """Measure all servers over one backend."""
    store = TypeStore.bundled("jazzy")
    request, response = (
        codec.encode(codec.layout.pack({"data": True} if part == "Request" else {"message": "done"}))
        for part in ("Request", "Response")
        for codec in [Codec(compute_layout(store, f"{TYPE}_{part}"), Wire.CDR)]
    )
    services = {"bare": "/bench/bare", **{title: f"/bench/block{n}" for n, title in enumerate(SCANS)}}
    if name == "rclpy":
        services["rclpy alone"] = "/bench/plain"
    with ExitStack() as stack:
        domain = stack.enter_context(processes.ros_domain())
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        prefix = f"benchsrv{domain}"
        lines = [f"prefix: {prefix}", f"ros: {{backend: {name}, domain: {domain}}}", "services:"]
        lines += [f"  {services[title]}: {{type: {TYPE}, server: plc}}" for title in SCANS]
        stack.enter_context(processes.bridge(folder, "\n".join([*lines, ""]), domain))
        plan = {
            "backend": name,
            "domain": domain,
            "prefix": prefix,
            "type": TYPE,
            "response": response.hex(),
            "bare": [services["bare"]],
            "rclpy": [services[title] for title in services if title == "rclpy alone"],
            "blocks": {services[title]: seconds for title, seconds in SCANS.items()},
        }
        stack.enter_context(processes.peers("answerer service_plc", plan, domain))
        stack.enter_context(patch.dict(os.environ, processes.environment(domain)))
        ros = peers.connect(plan, "client")
        stack.callback(ros.close)
        clients = {title: ros.client(service, TYPE, SERVICES) for title, service in services.items()}
        for title, client in clients.items():
            ready(client, title)
            deadline = time.monotonic() + WATCHDOG_S
            while call(client, request) is None:  # the PLC's tasks have just started
                if time.monotonic() > deadline:
                    raise RuntimeError(f"{title}: no call was answered")
        spent: dict[str, list[list[float]]] = {title: [] for title in clients}
        lost = dict.fromkeys(clients, 0)
        for _ in range(rounds):
            found: dict[str, list[float]] = {title: [] for title in clients}
            for _ in range(calls):
                for title, client in clients.items():
                    took = call(client, request)
                    lost[title] += took is None
                    found[title] += [] if took is None else [took]
            for title, values in found.items():
                spent[title].append(values)
    rows = []
    for title, per_round in spent.items():
        ratios = [
            statistics.median(these) / statistics.median(those)
            for these, those in zip(per_round, spent["bare"], strict=True)
        ]
        more = {"to bare": statistics.median(ratios), "lowest": min(ratios), "highest": max(ratios)}
        rows.append(measure.row(title, list(chain.from_iterable(per_round)), **more, unanswered=lost[title]))
    waiting = (
        "threads of the backend wake the client and the servers; the bridge polls every 1 ms; a PLC task "
        "sleeps between scans, receives a call in one scan and responds in the next; ratios compare the "
        "medians of each round"
    )
    return measure.table(f"{name}: {TYPE}, round trip", "µs", waiting, rows)


def run(rounds: int, wanted: Sequence[str] | None = None, calls: int = CALLS) -> dict[str, Any]:
    """Measure over each backend that is installed, and name those that are not."""
    before = measure.environment()
    names, absent = available(wanted)
    tables = [one_backend(name, rounds, calls) for name in names]
    for table in tables[:1]:
        table["facts"].update({f"not run, {name}": why for name, why in absent.items()})
    return measure.report(tables, before)


if __name__ == "__main__":
    measure.main(run, __doc__, 10)
