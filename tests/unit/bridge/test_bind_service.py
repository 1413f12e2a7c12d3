"""A service between a PLC's program and a program that has ROS' place."""

from __future__ import annotations

from collections.abc import Callable

import pytest

import rosplc
from rosplc.shm import Namespace
from rosplc.virtual_plc import ServiceClient, ServiceServer, Task
from tests.lib.waiting import wait_for

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
