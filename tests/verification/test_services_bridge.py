"""Services of a configuration: generated blocks, the bridge, and a ROS node on the other side."""

from __future__ import annotations

import shutil
import tempfile
import time
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from rosplc.bridge import Bridge
from rosplc.codec import Codec, Wire
from rosplc.config import parse_config, resolve
from rosplc.plc.build import plc_project
from rosplc.plc.plan import ProjectOptions
from rosplc.plc.project import project_texts
from rosplc.reasons import Reason
from rosplc.ros import SERVICES
from rosplc.ros.memory import open_backend
from rosplc.shm.constants import ErrorNumber
from rosplc_st.build import Build, build
from rosplc_st.machine import LibraryMachine
from tests.verification.plc_cell import READ, layout_of, store

TYPE = "std_srvs/srv/SetBool"
DOMAIN = 53
WATCHDOG_S = 100.0
CONFIG = f"""bridge: services
ros: {{backend: memory, domain: {DOMAIN}}}
shm: {{directory: FOLDER}}
diagnostics: {{enabled: false}}
services:
  /lamp: {{type: {TYPE}, server: ros, clients: [left, right]}}
  /start: {{type: {TYPE}, server: plc}}
"""


@cache
def built() -> Build:
    """Return the PLC's program, generated from the configuration."""
    project = resolve(parse_config(CONFIG.replace("FOLDER", "/dev/shm")))
    patient = ProjectOptions(beat_ms=10_000)  # a PLC that a busy machine stops for a while is no silent one
    return build(project_texts(plc_project(project, patient)))


def codec(part: str) -> Codec:
    return Codec(layout_of(f"{TYPE}_{part}"), Wire.CDR)


def encode(part: str, **fields: Any) -> bytes:
    return codec(part).encode(layout_of(f"{TYPE}_{part}").pack(fields))


def decode(part: str, payload: bytes) -> dict[str, Any]:
    return layout_of(f"{TYPE}_{part}").to_dict(codec(part).decode(payload))


class Joint:
    """A PLC, a bridge and a ROS node."""

    def __init__(self) -> None:
        self.folder = Path(tempfile.mkdtemp(prefix="T", dir="/dev/shm"))
        self.machine = LibraryMachine(built(), str(self.folder))
        self.machine.start()
        self.peer = open_backend(store(), "peer", domain=DOMAIN)
        self.bridge: Bridge | None = None
        self.start_bridge()

    def start_bridge(self) -> None:
        self.bridge = Bridge(parse_config(CONFIG.replace("FOLDER", str(self.folder))))
        self.bridge.start()

    def stop_bridge(self) -> None:
        if self.bridge is not None:
            self.bridge.stop()
        self.bridge = None

    def close(self) -> None:
        self.stop_bridge()
        self.peer.close()
        shutil.rmtree(self.folder)

    def get(self, instance: str, *names: str) -> Any:
        """Return pins of an instance: one value, or a tuple."""
        values = tuple(self.machine.get(f"ROS_Services.{instance}.{name}") for name in names)
        return values[0] if len(values) == 1 else values

    def set(self, instance: str, **pins: Any) -> None:
        """Set inputs of an instance."""
        for name, value in pins.items():
            self.machine.set(f"ROS_Services.{instance}.{name}", value)

    def until(self, condition: Callable[[], Any], what: str, step: int = 2) -> Any:
        """Let the PLC run until something holds; return it. ``step``: ms on the PLC's clock for each scan."""
        deadline = time.monotonic() + WATCHDOG_S
        while not (found := condition()):
            assert time.monotonic() < deadline, f"still waiting for {what}"
            time.sleep(0.002)
            self.machine.scan(READ, step=step)
        return found


@pytest.fixture
def joint() -> Iterator[Joint]:
    made = Joint()
    yield made
    made.close()


def test_the_plc_calls(joint: Joint) -> None:
    """Two clients of one service, each with its own answer; without a server the call waits."""
    for name, data in (("lamp_left", True), ("lamp_right", False)):
        joint.set(name, **{"request.data": data, "xExecute": True})
    joint.until(lambda: joint.get("lamp_left", "xPeerAlive", "xBusy") == (True, True), "the bridge")
    asked: list[tuple[bytes, bytes]] = []
    server = joint.peer.serve("/lamp", TYPE, SERVICES, lambda data, caller, _: asked.append((data, caller)))
    joint.until(lambda: len(asked) == 2, "both calls")
    for payload, caller in asked:
        on = decode("Request", payload)["data"]
        assert server.reply(caller, encode("Response", success=on, message=f"lamp {on}"))
    for name, data in (("lamp_left", True), ("lamp_right", False)):
        joint.until(lambda name=name: joint.get(name, "xDone"), f"the answer to {name}")
        assert joint.get(name, "response.success", "response.message") == (data, f"lamp {data}")
        assert joint.get(name, "xServer", "udiError", "xBusy") == (True, 0, False)


