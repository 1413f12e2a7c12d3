"""Each side is killed in turn, and the others see it and do what the configuration says."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from tests.lib.waiting import wait_for

pytest.importorskip("cyclonedds", exc_type=ImportError)

from rosplc.bridge.diagnostics import TOPIC as DIAGNOSTICS
from rosplc.bridge.diagnostics import TYPE as DIAGNOSTICS_TYPE
from rosplc.codec import Codec, Wire
from rosplc.layout import Limits, compute_layout
from rosplc.model import TypeStore
from rosplc.ros import DEFAULT, Qos, open_backend
from tests.e2e.fail_safe_peers import INT, SAFE

pytestmark = [pytest.mark.timeout(240), pytest.mark.verifies("fail-safe", own="the virtual PLC over DDS")]

WATCHDOG_S = 100.0
SUBSTITUTE = -9
STORE = TypeStore.bundled("jazzy")
# A participant that was killed is missed after a second instead of Cyclone's ten.
LEASE = "<CycloneDDS><Domain><Discovery><LeaseDuration>1s</LeaseDuration></Discovery></Domain></CycloneDDS>"


class Process:
    """A process that can be killed; lines of JSON that it prints are kept."""

    def __init__(self, arguments: list[str], environment: dict[str, str], log: Path) -> None:
        self.lines: list[dict[str, Any]] = []
        with log.open("ab") as errors:
            self._process = subprocess.Popen(
                [sys.executable, *arguments],
                env=environment,
                stdout=subprocess.PIPE,
                stderr=errors,
                text=True,
            )
        threading.Thread(target=self._listen, daemon=True).start()

    def _listen(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            if line.startswith("{") and line.endswith("}\n"):
                self.lines.append(json.loads(line))

    def kill(self) -> None:
        self._process.kill()
        self._process.wait()

    def news(self) -> list[str]:
        """Return the messages that the PLC took as new."""
        return [line["new"] for line in list(self.lines) if "new" in line]

    def state(self) -> dict[str, Any]:
        """Return what the PLC's program sees now."""
        states = [line["state"] for line in list(self.lines) if "state" in line]
        return states[-1] if states else {}


class Ros:
    """A node that listens to everything."""

    def __init__(self, domain: int, environment: dict[str, str]) -> None:
        self.heard: dict[str, list[dict[str, Any]]] = {}
        self._backend = open_backend("dds", STORE, "observer", domain=domain, environment=environment)
        latched = Qos(durability="transient_local", depth=100)
        self.subscriptions = {
            topic: self._listen(topic, type_name, qos)
            for topic, type_name, qos in (
                ("/state", INT, DEFAULT),
                ("/state/substituted", "std_msgs/msg/Bool", latched),
                (DIAGNOSTICS, DIAGNOSTICS_TYPE, DEFAULT),
            )
        }

    def _listen(self, topic: str, type_name: str, qos: Qos) -> Any:
        layout = compute_layout(STORE, type_name, Limits(string=300, sequence=40))
        codec = Codec(layout, Wire.CDR)
        heard = self.heard.setdefault(topic, [])
        return self._backend.subscribe(
            topic, type_name, qos, lambda data, _: heard.append(layout.to_dict(codec.decode(data)))
        )

    def states(self) -> list[int]:
        return [message["data"] for message in list(self.heard["/state"])]

    def flags(self) -> list[bool]:
        return [message["data"] for message in list(self.heard["/state/substituted"])]

    def level(self, topic: str) -> int | None:
        """Return the level that the newest diagnostics have for a topic."""
        for message in reversed(list(self.heard[DIAGNOSTICS])):
            for status in message["status"]:
                if status["name"].endswith(topic):
                    level: int = status["level"]
                    return level
        return None

    def close(self) -> None:
        self._backend.close()


