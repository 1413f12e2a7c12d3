"""Actions of ROS 1: Debian's actionlib as client and as server."""

from __future__ import annotations

import json
import struct
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
from typer.testing import CliRunner

from rosplc.cli.app import app
from rosplc.model import TypeStore
from rosplc.ros import Backend, GoalEvent, GoalStatus, action_classes, open_backend
from rosplc.ros.actionlib import uuid_of
from rosplc.shm import Namespace
from tests.interop.ros1.graph import PACKAGES, Graph, Peer, lend
from tests.lib.waiting import wait_for
from tests.unit.recorder.making import received, recording, until
from tests.unit.recorder.test_actions import NAME, Action

pytestmark = [
    pytest.mark.needs(*PACKAGES, "python3-actionlib"),
    pytest.mark.timeout(120),
    pytest.mark.verifies("ros1", real="actionlib"),
]

STORE = TypeStore.bundled("noetic")
TEST = "actionlib/action/Test"
SERVER, CLIENT = action_classes(STORE)
UUID = bytes(range(16))


def number(value: int) -> bytes:
    return struct.pack("<i", value)


@pytest.fixture
def ros1() -> Iterator[Graph]:
    with lend() as graph:
        yield graph


@pytest.fixture
def cell(ros1: Graph) -> Iterator[Backend]:
    backend = open_backend("rospy", STORE, "cell", environment=ros1.environment)
    yield backend
    backend.close()


class Cell:
    """A server that notes what it is asked, looked after four times a second."""

    def __init__(self, backend: Backend) -> None:
        self.goals: list[tuple[bytes, bytes]] = []
        self.cancels: list[bytes] = []
        self.server = SERVER(
            backend,
            STORE,
            "/test",
            TEST,
            on_goal=lambda *goal: self.goals.append(goal),
            on_cancel=self.cancels.append,
        )
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self) -> None:
        while not self._ending.wait(0.25):
            self.server.tick()

    def close(self) -> None:
        """End the thread; the endpoints are the backend's."""
        self._ending.set()
        self._thread.join()


@pytest.fixture
def plc(cell: Backend) -> Iterator[Cell]:
    plc = Cell(cell)
    yield plc
    plc.close()


@pytest.fixture
def robot(ros1: Graph, plc: Cell) -> Peer:
    """Give a client of actionlib that has found the server."""
    peer = ros1.peer("actionlib", "robot")
    peer.act("client", "/test")
    return peer


def sent(plc: Cell, robot: Peer, key: str = "goal") -> bytes:
    """Have a goal sent; return its UUID."""
    before = len(plc.goals)
    robot.act("goal", "/test", key, 7)
    wait_for(lambda: len(plc.goals) > before)
    uuid, goal = plc.goals[-1]
    assert goal == number(7)
    return uuid


def end(robot: Peer, key: str = "goal") -> str:
    """Return the state in which a goal has ended, and its result."""
    return wait_for(lambda: [text for text in robot.told(key) if text.split()[0].isupper() and " " in text])[
        0
    ]


def test_a_client_sends_goals(plc: Cell, robot: Peer) -> None:
    """It sees each state, feedback and the result."""
    uuid = sent(plc, robot)
    wait_for(lambda: "PENDING" in robot.told("goal"))
    assert plc.server.accept(uuid)
    assert plc.server.execute(uuid)
    wait_for(lambda: "ACTIVE" in robot.told("goal"))
    assert plc.server.feedback(uuid, number(50))
    wait_for(lambda: "feedback 50" in robot.told("goal"))
    assert plc.server.succeed(uuid, number(100))
    assert end(robot) == "SUCCEEDED 100"


def test_a_client_is_rejected(plc: Cell, robot: Peer) -> None:
    uuid = sent(plc, robot)
    assert plc.server.reject(uuid)
    assert end(robot) == "REJECTED 0"


@pytest.mark.parametrize("how", ["canceled", "succeed", "abort"])
def test_a_client_cancels(plc: Cell, robot: Peer, how: str) -> None:
    """The goal ends as the server ends it."""
    uuid = sent(plc, robot)
    plc.server.accept(uuid)
    plc.server.execute(uuid)
    wait_for(lambda: "ACTIVE" in robot.told("goal"))
    robot.act("cancel", "/test", "goal")
    assert wait_for(lambda: plc.cancels) == [uuid]
    assert plc.server.accept_cancel(uuid)
    wait_for(lambda: "PREEMPTING" in robot.told("goal"))
    assert getattr(plc.server, how)(uuid, number(3))
    ends = {"canceled": "PREEMPTED 3", "succeed": "SUCCEEDED 3", "abort": "ABORTED 3"}
    assert end(robot) == ends[how]


def test_a_client_cancels_a_goal_that_is_not_decided(plc: Cell, robot: Peer) -> None:
    """It is recalled; a later goal is not concerned."""
    uuid = sent(plc, robot)
    robot.act("cancel", "/test", "goal")
    assert wait_for(lambda: plc.cancels) == [uuid]
    assert plc.server.reject(uuid)
    assert end(robot) == "RECALLED 0"
    assert plc.server.accept(sent(plc, robot, "next"))


