"""Actions between a PLC and a real rclpy, through a whole bridge, both ways, with kills of either side."""

from __future__ import annotations

import itertools
import os
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from rosplc.reasons import Reason
from rosplc.ros.actions import GoalStatus
from rosplc.shm import Namespace
from rosplc.shm.constants import ErrorNumber
from rosplc.virtual_plc import ActionClient, ActionServer
from tests.e2e.cell import Bridge
from tests.interop.graphs import LOCAL
from tests.interop.ros2.test_actions import FIBONACCI, Peer
from tests.lib.waiting import repeat_until

pytestmark = [pytest.mark.ros2, pytest.mark.timeout(300)]


class Cell:
    """A bridge as a process, and the PLC's blocks, scanned by the test."""

    def __init__(self, folder: Path, prefix: str, domain: int, backend: str = "rclpy") -> None:
        self._path, self._environment = folder / "rosplc.yaml", {**os.environ, **LOCAL}
        self._path.write_text(
            f"bridge: cell\nprefix: {prefix}\n"
            f"ros: {{backend: {backend}, distro: kilted, domain: {domain}}}\n"
            f"types: {{paths: [{Path(sys.prefix, 'share', 'test_msgs')}]}}\n"
            "limits: {sequence: 10000}\n"
            f"actions:\n  /move: {{type: {FIBONACCI}, server: ros}}\n"
            f"  /cell: {{type: {FIBONACCI}, server: plc, accept_within: 60s}}\n"
        )
        self.client, self.server = ActionClient("/move", prefix=prefix), ActionServer("/cell", prefix=prefix)
        self.fed: list[list[int]] = []
        self.bridge = Bridge(self._path, self._environment)

    def scan(self) -> None:
        """Run both blocks once; edges of the server's inputs last for one scan."""
        self.client()
        if self.client.xNewFeedback:
            self.fed.append(list(self.client.feedback.sequence))
        self.server()
        for step in self.server._steps:
            setattr(self.server, step, False)

    def until(self, condition: Callable[[], Any], what: str) -> Any:
        """Scan until a condition holds."""
        return repeat_until(self.scan, condition, what, every=0.005)

    def send(self, order: int) -> None:
        """Have the PLC send a goal."""
        client = self.client
        client.xExecute = client.xCancel = False
        self.scan()
        self.until(lambda: client.xServer, "the server")
        self.fed.clear()
        client.goal.order = order
        client.xExecute = True
        self.scan()

    def ended(self) -> tuple[bool, bool, GoalStatus, ErrorNumber | None]:
        """Wait for the end of the PLC's goal; return xDone, xAborted, its state and the error."""
        client = self.client
        self.until(lambda: not client.xBusy, "the end of the goal")
        return client.xDone, client.xAborted, client.eStatus, client.eError

    def restart(self) -> None:
        """Kill the bridge, and start another one."""
        self.bridge.kill()
        self.bridge = Bridge(self._path, self._environment)

    def close(self) -> None:
        self.bridge.kill()
        self.client.close()
        self.server.close()


@pytest.fixture
def cell(tmp_path: Path, shm_namespace: Namespace, domain: int) -> Iterator[Cell]:
    opened = Cell(tmp_path, shm_namespace.prefix, domain)
    yield opened
    opened.close()


def test_the_plc_sends_goals(cell: Cell, domain: int) -> None:
    """They are rejected, reached with feedback, aborted and canceled; one outlives the bridge."""
    peer, client = Peer(domain, serve="/move"), cell.client
    cell.send(-1)
    assert cell.ended() == (False, False, GoalStatus.UNKNOWN, ErrorNumber.NOT_EXECUTED)
    assert client.eReason is Reason.REJECTED
    cell.send(4)
    assert cell.ended() == (True, False, GoalStatus.SUCCEEDED, None)
    assert list(client.result.sequence) == [0, 1, 2, 3]
    assert cell.fed and cell.fed == [list(range(len(one))) for one in cell.fed]
    cell.send(3)
    assert cell.ended() == (False, False, GoalStatus.ABORTED, ErrorNumber.GOAL_ABORTED)
    assert list(client.result.sequence) == [0, 1, 2]
    cell.send(60)
    cell.until(lambda: client.xActive and cell.fed, "feedback")
    before = len(cell.fed)
    cell.restart()
    cell.until(lambda: len(cell.fed) > before + 2, "feedback through another bridge")
    assert client.xBusy
    client.xCancel = True
    assert cell.ended() == (False, True, GoalStatus.CANCELED, ErrorNumber.GOAL_CANCELED)
    cell.send(77)
    cell.until(lambda: cell.fed, "feedback")
    client.xCancel = True
    cell.until(lambda: client.xCancelRejected, "the refusal to cancel")
    assert [words["goal"] for words in peer.said if "began" in words] == [4, 3, 60, 77]
    peer.process.kill()
    peer.close()
    peer = Peer(domain, serve="/move")  # which does not know the goal
    assert cell.ended()[2:] == (GoalStatus.EXECUTING, ErrorNumber.FATE_UNKNOWN)
    cell.send(2)
    assert cell.ended() == (True, False, GoalStatus.SUCCEEDED, None)
    peer.close()


