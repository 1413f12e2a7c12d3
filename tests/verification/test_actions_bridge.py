"""Actions of a configuration: generated blocks, the bridge, and a ROS node on the other side."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from rosplc.demo.plan import FreeDomain
from rosplc.reasons import Reason
from rosplc.ros import ActionClient, ActionServer, GoalEvent, GoalStatus
from rosplc.shm.constants import ErrorNumber
from tests.verification.joint import Joint, decode, encode, made_joint
from tests.verification.plc_cell import store
from tests.verification.test_services import ABORTED, BUSY, DONE, ENDS, ERROR, IDLE

TYPE = "example_interfaces/action/Fibonacci"
GOAL, RESULT, FEEDBACK = f"{TYPE}_Goal", f"{TYPE}_Result", f"{TYPE}_Feedback"
DOMAIN = 54
CONFIG = f"""bridge: actions
ros: {{backend: BACKEND, domain: DOMAIN}}
shm: {{directory: FOLDER}}
beat: 20ms
diagnostics: {{enabled: false}}
actions:
  /cycle: {{type: {TYPE}, server: plc, on_new_goal: ON_NEW_GOAL}}
  /drive: {{type: {TYPE}, server: ros}}
"""
_numbers = itertools.count(1)


def config(backend: str = "memory", domain: int = DOMAIN, on_new_goal: str = "reject") -> str:
    text = CONFIG.replace("BACKEND", backend).replace("DOMAIN", str(domain))
    return text.replace("ON_NEW_GOAL", on_new_goal)


class Client:
    """A ROS client of /cycle."""

    def __init__(self, joint: Joint) -> None:
        self.joint = joint
        self.events: list[GoalEvent] = []
        self.client = ActionClient(joint.peer, store(), "/cycle", TYPE, self.events.append)
        joint.until(lambda: self.client.ready, "the bridge's server")
        joint.until(lambda: joint.get("cycle", "xAttached", "xPeerAlive") == (True, True), "the PLC")

    def send(self, order: int = 1) -> bytes:
        uuid = next(_numbers).to_bytes(16, "big")
        assert self.client.send(uuid, encode(GOAL, order=order))
        return uuid

    def offered(self, order: int = 1) -> bytes:
        uuid = self.send(order)
        self.joint.until(lambda: self.joint.get("cycle", "xGoal"), "the goal")
        assert self.joint.get("cycle", "goal.order", "xActive") == (order, False)
        return uuid

    def running(self, order: int = 1) -> bytes:
        uuid = self.offered(order)
        press(self.joint, "xAccept")
        self.until(uuid, "accepted")
        assert self.joint.get("cycle", "xActive")
        return uuid

    def of(self, uuid: bytes, kind: str) -> list[GoalEvent]:
        return [event for event in self.events if (event.uuid, event.kind) == (uuid, kind)]

    def until(self, uuid: bytes, kind: str, count: int = 1) -> GoalEvent:
        return self.joint.until(lambda: self.of(uuid, kind)[count - 1 :], f"{kind} of the goal")[0]

    def result_again(self, uuid: bytes) -> tuple[GoalStatus, list[int]]:
        """Ask another server for the result until it knows it, and return it."""
        self.joint.until(lambda: self.client.ready, "the next server")
        asked = 0

        def known() -> list[GoalEvent]:
            nonlocal asked
            ends = [*self.of(uuid, "result"), *self.of(uuid, "lost")]
            found = [event for event in ends if event.status]
            if not found and len(ends) >= asked:
                asked = len(ends) + 1
                self.client.adopt(uuid)
            return found

        event = self.joint.until(known, "the result")[0]
        return event.status, decode(RESULT, event.payload)["sequence"]

    def result(self, uuid: bytes) -> tuple[GoalStatus, list[int]]:
        event = self.until(uuid, "result")
        assert event.payload is not None
        return event.status, decode(RESULT, event.payload)["sequence"]


class Server:
    """A ROS server of /drive."""

    def __init__(self, joint: Joint) -> None:
        self.joint = joint
        self.goals: list[tuple[bytes, int]] = []
        self.cancels: list[bytes] = []

        def on_goal(uuid: bytes, goal: bytes) -> None:
            self.goals.append((uuid, decode(GOAL, goal)["order"]))

        answers = {"on_goal": on_goal, "on_cancel": self.cancels.append}
        self.server = ActionServer(joint.peer, store(), "/drive", TYPE, **answers)
        joint.until(lambda: joint.get("drive", "xServer"), "the server")

    def asked(self, order: int = 1, **pins: Any) -> bytes:
        before = len(self.goals)
        self.joint.set("drive", **{"goal.order": order, "xExecute": True, **pins})
        self.joint.until(lambda: len(self.goals) > before, "the goal", step=0)
        assert self.goals[before][1] == order
        return self.goals[before][0]

    def running(self, order: int = 1, **pins: Any) -> bytes:
        uuid = self.asked(order, **pins)
        assert self.server.accept(uuid)
        assert self.server.execute(uuid)
        self.joint.until(lambda: self.joint.get("drive", "xActive"), "the acceptance")
        return uuid


def press(joint: Joint, pin: str) -> None:
    """Let an input of /cycle rise and fall."""
    joint.set("cycle", **{pin: True})
    joint.scan()
    joint.set("cycle", **{pin: False})
    joint.scan()


def fill(joint: Joint, record: str, *values: int) -> None:
    """Set a sequence."""
    joint.set("cycle", **{f"{record}.sequence_count": len(values)})
    joint.set("cycle", **{f"{record}.sequence[{index}]": value for index, value in enumerate(values)})


@pytest.fixture
def joint() -> Iterator[Joint]:
    with made_joint(config(), "ROS_Actions", DOMAIN) as made:
        yield made


# ---- ROS sends goals to the PLC


def test_a_goal_of_ros(joint: Joint) -> None:
    """Accepted, followed by its feedback, reached; the next one is another."""
    client = Client(joint)
    for order in (3, 4):
        uuid = client.running(order)
        for value in range(3):
            fill(joint, "feedback", order, value)
            press(joint, "xSendFeedback")
            expected = encode(FEEDBACK, sequence=[order, value])
            joint.until(lambda: client.of(uuid, "feedback")[-1:], "feedback")  # noqa: B023
            joint.until(lambda: client.of(uuid, "feedback")[-1].payload == expected, "it")  # noqa: B023
        fill(joint, "result", order, order)
        press(joint, "xSucceed")
        assert client.result(uuid) == (GoalStatus.SUCCEEDED, [order, order])
        assert joint.get("cycle", "xGoal", "xActive", "udiError") == (False, False, 0)
    assert joint.get("cycle", "udiCalls", "udiRefused") == (2, 0)


def test_a_goal_of_ros_that_is_rejected_or_aborted(joint: Joint) -> None:
    """The program's decision is what the client is told; while a goal runs, others are rejected."""
    client = Client(joint)
    uuid = client.offered()
    press(joint, "xReject")
    client.until(uuid, "rejected")
    uuid = client.running(5)
    client.until(client.send(6), "rejected")
    assert joint.get("cycle", "goal.order", "xPreempt") == (5, False)
    fill(joint, "result", 1)
    press(joint, "xAbort")
    assert client.result(uuid) == (GoalStatus.ABORTED, [1])


