"""Actions of a whole bridge: its threads, its objects' life, and other configurations while it runs."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from rosplc.bridge import Bridge
from rosplc.bridge.diagnostics import diagnostic_status
from rosplc.bridge.managed import ManagedBridge
from rosplc.config import parse_config as parse
from rosplc.ros.actions import STATUS_QOS, ActionClient, GoalEvent
from rosplc.ros.actions import ActionServer as RosServer
from rosplc.ros.goals import GoalStatus
from rosplc.ros.memory import open_backend
from rosplc.shm import Namespace
from rosplc.virtual_plc import ActionClient as VirtualClient
from rosplc.virtual_plc import ActionServer
from tests.lib.waiting import repeat_until, wait_for
from tests.unit.bridge.conftest import DOMAIN, MESSAGES, STORE, Cell, unwire, wire

TYPE = "example_interfaces/action/Fibonacci"
SERVED = f"  /count: {{type: {TYPE}, server: plc}}\n"
CALLED = f"  /move: {{type: {TYPE}, server: ros}}\n"


class Executing(RosServer):
    """A server in ROS that accepts goals, and executes them without an end."""

    def __init__(self, cell: Cell) -> None:
        self.uuids: list[bytes] = []
        self.cancels: list[bytes] = []
        super().__init__(cell.peer, STORE, "/move", TYPE, on_goal=self._begin, on_cancel=self.cancels.append)

    def _begin(self, uuid: bytes, _: bytes) -> None:
        self.uuids.append(uuid)
        self.accept(uuid)
        self.execute(uuid)


class Client(ActionClient):
    """A client in ROS that notes what becomes of its goals."""

    def __init__(self, cell: Cell) -> None:
        self.events: list[GoalEvent] = []
        super().__init__(cell.peer, STORE, "/count", TYPE, self.events.append)

    def goal(self, number: int) -> bytes:
        uuid = bytes([number] * 16)
        self.send(uuid, wire(f"{TYPE}_Goal", {"order": number}))
        return uuid

    def kinds(self, uuid: bytes) -> list[str]:
        return [event.kind for event in self.events if event.uuid == uuid and event.kind != "status"]

    def result(self, uuid: bytes) -> tuple[GoalStatus, list[int]]:
        found = next(e for e in self.events if (e.uuid, e.kind) == (uuid, "result"))
        assert found.payload is not None
        return found.status, unwire(f"{TYPE}_Result", found.payload)["sequence"]


@pytest.fixture
def plc(shm_namespace: Namespace) -> Iterator[ActionServer]:
    block = ActionServer("/count", prefix=shm_namespace.prefix, directory=str(shm_namespace.directory))
    yield block
    block.close()


@pytest.fixture
def client(cell: Cell) -> Iterator[Client]:
    made = Client(cell)
    yield made
    made.close()


def config(cell: Cell, actions: str) -> Any:
    return parse(cell.config("", more=f"actions:\n{actions}" if actions else ""))


def start(cell: Cell, plc: ActionServer, actions: str = SERVED) -> Bridge:
    cell.bridge = Bridge(config(cell, actions))
    cell.bridge.start()
    wait_for(lambda: [plc(), plc.xAttached and plc.xPeerAlive][1], every=0.01)
    return cell.bridge


def step(plc: ActionServer, pin: str, until: Any, what: str) -> None:
    """Raise an input for one scan, and go on until something is so."""
    setattr(plc, pin, True)
    plc()
    setattr(plc, pin, False)
    repeat_until(plc, until, what, every=0.005)


def accept(plc: ActionServer, client: Client, number: int) -> bytes:
    """Have the PLC accept a goal."""
    wait_for(lambda: client.ready)
    uuid = client.goal(number)
    repeat_until(plc, lambda: plc.xGoal, "a goal", every=0.005)
    assert plc.goal.order == number
    step(plc, "xAccept", lambda: client.kinds(uuid)[:1] == ["accepted"], "the acceptance")
    return uuid


def test_a_goal_from_ros(cell: Cell, plc: ActionServer, client: Client) -> None:
    bridge = start(cell, plc)
    uuid = accept(plc, client, 3)
    wait_for(lambda: bridge.status().actions[0].goal_status == "executing")
    plc.feedback.sequence = [1, 2]
    step(plc, "xSendFeedback", lambda: "feedback" in client.kinds(uuid), "feedback")
    client.cancel(uuid)
    repeat_until(plc, lambda: plc.xCancelRequested, "the request to cancel", every=0.005)
    step(plc, "xRejectCancel", lambda: "not canceled" in client.kinds(uuid), "the refusal")
    client.cancel(uuid)
    repeat_until(plc, lambda: plc.xCancelRequested, "another request to cancel", every=0.005)
    step(plc, "xAcceptCancel", lambda: "canceling" in client.kinds(uuid), "the agreement")
    plc.result.sequence = [5, 8]
    step(plc, "xCanceled", lambda: "result" in client.kinds(uuid), "the result")
    assert client.result(uuid) == (GoalStatus.CANCELED, [5, 8])
    (status,) = bridge.status().actions
    assert (status.received, status.canceled, status.feedback, status.outstanding) == (1, 1, 1, 0)
    status = bridge.status()
    entries = (diagnostic_status(one, "cell") for one in (status, *status.calls))
    names = {entry["name"]: entry["values"] for entry in entries}
    assert names["rosplc: cell: action /count"]["canceled"] == "1"
    assert names["rosplc: cell"]["actions"] == "1"
    (shown,) = bridge.status().to_dict()["actions"]
    assert (shown["action"], shown["canceled"], shown["goal_status"]) == ("/count", 1, "")


def test_a_bridge_that_is_restarted_goes_on_with_the_goal(
    cell: Cell, plc: ActionServer, client: Client
) -> None:
    start(cell, plc)
    uuid = accept(plc, client, 3)
    cell.stop()
    for _ in range(3):
        plc()
    bridge = start(cell, plc)
    wait_for(lambda: bridge.status().actions[0].goal_status == "executing")
    wait_for(lambda: client.ready)
    client.adopt(uuid)
    plc.result.sequence = [1]
    step(plc, "xSucceed", lambda: "result" in client.kinds(uuid), "the result")
    assert client.result(uuid) == (GoalStatus.SUCCEEDED, [1])


def test_actions_that_leave_the_configuration_while_no_bridge_runs(
    cell: Cell, plc: ActionServer, client: Client, shm_namespace: Namespace
) -> None:
    """The PLC is told to end the goal that it executes; its own is canceled in ROS, and its fate unknown."""
    names = {"prefix": shm_namespace.prefix, "directory": str(shm_namespace.directory)}
    other = Executing(cell)
    mine = VirtualClient("/move", **names)
    try:
        start(cell, plc, SERVED + CALLED)
        accept(plc, client, 3)
        mine.xExecute = True
        repeat_until(mine, lambda: mine.xActive, "the acceptance of the PLC's goal", every=0.005)
        cell.stop()
        for block in (plc, mine):
            block()
        assert mine.xBusy
        assert not plc.xCallerGone
        cell.bridge = Bridge(config(cell, ""))
        cell.bridge.start()
        assert cell.namespace.objects() == []
        repeat_until(plc, lambda: plc.xCallerGone, "that nobody waits", every=0.005)
        repeat_until(mine, lambda: mine.xError, "the end of the PLC's goal", every=0.005)
        assert mine.eError is not None
        assert mine.eError.name == "FATE_UNKNOWN"
        (uuid,) = other.uuids
        wait_for(lambda: other.cancels == [uuid], "the request to cancel")
        assert other.accept_cancel(uuid)
        (left,) = cell.bridge._leaving
        wait_for(lambda: not left._goals, "the server's answer")
        assert left._endpoint.endpoints()[0].matched == 0
    finally:
        mine.close()
        other.close()


def test_a_node_that_becomes_active_publishes_the_statuses(cell: Cell, tmp_path: Path) -> None:
    """Those of goals that were accepted before: a client that comes later waits for them."""
    path = tmp_path / "rosplc.yaml"
    path.write_text(cell.config("", more=f"actions:\n{SERVED}"))
    managed = ManagedBridge(lambda store: open_backend(store, "managed", domain=DOMAIN))
    managed.configure(path)
    try:
        managed.activate()
        told: list[bytes] = []
        names = "/count/_action/status", "action_msgs/msg/GoalStatusArray"
        cell.peer.subscribe(*names, STATUS_QOS, lambda payload, _: told.append(payload))
        wait_for(lambda: told)
        assert MESSAGES.read_statuses(told[0]) == []
    finally:
        managed.cleanup()


def test_actions_come_and_go(cell: Cell, plc: ActionServer, client: Client) -> None:
    """A goal ends with its action; one whose action changes beside its objects goes on."""
    bridge = start(cell, plc)
    uuid = accept(plc, client, 3)
    said = str(bridge.reload(config(cell, SERVED.replace("plc}", "plc, on_new_goal: abort}"))))
    assert said == "changed action /count; topics unchanged: 0"
    repeat_until(plc, lambda: bridge.status().actions[0].goal_status == "executing", "adoption", every=0.005)
    wait_for(lambda: client.ready)
    client.adopt(uuid)
    server: Any = bridge._streams[0]._endpoint
    # The note about the goal has the client's first request, which nobody can answer any more.
    wait_for(lambda: any(map(server._get.present, server._goals[uuid].waiting)), "the request for the result")
    said = str(bridge.reload(config(cell, "")))
    assert said == "removed action /count; topics unchanged: 0"
    assert cell.namespace.objects() == []
    repeat_until(plc, lambda: not plc.xAttached, "the end of the objects", every=0.005)
    wait_for(lambda: "result" in client.kinds(uuid))
    assert client.result(uuid) == (GoalStatus.ABORTED, [])