class Cell:
    """Three processes around one bridge's objects, each to be killed and started again."""

    def __init__(self, folder: Path, prefix: str, domain: int) -> None:
        self.environment = {
            **os.environ,
            "ROS_DOMAIN_ID": str(domain),
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
            "CYCLONEDDS_URI": LEASE,
        }
        self._prefix, self._folder = prefix, folder
        self._peers = str(Path(__file__).with_name("fail_safe_peers.py"))
        self._config = folder / "rosplc.yaml"
        self._config.write_text(
            f"bridge: cell\nprefix: {prefix}\nros: {{backend: dds}}\n"
            "diagnostics: {period: 100ms, debounce: 100ms}\ntopics:\n"
            f"  /cmd: {{type: {INT}, to: plc, every: true, stale_after: 600ms, "
            f"on_stale: {{value: {{data: {SAFE}}}}}}}\n"
            f"  /state: {{type: {INT}, to: ros, stale_after: 600ms, "
            f"on_stale: {{value: {{data: {SUBSTITUTE}}}, period: 50ms}}}}\n"
        )
        self.running: dict[str, Process] = {}

    def start(self, name: str, first: int = 0) -> Process:
        arguments = {
            "bridge": ["-m", "rosplc", "run", str(self._config)],
            "plc": [self._peers, "plc", self._prefix, str(first)],
            "ros": [self._peers, "ros", str(first)],
        }[name]
        self.running[name] = Process(arguments, self.environment, self._folder / f"{name}.log")
        return self.running[name]

    def kill(self, name: str) -> None:
        self.running.pop(name).kill()


@contextmanager
def cell_of(folder: Path, prefix: str, domain: int) -> Iterator[Cell]:
    cell = Cell(folder, prefix, domain)
    try:
        yield cell
    finally:
        for name in list(cell.running):
            cell.kill(name)


def falls(numbers: list[int]) -> list[tuple[int, int]]:
    """Return where a message came twice, out of order, or from nowhere."""
    return [(earlier, later) for earlier, later in pairwise(numbers) if later <= earlier]


def test_whoever_is_killed_both_sides_know_and_do_what_was_asked(
    tmp_path: Path, shm_prefix: str, dds_domain: int
) -> None:
    """Publisher, PLC and bridge die by SIGKILL and come back; nothing is invented, repeated or mistaken."""
    with cell_of(tmp_path, shm_prefix, dds_domain) as cell:
        ros = Ros(dds_domain, cell.environment)
        try:
            cell.start("bridge")
            plc = cell.start("plc")
            cell.start("ros", 0)
            news: list[str] = []

            def flows(what: str) -> None:
                before, sent = len(plc.news()), len(ros.states())
                wait_for(lambda: len(plc.news()) > before + 3, f"/cmd, {what}")
                wait_for(lambda: len(ros.states()) > sent + 3 and ros.states()[-1] >= 0, f"/state, {what}")
                wait_for(lambda: plc.state().get("source") and not plc.state()["stale"], f"source, {what}")
                wait_for(lambda: ros.level("/cmd") == ros.level("/state") == 0, f"levels, {what}")

            flows("at the start")
            assert plc.news()[0].endswith(" recovered")

            # The ROS publisher: the bridge lives, the PLC knows all the same.
            cell.kill("ros")
            wait_for(lambda: plc.state()["stale"], "the PLC to see silence")
            wait_for(lambda: plc.state()["msg"] == SAFE and plc.state()["substituted"], "the safe value")
            wait_for(lambda: ros.level("/cmd") == 3, "STALE")
            wait_for(lambda: not plc.state()["source"], "the PLC to see no publisher")
            assert plc.state()["alive"] is True
            seen = len(plc.news())
            cell.start("ros", 1_000_000)
            flows("after the publisher")
            assert plc.news()[seen].endswith(" recovered")
            assert not plc.news()[seen + 1].endswith(" recovered")

            # The PLC: ROS gets the substitute, and knows that it is one.
            cell.kill("plc")
            news += plc.news()
            wait_for(lambda: ros.states()[-1] == SUBSTITUTE, "the substitute")
            wait_for(lambda: ros.flags()[-1:] == [True], "the flag")
            wait_for(lambda: ros.level("/state") == 2, "ERROR")
            plc = cell.start("plc", 1_000_000)
            flows("after the PLC")
            wait_for(lambda: ros.flags()[-1:] == [False], "the flag's end")

            # The bridge: its objects stay, the PLC falls back by itself, ROS sees a publisher less.
            cell.kill("bridge")
            wait_for(lambda: not plc.state()["alive"], "the PLC to miss the bridge")
            wait_for(lambda: plc.state()["stale"] and plc.state()["msg"] == SAFE, "the safe value, by itself")
            assert plc.state()["source"] is False
            wait_for(lambda: ros.subscriptions["/state"].matched == 0, "ROS to miss the bridge")
            seen = len(plc.news())
            cell.start("bridge")
            flows("after the bridge")
            assert plc.news()[seen].endswith(" recovered")
            news += plc.news()
        finally:
            ros.close()
    assert falls([int(item.split()[0]) for item in news]) == []
    assert falls([number for number in ros.states() if number != SUBSTITUTE]) == []
