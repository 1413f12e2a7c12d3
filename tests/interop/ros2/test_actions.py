"""The action engine and rclpy's own action server and client, in processes of their own."""

from __future__ import annotations

import itertools
import os
import struct
import sys
import uuid
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from rosplc.model import TypeStore
from rosplc.ros import Backend, open_backend
from rosplc.ros.actions import ActionClient, ActionServer, GoalEvent
from rosplc.ros.goals import STEPS, GoalStatus, GoalStep
from tests.interop.actions.cell import FIBONACCI, Peer
from tests.interop.graphs import LOCAL
from tests.lib.waiting import wait_for

pytestmark = [pytest.mark.ros2, pytest.mark.timeout(120)]


@cache
def store() -> TypeStore:
    """Return the types, with those of the environment's own test messages."""
    return TypeStore.bundled("kilted").with_paths([Path(sys.prefix, "share", "test_msgs")])


def numbers(*values: int) -> bytes:
    return b"\0\1\0\0" + struct.pack(f"<I{len(values)}i", len(values), *values)


def values(payload: bytes) -> list[int]:
    return list(struct.unpack_from(f"<{int.from_bytes(payload[4:8], 'little')}i", payload, 8))


def goal(order: int) -> bytes:
    return b"\0\1\0\0" + struct.pack("<i", order)


def start(domain: int, **order: str) -> Peer:
    """Start a process of ``action_peer.py``."""
    command = [sys.executable, str(Path(__file__).with_name("action_peer.py")), str(domain), "peer"]
    return Peer(command, {**os.environ, **LOCAL}, **order)


@pytest.fixture
def cell(domain: int) -> Iterator[Backend]:
    backend = open_backend("rclpy", store(), "cell", domain=domain, environment=LOCAL)
    yield backend
    backend.close()


def test_a_client_of_rclpy(cell: Backend, domain: int) -> None:
    """It is rejected, succeeds with feedback, and cancels, as the program of the server decides."""
    goals: dict[int, bytes] = {}
    cancels: list[bytes] = []

    def on_goal(one: bytes, payload: bytes) -> None:
        goals[struct.unpack_from("<i", payload, 4)[0]] = one

    server = ActionServer(cell, store(), "/fibonacci", FIBONACCI, on_goal=on_goal, on_cancel=cancels.append)
    peer = start(domain, use="/fibonacci")
    for order in (1, 2, 3, 4):
        peer.tell(send=order)
        wait_for(lambda o=order: o in goals)
        assert server.reject(goals[order]) if order == 1 else server.accept(goals[order])
        assert peer.wait(order, "accepted")["accepted"] is (order > 1)
    for order in (2, 3):
        assert server.execute(goals[order])
        assert server.feedback(goals[order], numbers(1, 2))
        assert peer.wait(order, "feedback")["feedback"] == [1, 2]
    assert server.succeed(goals[2], numbers(3, 4, 5))
    assert peer.wait(2, "status") == {"goal": 2, "status": 4, "sequence": [3, 4, 5]}
    peer.tell(cancel=3)
    wait_for(lambda: cancels == [goals[3]])
    assert server.reject_cancel(goals[3])
    assert peer.wait(3, "canceling")["canceling"] == 1
    peer.said.clear()
    peer.tell(cancel=3)
    wait_for(lambda: len(cancels) == 2)
    assert server.accept_cancel(goals[3])
    assert peer.wait(3, "canceling")["canceling"] == 0
    assert server.canceled(goals[3], numbers(6))
    assert peer.wait(3, "status") == {"goal": 3, "status": 5, "sequence": [6]}
    assert server.execute(goals[4])
    assert server.abort(goals[4])
    assert peer.wait(4, "status") == {"goal": 4, "status": 6, "sequence": []}
    peer.close()


def test_a_server_of_rclpy(cell: Backend, domain: int) -> None:
    """Its decisions, feedback, states and results arrive; so they do at another client that adopts a goal."""
    peer = start(domain, serve="/fibonacci")
    events: list[GoalEvent] = []
    client = ActionClient(cell, store(), "/fibonacci", FIBONACCI, events.append)
    wait_for(lambda: client.ready)

    def send(order: int) -> bytes:
        one = uuid.uuid4().bytes
        client.send(one, goal(order))
        return one

    def wait(one: bytes, *kinds: str) -> GoalEvent:
        return wait_for(lambda: [e for e in tuple(events) if e.uuid == one and e.kind in kinds], kinds)[-1]

    wait(send(-1), "rejected")
    for order, status in ((4, GoalStatus.SUCCEEDED), (3, GoalStatus.ABORTED)):
        one = send(order)
        found = wait(one, "result")
        assert (found.status, values(found.payload or b"")) == (status, list(range(order)))
        assert values(wait(one, "feedback").payload or b"") == list(range(order))
    refused = send(77)
    wait(refused, "feedback")
    client.cancel(refused)
    wait(refused, "not canceled")
    one = send(60)
    wait(one, "feedback")
    later: list[GoalEvent] = []
    other = ActionClient(cell, store(), "/fibonacci", FIBONACCI, later.append)
    wait_for(lambda: other.ready)
    other.adopt(one)
    wait_for(lambda: any(event.kind == "feedback" for event in later))
    other.cancel(one)
    wait_for(lambda: any(event.kind == "canceling" for event in later))
    assert wait(one, "result").status is GoalStatus.CANCELED
    ended = wait_for(lambda: [event for event in later if event.kind == "result"])[0]
    assert ended.status is GoalStatus.CANCELED
    assert {event.status for event in later if event.kind == "status"} >= {GoalStatus.EXECUTING}
    peer.process.kill()
    assert wait(refused, "lost").reply is not None
    peer.close()


def test_the_states_are_those_of_rcl_action(cell: Any) -> None:
    """Every step from every state does what it does in rcl_action itself."""
    from rclpy.action import ActionServer as NativeServer
    from rclpy.impl.implementation_singleton import rclpy_implementation as native
    from test_msgs.action import Fibonacci
    from unique_identifier_msgs.msg import UUID

    ways = {
        GoalStatus.ACCEPTED: [],
        GoalStatus.EXECUTING: [GoalStep.EXECUTE],
        GoalStatus.CANCELING: [GoalStep.EXECUTE, GoalStep.CANCEL],
        GoalStatus.SUCCEEDED: [GoalStep.EXECUTE, GoalStep.SUCCEED],
        GoalStatus.CANCELED: [GoalStep.EXECUTE, GoalStep.CANCEL, GoalStep.CANCELED],
        GoalStatus.ABORTED: [GoalStep.EXECUTE, GoalStep.ABORT],
    }
    names = {step: step.name for step in GoalStep} | {GoalStep.CANCEL: "CANCEL_GOAL"}
    server = NativeServer(cell._node, Fibonacci, "/native", lambda _: None)
    for number, (state, step) in enumerate(itertools.product(ways, GoalStep)):
        info = Fibonacci.Impl.CancelGoalService.Request().goal_info
        info.goal_id = UUID(uuid=[number] * 16)
        handle = native.ActionGoalHandle(server._handle, info)
        for way in ways[state]:
            handle.update_goal_state(getattr(native.GoalEvent, names[way]))
        assert handle.get_status() == state
        event = getattr(native.GoalEvent, names[step])
        if (state, step) in STEPS:
            handle.update_goal_state(event)
            assert handle.get_status() == STEPS[state, step]
        else:
            with pytest.raises(native.RCLError):
                handle.update_goal_state(event)
            assert handle.get_status() == state
    server.destroy()
