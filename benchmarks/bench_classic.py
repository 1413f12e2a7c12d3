"""Classic mode against the default channel: the same bridge, message, peer and run.

usage: python -m benchmarks.bench_classic [--rounds N] [--json]

The bridge carries over the in-process ROS graph, so that what is compared is the way between bridge and
PLC alone. The PLC's half is another process (Python). "held" means that it stops for 2 ms every 10 ms
(reading) or per message (writing), inside the classic lock, as a task does that is preempted there. While it
reads it sees nothing of the default channel either in these 2 ms; what that channel has not is a lock.
"""

from __future__ import annotations

import json
import secrets
import struct
import tempfile
import threading
import time
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from benchmarks import measure
from benchmarks.processes import peers
from rosplc.bridge import Bridge
from rosplc.config import parse_config, resolve
from rosplc.ros import DEFAULT
from rosplc.ros.memory import open_backend
from rosplc_bench.process import Side

TYPE = "bench_msgs/msg/Stamped"
SIZE = 200
MESSAGES = 1000
TOPICS = 10
HOLD_US = 2000
KINDS = ("classic", "channel")
_HEADER = b"\0\1\0\0"


def config(prefix: str, folder: Path, topics: int) -> str:
    """Return a configuration with the same topics as channels and as classic memories."""
    (folder / "bench_msgs" / "msg").mkdir(parents=True)
    (folder / "bench_msgs" / "msg" / "Stamped.msg").write_text(f"int64 sent\nuint8[{SIZE - 8}] rest\n")
    lines = [f"prefix: {prefix}", f"types: {{paths: [{folder}]}}", "diagnostics: {enabled: false}", "topics:"]
    for number in range(topics):
        for way, to in (("in", "plc"), ("out", "ros")):
            common = f"type: {TYPE}, to: {to}, latched: false"
            name = f"classic: {{name: {prefix}-classic-{way}{number}, recover_after: 1h}}"
            lines.append(f"  /classic/{way}{number}: {{{common}, {name}}}")
            lines.append(f"  /channel/{way}{number}: {{{common}}}")
    return "\n".join((*lines, ""))


class Setting:
    """A running bridge with publishers and subscribers on its ROS side."""

    def __init__(self, stack: ExitStack, prefix: str, topics: int) -> None:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        project = resolve(parse_config(config(prefix, folder, topics)))
        domain = secrets.randbelow(200)
        side = open_backend(project.store, "bridge", domain=domain)
        self.ros = open_backend(project.store, "peer", domain=domain)
        stack.callback(side.close)
        stack.callback(self.ros.close)
        stack.callback(lambda: [path.unlink() for path in Path("/dev/shm").glob(f"*{prefix}*")])
        self.got: dict[str, list[float]] = {kind: [] for kind in KINDS}
        self.publishers = {
            kind: [self.ros.advertise(f"/{kind}/in{n}", TYPE, DEFAULT) for n in range(topics)]
            for kind in KINDS
        }
        for kind in KINDS:
            for number in range(topics):
                self.ros.subscribe(f"/{kind}/out{number}", TYPE, DEFAULT, self._receiver(kind))
        stack.enter_context(Bridge(project, side))

    def _receiver(self, kind: str) -> Any:
        got = self.got[kind]

        def receive(data: bytes, _stamp_ns: int) -> None:
            got.append((time.monotonic_ns() - struct.unpack_from("<q", data, 4)[0]) / 1000)

        return receive

    def publish(self, kind: str, number: int = 0) -> None:
        """Publish a message with the present time."""
        body = struct.pack("<q", time.monotonic_ns()) + bytes(SIZE - 8)
        self.publishers[kind][number].write(_HEADER + body, 0)


