"""Services between a PLC and zenoh-ros2-sdk, through a whole bridge over Zenoh, with kills of either side."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("zenoh")
pytest.importorskip("zenoh_ros2_sdk")

from rosplc.reasons import Reason
from rosplc.shm import Namespace
from rosplc.shm.constants import ErrorNumber
from rosplc.virtual_plc import ServiceClient, ServiceServer
from tests.e2e.cell import Bridge
from tests.interop.zenoh.processes import Router, free_port
from tests.interop.zenoh.sdk import ADD, SdkInbox, SdkPeer
from tests.lib.waiting import repeat_until

pytestmark = [
    pytest.mark.foreign,
    pytest.mark.timeout(600),
    pytest.mark.verifies("zenoh", real="zenoh-ros2-sdk"),
]

DOMAIN = 23


class Cell:
    """A router, a bridge as a process, and the PLC's blocks, scanned by the test."""

    def __init__(self, folder: Path, prefix: str, router: Router) -> None:
        self._path, self.router = folder / "rosplc.yaml", router
        # A client has no other way than the router: nothing is lost because links change.
        zenoh = f"{{mode: client, connect: [{router.endpoint}]}}"
        self._path.write_text(
            f"bridge: cell\nprefix: {prefix}\n"
            f"ros: {{backend: zenoh, distro: jazzy, domain: {DOMAIN}, zenoh: {zenoh}}}\n"
            f"services:\n  /load: {{type: {ADD}, server: ros}}\n"
            f"  /cell/add: {{type: {ADD}, server: plc, expire_after: 60s}}\n"
        )
        self.client = ServiceClient("/load", prefix=prefix)
        self.server = ServiceServer("/cell/add", prefix=prefix)
        self.executed: list[str] = []
        self.start()

    def start(self) -> None:
        """Start a bridge."""
        clean = {name: value for name, value in os.environ.items() if not name.startswith("ZENOH_")}
        self.bridge = Bridge(self._path, clean)

    def scan(self) -> None:
        """Run both blocks once; the program answers with the request's text."""
        server = self.server
        server.xReply = server() and not server.xReply
        if server.xReply:
            self.executed.append(server.request.load_namespace)
            server.response.update({"success": True, "message": server.request.load_namespace})
        self.client()

    def until(self, condition: Callable[[], Any], what: str) -> Any:
        """Scan until a condition holds."""
        return repeat_until(self.scan, condition, what, every=0.005)

    def call(self, text: str, timeout: float = 0.0) -> ErrorNumber | None:
        """Have the PLC call, and wait for the end; return the error."""
        client = self.client
        client.xExecute = False
        self.scan()
        client.request.load_namespace, client.tTimeout = text, timeout
        client.xExecute = True
        self.scan()
        self.until(lambda: not client.xBusy, "the end of the call")
        return None if client.xDone else client.eError

    def close(self) -> None:
        """End bridge and program."""
        self.bridge.kill()
        self.client.close()
        self.server.close()


@pytest.fixture
def cell(tmp_path: Path, shm_namespace: Namespace) -> Iterator[Cell]:
    with free_port() as port, Router(port) as router:
        opened = Cell(tmp_path, shm_namespace.prefix, router)
        yield opened
        opened.close()


def test_the_plc_calls(cell: Cell) -> None:
    """Each call is executed once and gets its answer, also after kills of bridge and server."""
    client = cell.client
    robot = SdkPeer(cell.router.port, DOMAIN)
    inbox = robot.serve("/load")
    cell.until(lambda: client.xServer, "the server")
    for number in range(5):
        assert cell.call(str(number)) is None
        assert (client.response.success, client.response.message) == (True, str(number))
    cell.bridge.kill()
    cell.start()
    cell.until(lambda: client.xPeerAlive and client.xServer, "another bridge")
    assert cell.call("again") is None
    cell.until(lambda: asked(inbox) == [*"01234", "again"], "the server's words")
    robot.kill()
    cell.until(lambda: not client.xServer, "the end of the server")
    assert (cell.call("nobody", 0.5), client.eReason) == (ErrorNumber.NOT_EXECUTED, Reason.TIME_OUT)
    with SdkPeer(cell.router.port, DOMAIN) as robot:
        inbox = robot.serve("/load")
        cell.until(lambda: client.xServer, "another server")
        assert cell.call("late") is None
        cell.until(lambda: asked(inbox) == ["late"], "the server's words")


def asked(inbox: SdkInbox) -> list[str]:
    """Return what a server was asked; its words may come after its answers."""
    return [message["load_namespace"] for message in inbox.messages]


def test_the_plc_is_called(cell: Cell) -> None:
    """Each call is executed once and gets its answer, also through another bridge."""
    cell.until(lambda: cell.server.xAttached, "the bridge")
    with SdkPeer(cell.router.port, DOMAIN) as robot:
        answered = first_call(cell, robot, "first")
        for number in range(5):
            robot.call("/cell/add", str(number))
        texts = lambda: {message["message"] for message in answered.messages if message}  # noqa: E731
        cell.until(lambda: texts() >= {*"01234"}, "the answers")
        cell.bridge.kill()
        cell.start()
        first_call(cell, robot, "again")
    assert sorted(text for text in cell.executed if text in "01234") == [*"01234"]


def first_call(cell: Cell, robot: SdkPeer, text: str) -> SdkInbox:
    """Call under a name of its own each time until one is answered: the SDK waits for no server."""
    sent: list[str] = []
    scans = 0

    def act() -> None:
        nonlocal scans
        if scans % 100 == 0:
            sent.append(f"{text} {len(sent)}")
            robot.call("/cell/add", sent[-1])
        scans += 1
        cell.scan()

    inbox = robot.call("/cell/add", f"{text} early")
    heard = lambda: {message["message"] for message in inbox.messages if message}  # noqa: E731
    repeat_until(act, lambda: heard() & {*sent}, "an answer", every=0.005)
    return inbox
