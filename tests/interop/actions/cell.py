"""A PLC whose bridge runs as a process, and an action peer; what both do in the tests of every middleware."""

from __future__ import annotations

import itertools
import json
import subprocess
import threading
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from rosplc.reasons import Reason
from rosplc.ros.goals import GoalStatus
from rosplc.shm import GoalNotes, Namespace, Part, attach
from rosplc.shm.constants import ErrorNumber
from rosplc.virtual_plc import ActionClient, ActionServer
from tests.e2e.cell import Bridge
from tests.interop.ros2.conftest import end
from tests.lib.waiting import repeat_until, wait_for

ROOT = Path(__file__).parents[3]
FIBONACCI = "test_msgs/action/Fibonacci"
DEFINITION = "int32 order\n---\nint32[] sequence\n---\nint32[] sequence\n"


class Peer:
    """A process with an action server or client; ``said`` has what it has printed of goals."""

    def __init__(self, command: Sequence[str], environment: Mapping[str, str], **order: str) -> None:
        self.process = subprocess.Popen(
            command, cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environment
        )
        self.said: list[dict[str, Any]] = []
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()
        self.tell(**order)
        wait_for(lambda: self.said or self.process.poll() is not None, "the peer")
        assert self.process.poll() is None, "the peer has ended"

    def _read(self) -> None:
        assert self.process.stdout is not None
        self.said.extend(json.loads(line) for line in self.process.stdout)

    def tell(self, **order: object) -> None:
        """Send one line."""
        assert self.process.stdin is not None
        self.process.stdin.write(json.dumps(order) + "\n")
        self.process.stdin.flush()

    def words(self, order: int, what: str) -> list[Any]:
        """Return what it has printed about something of a goal."""
        return [words[what] for words in tuple(self.said) if words.get("goal") == order and what in words]

    def wait(self, order: int, what: str) -> Any:
        """Return the last line that it has printed about something of a goal."""
        return wait_for(lambda: [w for w in self.said if w.get("goal") == order and what in w], what)[-1]

    def close(self) -> None:
        """Let it leave the graph by itself."""
        assert self.process.stdin is not None
        self.process.stdin.close()
        end(self.process)
        self._reader.join()


StartPeer = Callable[..., Peer]
"""Starts a peer that is told ``serve=`` or ``use=`` an action."""


class Cell:
    """A bridge as a process, and the PLC's blocks, scanned by the test.

    Args:
        folder: Where its files are written.
        prefix: Of its objects.
        ros: The section ``ros`` of its configuration, as YAML.
        environment: Of the bridge.
    """

    def __init__(self, folder: Path, prefix: str, ros: str, environment: Mapping[str, str]) -> None:
        definition = folder / f"{FIBONACCI}.action"
        definition.parent.mkdir(parents=True)
        definition.write_text(DEFINITION)
        self._path, self._environment = folder / "rosplc.yaml", environment
        self._path.write_text(
            f"bridge: cell\nprefix: {prefix}\nros: {ros}\ntypes: {{paths: [{folder}]}}\n"
            "limits: {sequence: 10000}\n"
            f"actions:\n  /move: {{type: {FIBONACCI}, server: ros}}\n"
            f"  /cell: {{type: {FIBONACCI}, server: plc, accept_within: 60s}}\n"
        )
        self._namespace = Namespace(prefix)
        self.client, self.server = ActionClient("/move", prefix=prefix), ActionServer("/cell", prefix=prefix)
        self.fed: list[list[int]] = []
        self.bridge = Bridge(self._path, environment)

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

    def noted(self) -> int:
        """Return how often the bridge has noted who waits for a result: once for each goal."""
        with attach(self._namespace, "/cell", part=Part.GOAL) as goals:
            return GoalNotes(goals)._number

    def restart(self) -> None:
        """Kill the bridge, and start another one."""
        self.bridge.kill()
        self.bridge = Bridge(self._path, self._environment)

    def close(self) -> None:
        """End the bridge and the program."""
        self.bridge.kill()
        self.client.close()
        self.server.close()


def the_plc_sends_goals(cell: Cell, start: StartPeer) -> None:
    """They end in every way, with feedback; one outlives the bridge, another one its server."""
    peer, client = start(serve="/move"), cell.client
    cell.send(-1)
    assert cell.ended() == (False, False, GoalStatus.UNKNOWN, ErrorNumber.NOT_EXECUTED)
    assert client.eReason is Reason.REJECTED
    cell.send(4)
    assert cell.ended() == (True, False, GoalStatus.SUCCEEDED, None)
    assert list(client.result.sequence) == [0, 1, 2, 3]
    cell.send(3)
    assert cell.ended() == (False, False, GoalStatus.ABORTED, ErrorNumber.GOAL_ABORTED)
    assert list(client.result.sequence) == [0, 1, 2]
    cell.send(60)
    cell.until(lambda: client.xActive and cell.fed, "feedback")
    assert cell.fed == [list(range(len(one))) for one in cell.fed]
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
    began = [4, 3, 60, 77]  # each once
    cell.until(lambda: [words["goal"] for words in peer.said if "began" in words] == began, "what was begun")
    peer.process.kill()
    peer.close()
    peer = start(serve="/move")  # which does not know the goal
    assert cell.ended()[2:] == (GoalStatus.EXECUTING, ErrorNumber.FATE_UNKNOWN)
    cell.send(2)
    assert cell.ended() == (True, False, GoalStatus.SUCCEEDED, None)
    peer.close()


def the_plc_carries_goals_out(cell: Cell, start: StartPeer, *, remembered: bool = False) -> None:
    """As its program decides; a goal that it has accepted goes on with another bridge.

    Where who asked for a result is ``remembered``, the other bridge answers that; else the client asks again.
    """
    server = cell.server
    cell.until(lambda: server.xAttached, "the bridge")
    peer = start(use="/cell")
    said = peer.words

    def begin(order: int) -> None:
        peer.tell(send=order)
        cell.until(lambda: server.xGoal and server.goal.order == order, "the goal")
        server.xAccept = True
        cell.scan()
        assert server.xActive
        cell.until(lambda: said(order, "accepted"), "the acceptance")

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
    noted = cell.noted()
    begin(6)
    if remembered:
        cell.until(lambda: cell.noted() > noted, "the request for the result")
    cell.restart()
    # A request that no server was known for is lost.
    asks = itertools.count()

    def ask(**order: int) -> None:
        if next(asks) % 100 == 0:
            peer.tell(**order)
        cell.scan()

    repeat_until(
        partial(ask, cancel=6),
        lambda: server.xCancelRequested,
        "a request through another bridge",
        every=0.005,
    )
    server.xAcceptCancel = True
    cell.until(lambda: 0 in said(6, "canceling"), "the agreement")
    server.result.sequence = [6]
    server.xCanceled = True
    again = cell.scan if remembered else partial(ask, ask=6)
    repeat_until(again, lambda: said(6, "status"), "the result through another bridge", every=0.005)
    assert (said(6, "status")[0], said(6, "sequence")[0]) == (GoalStatus.CANCELED, [6])
    begin(8)
    server.xSucceed = True
    cell.until(lambda: said(8, "status") == [GoalStatus.SUCCEEDED], "the result of a later goal")
    peer.close()