def way_in(setting: Setting, plc: Side, messages: int, hold_us: int) -> dict[str, list[float]]:
    """Measure ROS → PLC by turns over both ways."""
    plc.send(json.dumps({"do": "read", "seconds": messages * 0.002 + 0.2, "hold_us": hold_us}))
    time.sleep(0.1)
    due = time.monotonic()
    for number in range(2 * messages):
        setting.publish(KINDS[number % 2])
        due += 0.001
        time.sleep(max(0.0, due - time.monotonic()))
    ages: dict[str, list[float]] = plc.receive_json()["ages"]
    if not all(ages.values()):  # a machine so busy that the PLC was hardly run: nothing to compare
        return way_in(setting, plc, messages, hold_us)
    return ages


def way_out(setting: Setting, plc: Side, kind: str, messages: int, hold_us: int) -> list[float]:
    """Measure PLC → ROS over one way."""
    setting.got[kind].clear()
    plc.ask(do="write", kind=kind, topics=1, rate=200, count=messages, hold_us=hold_us)
    deadline = time.monotonic() + 60
    while not setting.got[kind] and time.monotonic() < deadline:
        time.sleep(0.01)
    time.sleep(0.1)
    return list(setting.got[kind])


def load(setting: Setting, plc: Side, kind: str, topics: int, count: int) -> tuple[float, float]:
    """Return the bridge process' share of a core, and how much of what was written arrived."""
    setting.got[kind].clear()
    started, used = time.monotonic(), time.process_time()
    written = plc.ask(do="write", kind=kind, topics=topics, rate=1000, count=count, hold_us=0)["written"]
    share = (time.process_time() - used) / (time.monotonic() - started)
    time.sleep(0.1)
    return share * 100, 100 * len(setting.got[kind]) / written


def row(name: str, values: list[float], sent: int) -> dict[str, Any]:
    """Return a row with how many of those sent arrived."""
    return measure.row(name, values, arrived=f"{100 * len(values) / sent:.1f} %")


def run(rounds: int, messages: int = MESSAGES, topics: int = TOPICS) -> dict[str, Any]:
    """Measure in ``rounds`` rounds; returns a :func:`measure.report`."""
    before = measure.environment()
    prefix = f"bench{secrets.token_hex(4)}"
    inward: dict[str, list[float]] = {}
    outward: dict[str, list[float]] = {}
    loads: dict[str, list[float]] = {}
    shares: dict[str, list[float]] = {}
    with ExitStack() as stack:
        setting = Setting(stack, prefix, topics)
        (plc,) = stack.enter_context(peers("classic_plc", {"prefix": prefix, "size": SIZE}))
        way_in(setting, plc, 10, 0)
        for _ in range(rounds):
            for word, hold in (("", 0), (", held", HOLD_US)):
                for kind, ages in way_in(setting, plc, messages, hold).items():
                    inward.setdefault(kind + word, []).extend(ages)
                for kind in KINDS:
                    held = hold if kind == "classic" else 0
                    outward.setdefault(kind + word, []).extend(
                        way_out(setting, plc, kind, messages // 5, held)
                    )
            for kind in KINDS:
                share, arrived = load(setting, plc, kind, topics, messages)
                loads.setdefault(kind, []).append(share)
                shares.setdefault(kind, []).append(arrived)
        threads = threading.active_count()
    sent_in, sent_out = rounds * messages, rounds * (messages // 5)
    tables = [
        measure.table(
            f"ROS to PLC, {SIZE} B, 500 Hz each",
            "µs",
            "the PLC polls every 0.1 ms",
            [row(name, values, sent_in) for name, values in inward.items()],
        ),
        measure.table(
            f"PLC to ROS, {SIZE} B, 200 Hz",
            "µs",
            "the bridge ticks every 1 ms in both",
            [row(name, values, sent_out) for name, values in outward.items()],
        ),
        measure.table(
            f"CPU of the process with bridge and ROS side, {topics} topics × 1 kHz to ROS",
            "% of a core",
            "the bridge ticks every 1 ms; the PLC sleeps between cycles",
            [
                measure.row(name, values, arrived=f"{sum(shares[name]) / rounds:.1f} %")
                for name, values in loads.items()
            ],
            {"threads": threads},
        ),
    ]
    return measure.report(tables, before)


if __name__ == "__main__":
    measure.main(run, __doc__, 5)
