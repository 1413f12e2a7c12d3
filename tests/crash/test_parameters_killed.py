"""Parameters while the bridge is killed between a set and its taking: whole, or not at all."""

from __future__ import annotations

import random
from typing import Any

import pytest

from rosplc.ros import Qos, Reply, fields
from tests.interop.graphs import LOCAL, free_domain
from tests.lib.waiting import repeat_until
from tests.verification.joint import Joint, made_joint, ros_side
from tests.verification.plc_cell import store

pytestmark = [pytest.mark.timeout(300), pytest.mark.verifies("parameters", own="killed processes")]

CONFIG = """bridge: params
ros: {SIDE}
shm: {directory: FOLDER}
diagnostics: {enabled: false}
parameters:
  declare: {a: {type: integer}, b: {type: integer}}
"""
SET, GET = "rcl_interfaces/srv/SetParametersAtomically", "rcl_interfaces/srv/GetParameters"
ROUNDS = 12


class Cell:
    """Two clients of the bridge's node, and what the PLC has had in both parameters, scan by scan."""

    def __init__(self, joint: Joint) -> None:
        self.joint = joint
        names = {SET: "set_parameters_atomically", GET: "get_parameters"}
        self.clients = {
            kind: joint.peer.client(f"/rosplc_params/{name}", kind, Qos(depth=1000))
            for kind, name in names.items()
        }

    def scan(self) -> tuple[int, int]:
        """Run the PLC once; return both values, which a program always sees equal."""
        self.joint.scan()
        a, b = (self.joint.machine.get(f"ROS_Parameters.values.{name}") for name in "ab")
        assert a == b, "half of an atomic set"
        return a, b

    def call(self, kind: str, **request: Any) -> list[dict[str, Any] | None]:
        """Call a service; return the list that its response comes into, None if there is none."""
        ended: list[dict[str, Any] | None] = []

        def take(reply: Reply) -> None:
            data = reply.payload
            ended.append(None if data is None else fields.unpack(store(), f"{kind}_Response", data))

        self.clients[kind].call(fields.pack(store(), f"{kind}_Request", request), take)
        return ended

    def set(self, number: int) -> list[dict[str, Any] | None]:
        value = {"type": 2, "integer_value": number}
        return self.call(SET, parameters=[{"name": name, "value": value} for name in "ab"])

    def until(self, ended: list[dict[str, Any] | None], what: str) -> dict[str, Any] | None:
        """Let the PLC run until a call has ended."""
        self.joint.until(lambda: self.scan() and ended, what)
        return ended[0]

    def values(self) -> list[int]:
        """Return what ROS is told; what is asked of a bridge that was killed is lost."""
        asked: list[list[dict[str, Any] | None]] = []

        def answer() -> dict[str, Any] | None:
            self.scan()
            return next((each[0] for each in asked if each and each[0] is not None), None)

        found = repeat_until(lambda: asked.append(self.call(GET, names=["a", "b"])), answer, "an answer")
        assert found is not None
        return [each["integer_value"] for each in found["values"]]


@pytest.mark.parametrize("backend", ["dds", "zenoh"])
def test_kills_between_a_set_and_its_taking(backend: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The PLC never has half of a set; what was confirmed stays; the next bridge tells what the PLC has."""
    pytest.importorskip({"dds": "cyclonedds", "zenoh": "zenoh"}[backend])
    for name, value in LOCAL.items():
        monkeypatch.setenv(name, value)
    dice, outcomes = random.Random(28), {"taken": 0, "not": 0}
    with (
        free_domain() as domain,
        ros_side(backend, domain) as (side, options),
        made_joint(CONFIG.replace("SIDE", side), "ROS_Parameters", domain, backend, options=options) as joint,
    ):
        cell = Cell(joint)
        joint.until(lambda: cell.clients[SET].ready, "the services")
        for number in range(1, ROUNDS + 1):
            before = 1000 * number
            first = cell.until(cell.set(before), "a set that nothing disturbs")
            assert first == {"result": {"successful": True, "reason": ""}}
            assert cell.scan() == (before, before)
            ended = cell.set(before + 1)
            for _ in range(dice.randrange({"dds": 12, "zenoh": 60}[backend])):
                cell.scan()
            joint.kill_bridge()
            for _ in range(20):
                cell.scan()
            now = cell.scan()[0]
            assert now in (before, before + 1)
            if ended and ended[0] is not None:
                assert now == before + 1, "confirmed, and not in the PLC"
            outcomes["taken" if now > before else "not"] += 1
            joint.start_bridge()
            joint.until(lambda now=now: cell.values() == [now, now], "what the PLC has")
            assert cell.scan() == (now, now)
    print("COUNTED", backend, outcomes)
