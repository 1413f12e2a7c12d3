"""Services of a configuration: generated blocks, the bridge, and a ROS node on the other side."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from rosplc.reasons import Reason
from rosplc.ros import SERVICES
from rosplc.shm.constants import ErrorNumber
from tests.verification.joint import Joint, decode, encode, made_joint

TYPE = "std_srvs/srv/SetBool"
ADD = "example_interfaces/srv/AddTwoInts"
DOMAIN = 53
REQUEST, RESPONSE = f"{TYPE}_Request", f"{TYPE}_Response"
CONFIG = f"""bridge: services
ros: {{backend: memory, domain: {DOMAIN}}}
shm: {{directory: FOLDER}}
diagnostics: {{enabled: false}}
services:
  /lamp: {{type: {TYPE}, server: ros, clients: [left, right]}}
  /start: {{type: {TYPE}, server: plc}}
"""


@pytest.fixture
def joint() -> Iterator[Joint]:
    with made_joint(CONFIG, "ROS_Services", DOMAIN) as made:
        yield made


def test_the_plc_calls(joint: Joint) -> None:
    """Two clients of one service, each with its own answer; without a server the call waits."""
    for name, data in (("lamp_left", True), ("lamp_right", False)):
        joint.set(name, **{"request.data": data, "xExecute": True})
    joint.until(lambda: joint.get("lamp_left", "xPeerAlive", "xBusy") == (True, True), "the bridge")
    asked: list[tuple[bytes, bytes]] = []
    server = joint.peer.serve("/lamp", TYPE, SERVICES, lambda data, caller, _: asked.append((data, caller)))
    joint.until(lambda: len(asked) == 2, "both calls")
    for payload, caller in asked:
        on = decode(REQUEST, payload)["data"]
        assert server.reply(caller, encode(RESPONSE, success=on, message=f"lamp {on}"))
    for name, data in (("lamp_left", True), ("lamp_right", False)):
        joint.until(lambda name=name: joint.get(name, "xDone"), f"the answer to {name}")
        assert joint.get(name, "response.success", "response.message") == (data, f"lamp {data}")
        assert joint.get(name, "xServer", "udiError", "xBusy") == (True, 0, False)


def test_the_plc_gives_up(joint: Joint) -> None:
    """A call that ROS does not answer ends by tTimeout with an unknown fate; the next call is a new one."""
    asked: list[tuple[bytes, bytes]] = []
    server = joint.peer.serve("/lamp", TYPE, SERVICES, lambda data, caller, _: asked.append((data, caller)))
    joint.until(lambda: joint.get("lamp_left", "xServer"), "the server")
    joint.set("lamp_left", xExecute=True, tTimeout=200)
    joint.until(lambda: asked, "the call", step=0)
    joint.until(lambda: joint.get("lamp_left", "xError"), "the time-out")
    assert len(asked) == 1
    assert joint.get("lamp_left", "eError", "eReason") == (ErrorNumber.FATE_UNKNOWN, Reason.TIME_OUT)
    joint.set("lamp_left", xExecute=False)
    joint.until(lambda: not joint.get("lamp_left", "xError"), "xExecute to fall")
    joint.set("lamp_left", xExecute=True, tTimeout=0)
    joint.until(lambda: len(asked) == 2, "the second call")
    server.reply(asked[0][1], encode(RESPONSE, success=False))
    server.reply(asked[1][1], encode(RESPONSE, success=True))
    joint.until(lambda: joint.get("lamp_left", "xDone"), "the second answer")
    assert joint.get("lamp_left", "response.success") is True


def test_ros_calls(joint: Joint) -> None:
    """Each call of a ROS node is shown once, and gets the program's answer."""
    client = joint.peer.client("/start", TYPE, SERVICES)
    joint.until(lambda: client.ready and joint.get("start", "xAttached", "xPeerAlive") == (True, True), "all")
    replies: list[Any] = []
    for number in range(3):
        client.call(encode(REQUEST, data=bool(number % 2)), replies.append)
        joint.until(lambda: joint.get("start", "xRequest"), "the request")
        assert joint.get("start", "request.data") is bool(number % 2)
        joint.set("start", **{"response.success": True, "response.message": f"n{number}", "xReply": True})
        joint.until(lambda number=number: len(replies) == number + 1, "the answer")
        joint.set("start", xReply=False)
        joint.scan()
        assert decode(RESPONSE, replies[-1].payload) == {"success": True, "message": f"n{number}"}
    assert joint.get("start", "udiCalls", "udiError") == (3, 0)


