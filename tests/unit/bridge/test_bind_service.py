"""A service or action between a PLC's program and a program that has ROS' place."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from threading import Event
from typing import Any

import pytest

import rosplc
from rosplc.bridge import bind_service
from rosplc.shm import Namespace
from rosplc.virtual_plc import ActionClient, ActionServer, ServiceClient, ServiceServer, Task
from tests.lib.waiting import wait_for

FIBONACCI = "example_interfaces/action/Fibonacci"
SET_BOOL, TRIGGER = "std_srvs/srv/SetBool", "std_srvs/srv/Trigger"


def outcome(start: Callable[..., rosplc.RecordView], *, data: bool, timeout: float = 60.0) -> str:
    """Call, and return the response's message or the error's code."""
    try:
        return str(start({"data": data}, timeout).message)
    except rosplc.ChannelError as error:
        return error.code


def test_a_program_calls_the_plc(shm_namespace: Namespace) -> None:
    """It gets the response, or is told that the call was refused."""
    server = ServiceServer("/start", prefix=shm_namespace.prefix, beat_ms=100)
    task = Task("T", 0.002)

    @task.program
    def scan() -> None:
        there = server()
        server.xReply = there and server.request.data and not server.xReply
        server.xReject = there and not server.request.data and not server.xReject
        if server.xReply:
            server.response.message = "started"

    with rosplc.bind_service("/start", SET_BOOL, prefix=shm_namespace.prefix) as start:
        assert outcome(start, data=True) == "SHM140"
        task.start()
        try:
            wait_for(lambda: outcome(start, data=True) == "started", "the PLC's answer")
            assert outcome(start, data=False) == "SHM140"
            with pytest.raises(rosplc.LayoutError):
                start({"data": "yes"})
        finally:
            task.stop()
            server.close()


def test_a_call_that_the_plc_began_and_did_not_end(shm_namespace: Namespace) -> None:
    server = ServiceServer("/start", prefix=shm_namespace.prefix, beat_ms=100)
    task = Task("T", 0.002, programs=[server])
    with rosplc.bind_service("/start", SET_BOOL, prefix=shm_namespace.prefix) as start:
        task.start()
        try:
            wait_for(lambda: outcome(start, data=True, timeout=0.5) == "SHM141", "a call of unknown fate")
            assert server.xRequest
        finally:
            task.stop()
            server.close()


def test_the_plc_calls_a_program(shm_namespace: Namespace) -> None:
    client = ServiceClient("/close", prefix=shm_namespace.prefix, beat_ms=100)
    task = Task("T", 0.002)

    @task.program
    def scan() -> None:
        client.xExecute = client.request is not None
        client()

    def close(request: rosplc.RecordView) -> dict[str, object]:
        return {"success": True, "message": "closed"}

    with rosplc.bind_service("/close", TRIGGER, close, prefix=shm_namespace.prefix):
        task.start()
        try:
            wait_for(lambda: client.xDone, "an answer")
            assert client.response is not None
            assert client.response.message == "closed"
        finally:
            task.stop()
            client.close()


def test_a_second_owner_is_refused(shm_namespace: Namespace) -> None:
    with (
        rosplc.bind_service("/start", SET_BOOL, prefix=shm_namespace.prefix),
        pytest.raises(rosplc.ChannelError) as caught,
        rosplc.bind_service("/start", SET_BOOL, prefix=shm_namespace.prefix),
    ):
        pass
    assert caught.value.code == "SHM116"


def test_a_program_sends_goals_to_the_plc(shm_namespace: Namespace) -> None:
    """It sees the feedback and gets the result, or is told how the goal has ended."""
    server = ActionServer("/count", prefix=shm_namespace.prefix, beat_ms=10_000)
    task = Task("T", 0.002)

    @task.program
    def scan() -> None:
        server()
        wanted = server.goal.order if server.xGoal or server.xActive else 0
        server.xReject, server.xAccept = server.xGoal and wanted == 1, server.xGoal and wanted != 1
        server.xAcceptCancel, server.xCanceled = server.xCancelRequested, server.xCanceling
        server.xSucceed, server.xAbort = server.xActive and wanted == 2, server.xActive and wanted == 3
        server.xSendFeedback = server.xActive and wanted == 4
        if server.xActive:
            server.feedback.sequence = server.result.sequence = [wanted]

    def outcome(order: int, **how: Any) -> Any:
        try:
            return list(send({"order": order}, **how).sequence)
        except rosplc.ChannelError as error:
            return error.code

    seen: list[int] = []

    def watch(feedback: rosplc.RecordView) -> bool:
        seen.extend(feedback.sequence)
        return True

    with rosplc.bind_action("/count", FIBONACCI, prefix=shm_namespace.prefix) as send:
        task.start()
        try:
            wait_for(lambda: outcome(2) == [2], "the PLC's result")
            assert outcome(1) == "SHM140"
            wait_for(lambda: outcome(3) == "SHM143", "a goal that is aborted")
            wait_for(lambda: outcome(4, feedback=watch) == "SHM144", "a goal that is canceled")
            assert seen and set(seen) == {4}
            wait_for(lambda: outcome(5, timeout=0.1) == "SHM144", "a goal that takes too long")
            with pytest.raises(rosplc.LayoutError):
                send({"order": "many"})
        finally:
            task.stop()
            server.close()


@pytest.mark.parametrize(
    ("order", "end"), [(3, "DONE"), (0, "GOAL_ABORTED"), (-1, "GOAL_ABORTED"), (99, "GOAL_CANCELED")]
)
def test_the_plc_sends_goals_to_a_program(shm_namespace: Namespace, order: int, end: str) -> None:
    """A generator yields feedback and returns the result; it is closed when the PLC cancels."""
    client = ActionClient("/count", prefix=shm_namespace.prefix, beat_ms=10_000)
    task, fed, closed = Task("T", 0.002), [], Event()

    @task.program
    def scan() -> None:
        if client.goal is not None:
            client.goal.order, client.xExecute = order, True
        client()
        if client.xNewFeedback:
            fed.append(list(client.feedback.sequence))
            client.xCancel = order == 99

    def count(goal: rosplc.RecordView) -> Iterator[Any]:
        if not goal.order:
            raise ValueError("nothing to count")
        wait = Event()
        try:
            if goal.order < 0:
                return {"sequence": "no numbers"}
            for number in range(goal.order) if goal.order == 3 else itertools.count():
                yield {"sequence": [number]}
                wait.wait(0.02)
        finally:
            closed.set()
        return {"sequence": list(range(goal.order))}

    with rosplc.bind_action("/count", FIBONACCI, count, prefix=shm_namespace.prefix):
        task.start()
        try:
            wait_for(lambda: client.xDone or client.xError or client.xAborted, "the end")
            assert ("DONE" if client.xDone else client.eError.name) == end
            if order:
                assert closed.wait(60)
                assert order in (3, -1) or fed
            if order == 3:
                assert list(client.result.sequence) == [0, 1, 2]
        finally:
            task.stop()
            client.close()


@pytest.mark.parametrize("patient", [True, False])
def test_the_plc_is_told_that_a_program_ends(
    shm_namespace: Namespace, monkeypatch: pytest.MonkeyPatch, patient: bool
) -> None:
    """Its goal is aborted when the block ends, whether or not the handler comes to a ``yield``."""
    client = ActionClient("/count", prefix=shm_namespace.prefix, beat_ms=10_000)
    task, waits, go_on, closed = Task("T", 0.002), Event(), Event(), Event()
    if not patient:
        monkeypatch.setattr(bind_service, "_PATIENCE_S", 0.2)

    @task.program
    def scan() -> None:
        if client.goal is not None:
            client.goal.order, client.xExecute = 3, True
        client()

    def count(_: rosplc.RecordView) -> Iterator[Any]:
        try:
            while True:
                yield {"sequence": [1]}
                waits.set()
                go_on.wait(0.02 if patient else None)
        finally:
            closed.set()

    with rosplc.bind_action("/count", FIBONACCI, count, prefix=shm_namespace.prefix):
        task.start()
        assert waits.wait(60), "a handler that has come to no yield yet may still be closed at its first"
    try:
        wait_for(lambda: client.xError or client.xAborted, "the end")
        assert client.eError.name == "GOAL_ABORTED"
        assert closed.is_set() is patient
    finally:
        task.stop()
        client.close()
        go_on.set()
        assert closed.wait(60)