def test_a_goal_of_ros_that_is_not_decided_on() -> None:
    """It is rejected, and the program can accept it no more."""
    text = config().replace("on_new_goal: reject", "accept_within: 300ms")
    with made_joint(text, "ROS_Actions", DOMAIN) as joint:
        client = Client(joint)
        client.until(client.send(1), "rejected")
        assert joint.get("cycle", "xGoal", "xActive") == (False, False)
        joint.set("cycle", xAccept=True)
        joint.scan()
        assert joint.get("cycle", "eError", "xActive") == (ErrorNumber.ILLEGAL_STEP, False)


def test_a_goal_of_ros_is_canceled(joint: Joint) -> None:
    """The program rejects the first request to cancel and accepts the second."""
    client = Client(joint)
    uuid = client.running()
    client.client.cancel(uuid)
    joint.until(lambda: joint.get("cycle", "xCancelRequested"), "the request")
    press(joint, "xRejectCancel")
    client.until(uuid, "not canceled")
    assert joint.get("cycle", "xCancelRequested", "xCanceling", "xActive") == (False, False, True)
    client.client.cancel(uuid)
    joint.until(lambda: joint.get("cycle", "xCancelRequested"), "the second request")
    press(joint, "xAcceptCancel")
    client.until(uuid, "canceling")
    fill(joint, "result", 7)
    press(joint, "xCanceled")
    assert client.result(uuid) == (GoalStatus.CANCELED, [7])