def test_a_restarted_plc_executes_nothing(joint: Joint) -> None:
    """A call in hand at STOP → RUN is not shown again; the next one is."""
    client = joint.peer.client("/start", TYPE, SERVICES)
    joint.until(lambda: client.ready and joint.get("start", "xAttached", "xPeerAlive") == (True, True), "all")
    client.call(encode(REQUEST, data=True), lambda _: None)
    joint.until(lambda: joint.get("start", "xRequest"), "the request")
    joint.restart_plc()
    joint.until(lambda: joint.get("start", "xAttached", "xPeerAlive") == (True, True), "the start")
    for _ in range(50):
        assert not joint.get("start", "xRequest")
        joint.scan()
    client.call(encode(REQUEST, data=False), lambda _: None)
    joint.until(lambda: joint.get("start", "xRequest"), "the next request")
    assert joint.get("start", "request.data", "udiCalls") == (False, 1)


def test_a_restarted_bridge(joint: Joint) -> None:
    """A call that the PLC has sent ends with an unknown fate; nothing is sent twice, and calls go on."""
    asked: list[tuple[bytes, bytes]] = []
    server = joint.peer.serve("/lamp", TYPE, SERVICES, lambda data, caller, _: asked.append((data, caller)))
    joint.set("lamp_left", xExecute=True)
    joint.until(lambda: asked, "the call")
    joint.stop_bridge()
    joint.start_bridge()
    joint.until(lambda: joint.get("lamp_left", "xError"), "the end")
    assert joint.get("lamp_left", "eError") == ErrorNumber.FATE_UNKNOWN
    assert len(asked) == 1
    joint.set("lamp_left", xExecute=False)
    joint.until(lambda: not joint.get("lamp_left", "xError"), "xExecute to fall")
    joint.set("lamp_left", xExecute=True)
    joint.until(lambda: len(asked) == 2, "the next call")
    server.reply(asked[1][1], encode(RESPONSE, success=True))
    joint.until(lambda: joint.get("lamp_left", "xDone"), "its answer")


INTERLEAVED = f"""bridge: services
ros: {{backend: memory, domain: {DOMAIN}}}
shm: {{directory: FOLDER}}
diagnostics: {{enabled: false}}
tasks: {{Fast: {{interval: 2ms}}, Slow: {{interval: 10ms}}}}
services:
  /add: {{type: {ADD}, server: ros, task: Slow, clients: {{one: {{task: Fast}}, two: {{}}, three: {{}}}}}}
"""


def test_three_clients_in_two_tasks() -> None:
    """Interleaved calls of one service: each gets its own answer, once, also over online changes."""
    names = ("add_one", "add_two", "add_three")
    with made_joint(INTERLEAVED, "ROS_Services", DOMAIN) as joint:
        open_calls: dict[int, bytes] = {}
        carried_out: list[int] = []

        def carry_out(payload: bytes, caller: bytes, _stamp_ns: int) -> None:
            asked = decode(f"{ADD}_Request", payload)
            carried_out.append(asked["a"])
            open_calls[asked["a"]] = caller

        server = joint.peer.serve("/add", ADD, SERVICES, carry_out)
        for turn in range(12):
            calls = {name: 10 * turn + index for index, name in enumerate(names)}
            for name, number in calls.items():
                joint.set(name, **{"request.a": number, "request.b": 1000, "xExecute": True})
                joint.scan(count=turn % 3)  # one after the other, or at once
            joint.until(lambda calls=calls: open_calls.keys() == set(calls.values()), "the calls")
            if turn % 2:
                joint.machine.online_change()
            order = sorted(calls.items(), key=lambda item: (item[1] * 7 + turn) % 5)
            for name, number in order:
                answer = encode(f"{ADD}_Response", sum=number + 1000)
                assert server.reply(open_calls.pop(number), answer)
                joint.until(lambda name=name: joint.get(name, "xDone"), f"the answer to {name}")
                assert joint.get(name, "response.sum", "udiLate") == (number + 1000, 0)
                joint.set(name, xExecute=False)
                joint.machine.online_change()
            joint.scan()
            assert [joint.get(name, "xBusy", "xDone") for name in names] == [(False, False)] * 3
        assert sorted(carried_out) == sorted(10 * turn + index for turn in range(12) for index in range(3))
        assert [joint.get(name, "udiCalls", "udiError") for name in names] == [(12, 0)] * 3