def test_the_plc_gives_up(joint: Joint) -> None:
    """A call that ROS does not answer ends by tTimeout with an unknown fate; the next call is a new one."""
    asked: list[tuple[bytes, bytes]] = []
    server = joint.peer.serve("/lamp", TYPE, SERVICES, lambda data, caller, _: asked.append((data, caller)))
    joint.until(lambda: joint.get("lamp_left", "xServer"), "the server")
    joint.set("lamp_left", xExecute=True, tTimeout=200)
    joint.until(lambda: asked, "the call", step=0)
    joint.until(lambda: joint.get("lamp_left", "xError"), "the time-out")
    assert len(asked) == 1
    assert joint.get("lamp_left", "eError", "eReason") == (ErrorNumber.FATE_UNKNOWN, Reason.TIME_OUT)
    joint.set("lamp_left", xExecute=False)
    joint.until(lambda: not joint.get("lamp_left", "xError"), "xExecute to fall")
    joint.set("lamp_left", xExecute=True, tTimeout=0)
    joint.until(lambda: len(asked) == 2, "the second call")
    server.reply(asked[0][1], encode("Response", success=False))
    server.reply(asked[1][1], encode("Response", success=True))
    joint.until(lambda: joint.get("lamp_left", "xDone"), "the second answer")
    assert joint.get("lamp_left", "response.success") is True


def test_ros_calls(joint: Joint) -> None:
    """Each call of a ROS node is shown once, and gets the program's answer."""
    client = joint.peer.client("/start", TYPE, SERVICES)
    joint.until(lambda: client.ready and joint.get("start", "xAttached", "xPeerAlive") == (True, True), "all")
    replies: list[Any] = []
    for number in range(3):
        client.call(encode("Request", data=bool(number % 2)), replies.append)
        joint.until(lambda: joint.get("start", "xRequest"), "the request")
        assert joint.get("start", "request.data") is bool(number % 2)
        joint.set("start", **{"response.success": True, "response.message": f"n{number}", "xReply": True})
        joint.until(lambda number=number: len(replies) == number + 1, "the answer")
        joint.set("start", xReply=False)
        joint.machine.scan(READ, step=2)
        assert decode("Response", replies[-1].payload) == {"success": True, "message": f"n{number}"}
    assert joint.get("start", "udiCalls", "udiError") == (3, 0)


def test_a_restarted_plc_executes_nothing(joint: Joint) -> None:
    """A call in hand at STOP → RUN is not shown again; the next one is."""
    client = joint.peer.client("/start", TYPE, SERVICES)
    joint.until(lambda: client.ready and joint.get("start", "xAttached", "xPeerAlive") == (True, True), "all")
    client.call(encode("Request", data=True), lambda _: None)
    joint.until(lambda: joint.get("start", "xRequest"), "the request")
    joint.machine.stop()
    joint.machine.start()
    joint.until(lambda: joint.get("start", "xAttached", "xPeerAlive") == (True, True), "the start")
    for _ in range(50):
        assert not joint.get("start", "xRequest")
        joint.machine.scan(READ, step=2)
    client.call(encode("Request", data=False), lambda _: None)
    joint.until(lambda: joint.get("start", "xRequest"), "the next request")
    assert joint.get("start", "request.data", "udiCalls") == (False, 1)


def test_a_restarted_bridge(joint: Joint) -> None:
    """A call that the PLC has sent ends with an unknown fate; nothing is sent twice, and calls go on."""
    asked: list[tuple[bytes, bytes]] = []
    server = joint.peer.serve("/lamp", TYPE, SERVICES, lambda data, caller, _: asked.append((data, caller)))
    joint.set("lamp_left", xExecute=True)
    joint.until(lambda: asked, "the call")
    joint.stop_bridge()
    joint.start_bridge()
    joint.until(lambda: joint.get("lamp_left", "xError"), "the end")
    assert joint.get("lamp_left", "eError") == ErrorNumber.FATE_UNKNOWN
    assert len(asked) == 1
    joint.set("lamp_left", xExecute=False)
    joint.until(lambda: not joint.get("lamp_left", "xError"), "xExecute to fall")
    joint.set("lamp_left", xExecute=True)
    joint.until(lambda: len(asked) == 2, "the next call")
    server.reply(asked[1][1], encode("Response", success=True))
    joint.until(lambda: joint.get("lamp_left", "xDone"), "its answer")