def test_a_goal_of_ros_that_replaces_another() -> None:
    """The PLC ends the old goal; only then it gets the new one."""
    with made_joint(config(on_new_goal="abort"), "ROS_Actions", DOMAIN) as joint:
        client = Client(joint)
        old = client.running(1)
        new = client.send(2)
        joint.until(lambda: joint.get("cycle", "xPreempt"), "xPreempt")
        assert joint.get("cycle", "goal.order", "xActive") == (1, True)
        press(joint, "xAbort")
        assert client.result(old)[0] is GoalStatus.ABORTED
        joint.until(lambda: joint.get("cycle", "xGoal"), "the new goal")
        assert joint.get("cycle", "goal.order", "xPreempt") == (2, False)
        press(joint, "xAccept")
        client.until(new, "accepted")
        press(joint, "xSucceed")
        assert client.result(new)[0] is GoalStatus.SUCCEEDED


def test_stop_and_run_with_a_goal_of_ros(joint: Joint) -> None:
    """The goal is aborted, and not shown again; the next one is."""
    client = Client(joint)
    uuid = client.running(1)
    joint.restart_plc()
    assert client.result(uuid)[0] is GoalStatus.ABORTED
    joint.until(lambda: joint.get("cycle", "xAttached", "xPeerAlive") == (True, True), "the PLC")
    assert joint.get("cycle", "xGoal", "xActive", "udiCalls") == (False, False, 0)
    client.offered(2)


def test_online_change_with_a_goal_of_ros(joint: Joint) -> None:
    """The goal goes on, and is shown once; so does one that has not been decided on."""
    client = Client(joint)
    uuid = client.offered(1)
    joint.machine.online_change()
    joint.scan(count=5)
    press(joint, "xAccept")
    client.until(uuid, "accepted")
    joint.machine.online_change()
    client.client.cancel(uuid)
    joint.until(lambda: joint.get("cycle", "xCancelRequested"), "the request")
    joint.machine.online_change()
    press(joint, "xSucceed")
    assert client.result(uuid)[0] is GoalStatus.SUCCEEDED
    assert joint.get("cycle", "udiCalls", "udiError") == (1, 0)


# ---- the PLC sends goals to ROS


def test_a_goal_of_the_plc(joint: Joint) -> None:
    """Accepted, followed by its feedback, reached."""
    server = Server(joint)
    for order in (3, 4):
        uuid = server.running(order)
        assert joint.get("drive", *ENDS) == BUSY
        assert server.server.feedback(uuid, encode(FEEDBACK, sequence=[order, 1]))
        joint.until(lambda: joint.get("drive", "xNewFeedback"), "feedback")
        assert joint.get("drive", "feedback.sequence[0]", "feedback.sequence_count") == (order, 2)
        assert server.server.succeed(uuid, encode(RESULT, sequence=[order, 2]))
        joint.until(lambda: joint.get("drive", *ENDS) == DONE, "the end")
        assert joint.get("drive", "result.sequence[1]", "eStatus") == (2, GoalStatus.SUCCEEDED)
        joint.set("drive", xExecute=False)
        joint.scan()
        assert joint.get("drive", *ENDS) == IDLE
    assert len(server.goals) == 2


Step = Callable[[ActionServer, bytes], bool]
_ENDS: dict[str, tuple[Step, tuple[bool, ...], int, int]] = {
    "rejected": (ActionServer.reject, ERROR, ErrorNumber.NOT_EXECUTED, Reason.REJECTED),
    "aborted": (ActionServer.abort, ERROR, ErrorNumber.GOAL_ABORTED, 0),
    "canceled": (ActionServer.canceled, ABORTED, ErrorNumber.GOAL_CANCELED, 0),
}


@pytest.mark.parametrize("end", _ENDS)
def test_the_ends_of_a_goal_of_the_plc(joint: Joint, end: str) -> None:
    """What the server decides is what the pins show; a rejected cancellation changes nothing."""
    server = Server(joint)
    step, ends, number, reason = _ENDS[end]
    uuid = server.asked() if end == "rejected" else server.running()
    if end == "canceled":
        joint.set("drive", xCancel=True)
        joint.until(lambda: server.cancels, "the request to cancel")
        assert server.server.reject_cancel(uuid)
        joint.until(lambda: joint.get("drive", "xCancelRejected"), "the answer")
        assert joint.get("drive", *ENDS) == BUSY
        joint.set("drive", xCancel=False)
        joint.until(lambda: not joint.get("drive", "xCancelRejected"), "xCancel to fall")
        joint.set("drive", xCancel=True)
        joint.until(lambda: len(server.cancels) == 2, "the second request")
        assert server.server.accept_cancel(uuid)
        joint.until(lambda: joint.get("drive", "eStatus") == GoalStatus.CANCELING, "the second answer")
    assert step(server.server, uuid)
    joint.until(lambda: not joint.get("drive", "xBusy"), "the end")
    assert joint.get("drive", *ENDS) == ends
    assert joint.get("drive", "eError", "eReason") == (number, reason)