def test_a_plc_that_stops_has_its_goal_canceled(cell: Cell, domain: int) -> None:
    """The robot stops as well."""
    peer = Peer(domain, serve="/move")
    cell.send(60)
    cell.until(lambda: cell.client.xActive and cell.fed, "feedback")
    cell.client.close()  # and its program starts again
    cell.fed.clear()
    cell.send(2)
    assert cell.ended() == (True, False, GoalStatus.SUCCEEDED, None)
    assert peer.wait(60, "canceled")
    peer.close()


def test_the_plc_carries_goals_out(cell: Cell, domain: int) -> None:
    """As its program decides; a goal that it has accepted goes on with another bridge."""
    server = cell.server
    cell.until(lambda: server.xAttached, "the bridge")
    peer = Peer(domain, use="/cell")

    def begin(order: int) -> None:
        peer.tell(send=order)
        cell.until(lambda: server.xGoal and server.goal.order == order, "the goal")
        server.xAccept = True
        cell.scan()
        assert server.xActive
        cell.until(lambda: said(order, "accepted"), "the acceptance")

    def said(order: int, what: str) -> Any:
        return [words[what] for words in peer.said if words.get("goal") == order and what in words]

    peer.tell(send=1)
    cell.until(lambda: server.xGoal, "the goal")
    server.xReject = True
    cell.until(lambda: said(1, "accepted") == [False], "the rejection")
    begin(2)
    server.feedback.sequence = [1, 2]
    server.xSendFeedback = True
    cell.until(lambda: [1, 2] in said(2, "feedback"), "feedback")
    server.xSendFeedback = False
    server.result.sequence = [3, 4, 5]
    server.xSucceed = True
    cell.until(lambda: said(2, "status") == [GoalStatus.SUCCEEDED], "the result")
    assert said(2, "sequence") == [[3, 4, 5]]
    begin(3)
    peer.tell(cancel=3)
    cell.until(lambda: server.xCancelRequested, "the request to cancel")
    server.xRejectCancel = True
    cell.until(lambda: said(3, "canceling") == [1], "the refusal")
    peer.tell(cancel=3)
    cell.until(lambda: server.xCancelRequested, "the second request")
    server.xAcceptCancel = True
    cell.until(lambda: said(3, "canceling") == [1, 0], "the agreement")
    server.xCanceled = True
    cell.until(lambda: said(3, "status") == [GoalStatus.CANCELED], "the result")
    begin(4)
    server.xAbort = True
    cell.until(lambda: said(4, "status") == [GoalStatus.ABORTED], "the result")
    begin(6)
    cell.restart()
    # A request that no server was known for is lost.
    asks = itertools.count()

    def ask() -> None:
        if next(asks) % 100 == 0:
            peer.tell(cancel=6)
        cell.scan()

    repeat_until(ask, lambda: server.xCancelRequested, "a request through another bridge", every=0.005)
    server.xAcceptCancel = True
    cell.until(lambda: 0 in said(6, "canceling"), "the agreement")
    server.xCanceled = True
    cell.scan()
    begin(8)
    server.xSucceed = True
    cell.until(lambda: said(8, "status") == [GoalStatus.SUCCEEDED], "the result of a later goal")
    peer.close()


def test_a_fast_dds_server_is_refused_over_dds(tmp_path: Path, shm_namespace: Namespace, domain: int) -> None:
    """Nothing is sent that it would misread, and a warning says so."""
    cell = Cell(tmp_path, shm_namespace.prefix, domain, "dds")
    peer = Peer(domain, serve="/move")
    client = cell.client
    try:
        cell.until(lambda: "[ROS021]" in cell.bridge.log.read_text(), "the warning")
        client.xExecute, client.tTimeout = True, 0.5
        cell.scan()
        assert cell.ended() == (False, False, GoalStatus.UNKNOWN, ErrorNumber.NOT_EXECUTED)
        assert (client.eReason, client.xServer) == (Reason.TIME_OUT, False)
    finally:
        cell.close()
        peer.close()
