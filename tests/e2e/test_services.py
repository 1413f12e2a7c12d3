"""Services as a user has them: ``rosplc run`` as a process, a PLC's program, and a node of ROS over DDS."""

from __future__ import annotations

import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from rosplc.codec import Codec, Wire
from rosplc.layout import compute_layout
from rosplc.model import TypeStore
from rosplc.ros import SERVICES, Backend, Reply, open_backend
from rosplc.shm import Namespace
from rosplc.virtual_plc import ServiceClient, ServiceServer, Task
from tests.lib.waiting import wait_for

TYPE = "std_srvs/srv/SetBool"
STORE = TypeStore.bundled("jazzy")
CODECS = {part: Codec(compute_layout(STORE, f"{TYPE}_{part}"), Wire.CDR) for part in ("Request", "Response")}


def wire(part: str, **fields: object) -> bytes:
    return CODECS[part].encode(CODECS[part].layout.pack(fields))


def unwire(part: str, data: bytes) -> dict[str, object]:
    return CODECS[part].layout.to_dict(CODECS[part].decode(data))


class Plc:
    """Starts what ROS asks for when it is let, and calls /grip when it is told to."""

    def __init__(self, prefix: str) -> None:
        self.server = ServiceServer("/start", prefix=prefix)
        self.client = ServiceClient("/grip", "pick", prefix=prefix)
        self.let, self.call = True, False
        self.task = Task("RosTask", 0.002, programs=[self.scan])

    def scan(self) -> None:
        server = self.server
        server.xReply = server() and self.let and not server.xReply
        if server.xReply and server.request is not None:
            server.response.update({"success": server.request.data, "message": "from the PLC"})
        if self.client.request is not None:
            self.client.request.data = True
        self.client.xExecute = self.call
        self.client()


@pytest.fixture
def ros(dds_domain: int) -> Iterator[Backend]:
    node = open_backend("dds", STORE, "robot", domain=dds_domain)
    yield node
    node.close()


def run(path: Path) -> subprocess.Popen[bytes]:
    return subprocess.Popen([sys.executable, "-m", "rosplc", "run", str(path)])


def test_services_both_ways_and_a_bridge_that_is_killed(
    tmp_path: Path, shm_namespace: Namespace, dds_domain: int, ros: Backend
) -> None:
    """What the PLC finished while no bridge was there reaches its caller through the next one."""
    path = tmp_path / "rosplc.yaml"
    path.write_text(
        f"prefix: {shm_namespace.prefix}\nros: {{backend: dds, domain: {dds_domain}}}\nbeat: 20ms\n"
        "services:\n"
        f"  /start: {{type: {TYPE}, server: plc}}\n"
        f"  /grip: {{type: {TYPE}, server: ros, clients: [pick, place]}}\n"
    )
    asked: list[bool] = []

    def on_request(data: bytes, caller: bytes, _: int) -> None:
        asked.append(bool(unwire("Request", data)["data"]))
        grip.reply(caller, wire("Response", success=True, message="from ROS"))

    grip = ros.serve("/grip", TYPE, SERVICES, on_request)
    start = ros.client("/start", TYPE, SERVICES)
    replies: list[Reply] = []
    came = threading.Event()

    def on_reply(reply: Reply) -> None:
        replies.append(reply)
        came.set()

    plc = Plc(shm_namespace.prefix)
    bridge = run(path)
    plc.task.start()
    try:
        wait_for(lambda: start.ready and plc.client.xServer and plc.server.xPeerAlive, "both services")
        plc.call = True
        wait_for(lambda: plc.client.xDone, "an answer from ROS")
        assert plc.client.response is not None
        assert (asked, plc.client.response.message) == ([True], "from ROS")
        for attempt in range(1, 6):
            plc.let = False
            came.clear()
            start.call(wire("Request", data=True), on_reply)
            wait_for(lambda: plc.server.xRequest, "the robot's call")
            bridge.kill()
            bridge.wait()
            plc.let = True
            wait_for(lambda: not plc.server.xRequest, "the PLC's answer")
            bridge = run(path)
            assert came.wait(100)
            assert plc.server.udiCalls == attempt
            if replies[-1].payload is not None:
                break
            # A machine so busy that the robot's middleware gave the dead bridge up, after 10 s.
            assert replies[-1].outcome == "fate unknown"
            wait_for(lambda: start.ready and plc.server.xPeerAlive, "the next bridge")
        assert replies[-1].payload is not None
        assert unwire("Response", replies[-1].payload) == {"success": True, "message": "from the PLC"}
        bridge.send_signal(signal.SIGTERM)
        assert bridge.wait(60) == 0
    finally:
        plc.task.stop()
        plc.server.close()
        plc.client.close()
        bridge.kill()
        bridge.wait()