@pytest.mark.parametrize("noted", [True, False])
def test_a_server_adopts_a_goal_of_actionlib(plc: Cell, robot: Peer, noted: bool) -> None:
    """The note tells its name. Without one the client takes it to be lost, even where its cancel names it."""
    uuid = sent(plc, robot)
    plc.server.accept(uuid)
    plc.server.execute(uuid)
    wait_for(lambda: "ACTIVE" in robot.told("goal"))
    note = plc.server.note(uuid)
    known = plc.server._goals.pop(uuid)
    assert len(note) > 16
    assert uuid == uuid_of(note)
    assert plc.server.adopt(uuid, known.stamp_ns, GoalStatus.EXECUTING, note if noted else b"")
    if noted:
        plc.server.succeed(uuid, number(100))
    assert end(robot) == ("SUCCEEDED 100" if noted else "LOST -")


# -- a server of actionlib


@pytest.fixture
def events() -> list[GoalEvent]:
    return []


def last(events: list[GoalEvent], kind: str) -> GoalEvent:
    """Return an event of a kind, once there is one."""
    return wait_for(lambda: [event for event in events if event.kind == kind], kind)[0]


@pytest.mark.parametrize(
    ("goal", "ends"),
    [
        (1, GoalEvent(UUID, "result", number(100), GoalStatus.SUCCEEDED)),
        (3, GoalEvent(UUID, "result", number(3), GoalStatus.CANCELED)),
        (4, GoalEvent(UUID, "result", number(4), GoalStatus.ABORTED)),
    ],
)
def test_a_server_is_used(
    ros1: Graph, cell: Backend, events: list[GoalEvent], goal: int, ends: GoalEvent
) -> None:
    """Its goals are accepted and end as it ends them."""
    peer = ros1.peer("actionlib", "robot")
    peer.act("server", "/test")
    client = CLIENT(cell, STORE, "/test", TEST, events.append)
    wait_for(lambda: client.ready)
    assert client.send(UUID, number(goal))
    last(events, "accepted")
    if goal == 3:  # the only one that runs until it is canceled
        assert last(events, "feedback").payload == number(50)
        assert not client.send(UUID, number(goal)), "it is sent once"
        client.cancel(UUID)
    assert last(events, "result") == ends
    assert not client._goals


@pytest.mark.parametrize("goal", [2, 5])
def test_a_server_does_not_execute(ros1: Graph, cell: Backend, events: list[GoalEvent], goal: int) -> None:
    """It rejects a goal, or recalls one that waits."""
    peer = ros1.peer("actionlib", "robot")
    peer.act("server", "/test")
    client = CLIENT(cell, STORE, "/test", TEST, events.append)
    wait_for(lambda: client.ready)
    client.send(UUID, number(goal))
    if goal == 5:
        wait_for(lambda: peer.told("/test"))
        client.cancel(UUID)
    assert last(events, "rejected").uuid == UUID
    assert peer.told("/test")[0] == f"goal {goal}"
    assert "accepted" not in [event.kind for event in events]


def test_a_recorded_goal_is_sent_to_a_server(ros1: Graph, shm_namespace: Namespace, tmp_path: Path) -> None:
    """``rosplc replay`` sends what a bridge carried, and waits for its end."""
    action = Action(shm_namespace, "ros", "noetic", TEST)
    with recording(shm_namespace, tmp_path / "shift") as recorder:
        action.ask(goal=1)
        until(lambda: received(recorder) == 1, recorder)
    action.close()
    peer = ros1.peer("actionlib", "robot")
    peer.act("server", "/test")
    command = ["replay", str(tmp_path / "shift.mcap"), "--to", "ros", "--backend", "rospy", "--json"]
    command += ["--action", NAME, "--rename", f"{NAME}:=/test", "--wait", "60s", "--quiet"]
    done = CliRunner().invoke(app, command, env={**ros1.environment})
    [count] = json.loads(done.stdout)["topics"].values()
    assert (count["sent"], count["reason"], done.exit_code) == (1, "", 0)
    assert peer.told("/test")[0] == "goal 1"


def test_a_server_that_is_restarted(ros1: Graph, cell: Backend, events: list[GoalEvent]) -> None:
    """It does not know the goal of its predecessor; a client in another process finds one that it knows."""
    peer = ros1.peer("actionlib", "robot")
    peer.act("server", "/test")
    client = CLIENT(cell, STORE, "/test", TEST, events.append)
    wait_for(lambda: client.ready)
    client.send(UUID, number(3))
    last(events, "accepted")
    client.close()
    events.clear()
    client = CLIENT(cell, STORE, "/test", TEST, events.append)
    client.adopt(UUID)
    assert last(events, "status").status is GoalStatus.EXECUTING
    peer.kill()
    ros1.peer("actionlib", "successor").act("server", "/test")
    assert last(events, "result") == GoalEvent(UUID, "result")