def test_a_goal_of_the_plc_that_takes_too_long(joint: Joint) -> None:
    """TTimeout cancels the goal; the next one waits for its end."""
    server = Server(joint)
    uuid = server.running(1, tTimeout=200)
    joint.until(lambda: joint.get("drive", *ENDS) == ERROR, "the time-out")
    assert joint.get("drive", "eError", "eReason") == (ErrorNumber.FATE_UNKNOWN, Reason.TIME_OUT)
    joint.until(lambda: server.cancels == [uuid], "the request to cancel", step=0)
    joint.set("drive", xExecute=False, tTimeout=0)
    joint.scan()
    joint.set("drive", **{"xExecute": True, "goal.order": 2})
    joint.scan(count=20)
    assert len(server.goals) == 1
    assert server.server.accept_cancel(uuid)
    assert server.server.canceled(uuid)
    joint.until(lambda: len(server.goals) == 2, "the next goal")
    assert server.goals[1][1] == 2


def test_stop_and_run_with_a_goal_of_the_plc(joint: Joint) -> None:
    """Who has stopped has its goal canceled; the program that starts knows nothing of it."""
    server = Server(joint)
    uuid = server.running(1)
    joint.restart_plc()
    joint.until(lambda: server.cancels == [uuid], "the request to cancel")
    assert joint.get("drive", *ENDS) == IDLE
    assert server.server.accept_cancel(uuid)
    assert server.server.canceled(uuid)
    joint.until(lambda: joint.get("drive", "xServer"), "the server")
    assert server.asked(2) != uuid


def test_online_change_with_a_goal_of_the_plc(joint: Joint) -> None:
    """The goal goes on, and is sent once."""
    server = Server(joint)
    uuid = server.asked(1)
    joint.machine.online_change()
    assert server.server.accept(uuid)
    assert server.server.execute(uuid)
    joint.until(lambda: joint.get("drive", "xActive"), "the acceptance")
    joint.machine.online_change()
    assert server.server.succeed(uuid, encode(RESULT, sequence=[1]))
    joint.until(lambda: joint.get("drive", *ENDS) == DONE, "the end")
    assert len(server.goals) == 1
    assert not server.cancels


# ---- the bridge dies


def test_a_bridge_that_is_killed_with_goals_in_hand() -> None:
    """The next bridge adopts both: neither is sent again, and both results arrive."""
    domain = FreeDomain()
    try:
        with made_joint(config("dds", domain.number), "ROS_Actions", domain.number, "dds") as joint:
            client, server = Client(joint), Server(joint)
            for turn in range(2):
                served, called = client.running(turn), server.running(turn)
                joint.kill_bridge()
                if turn == 1:  # while no bridge is there
                    assert server.server.succeed(called, encode(RESULT, sequence=[turn]))
                    fill(joint, "result", turn)
                    press(joint, "xSucceed")
                joint.start_bridge()
                if turn == 0:
                    joint.until(lambda: joint.get("drive", "xPeerAlive"), "the next bridge")
                    joint.until(lambda: joint.get("cycle", "xPeerAlive"), "the next bridge")
                    assert server.server.succeed(called, encode(RESULT, sequence=[turn]))
                    fill(joint, "result", turn)
                    press(joint, "xSucceed")
                joint.until(lambda: joint.get("drive", *ENDS) == DONE, "the end of the PLC's goal")
                assert joint.get("drive", "result.sequence[0]") == turn
                assert client.result_again(served) == (GoalStatus.SUCCEEDED, [turn])
                joint.set("drive", xExecute=False)
                joint.scan()
            assert len({uuid for uuid, _ in server.goals}) == len(server.goals) == 2
            assert joint.get("cycle", "udiCalls", "udiError") == (2, 0)
    finally:
        domain.close()
