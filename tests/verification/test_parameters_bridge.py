"""Parameters of a configuration: the generated block, the bridge, and a ROS node on the other side."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import pytest

from rosplc.ros import Qos, fields
from rosplc.ros.parameters import EVENTS, KINDS
from tests.interop.graphs import LOCAL, free_domain
from tests.verification.joint import RULES, Joint, made_joint, ros_side
from tests.verification.plc_cell import store

pytestmark = pytest.mark.verifies("ros-blocks", own="translated Structured Text")

DOMAIN = 57
CONFIG = f"""bridge: params
ros: {{backend: memory, domain: {DOMAIN}}}
shm: {{directory: FOLDER}}
diagnostics: {{enabled: false}}
parameters:
  declare:
    max_speed: {{type: double, value: 0.5, range: [0, 2], description: metres per second}}
    count: {{type: integer, value: 3}}
    serial: {{type: string, value: A-1, read_only: true}}
    arm.on: {{type: bool}}
    arm.label: {{type: string, value: "x'y$", length: 10}}
    arm.raw: {{type: byte_array, value: [1, 255], capacity: 3}}
    arm.flags: {{type: bool_array, value: [true], capacity: 3}}
    arm.ints: {{type: integer_array, value: [-9000000000], capacity: 3}}
    arm.gains: {{type: double_array, value: [1, 2.5], capacity: 3}}
    arm.names: {{type: string_array, value: [a, b], capacity: 3, length: 4}}
"""
FROM_PLC = CONFIG.replace("parameters:\n", "parameters:\n  initial: plc\n")
INITIAL = {
    "max_speed": 0.5, "count": 3, "serial": "A-1", "arm.on": False, "arm.label": "x'y$",
    "arm.raw": b"\x01\xff", "arm.flags": [True], "arm.ints": [-9_000_000_000], "arm.gains": [1.0, 2.5],
    "arm.names": ["a", "b"],
}  # fmt: skip
NEW = {
    "max_speed": 2.0, "count": -4, "arm.on": True, "arm.label": "grün", "arm.raw": b"",
    "arm.flags": [False] * 3, "arm.ints": [1, 2], "arm.gains": [], "arm.names": ["c", "", "efgh"],
}  # fmt: skip
KIND = dict(
    zip(
        INITIAL,
        ("double", "integer", "string", "bool", "string", "byte_array", "bool_array", "integer_array",
         "double_array", "string_array"),
        strict=True,
    )
)  # fmt: skip
CLOCK = "rosgraph_msgs/msg/Clock"
EVENT = "rcl_interfaces/msg/ParameterEvent"


class Asker:
    """A node that asks for parameters while the PLC runs."""

    def __init__(self, joint: Joint) -> None:
        self.joint = joint
        self.events: list[dict[str, Any]] = []
        self.clients: dict[str, Any] = {}
        take = lambda data, _: self.events.append(fields.unpack(store(), EVENT, data))  # noqa: E731
        joint.peer.subscribe(EVENTS, EVENT, Qos(depth=1000), take)

    def use_sim_time(self, sim: bool, *, atomically: bool = True, **more: Any) -> list[tuple[bool, str]]:
        asked = [{"name": "use_sim_time", "value": {"type": 1, "bool_value": sim}}, *wishes(more)]
        if atomically:
            results = [self.ask("SetParametersAtomically", parameters=asked)["result"]]
        else:
            results = self.ask("SetParameters", parameters=asked)["results"]
        return [(each["successful"], each["reason"]) for each in results]

    def begin(self, service: str, **request: Any) -> list[dict[str, Any]]:
        kind, answers = f"rcl_interfaces/srv/{service}", []
        name = "".join(f"_{char.lower()}" if char.isupper() else char for char in service)[1:]
        if service not in self.clients:
            self.clients[service] = self.joint.peer.client(f"/rosplc_params/{name}", kind, Qos())
        client = self.clients[service]
        self.joint.until(lambda: client.ready, "the service")
        client.call(
            fields.pack(store(), f"{kind}_Request", request),
            lambda reply: answers.append(fields.unpack(store(), f"{kind}_Response", reply.payload or b"")),
        )
        return answers

    def ask(self, service: str, **request: Any) -> dict[str, Any]:
        answers = self.begin(service, **request)
        self.joint.until(lambda: answers, f"the answer of {service}")
        return answers[0]

    def values(self) -> dict[str, Any]:
        found = self.ask("GetParameters", names=list(INITIAL))["values"]
        return {name: each[f"{KIND[name]}_value"] for name, each in zip(INITIAL, found, strict=True)}

    def set(self, values: dict[str, Any]) -> tuple[bool, str]:
        result = self.ask("SetParametersAtomically", parameters=wishes(values))["result"]
        return result["successful"], result["reason"]

    def changed(self) -> set[str]:
        return {each["name"] for event in self.events for each in event["changed_parameters"]}


def wishes(values: dict[str, Any]) -> list[dict[str, Any]]:
    return [
        {"name": name, "value": {"type": KINDS.index(KIND[name]) + 1, f"{KIND[name]}_value": value}}
        for name, value in values.items()
    ]


def held(joint: Joint) -> dict[str, Any]:
    """Return some of what the PLC's program sees."""
    value = lambda name: joint.machine.get(f"ROS_Parameters.values.{name}")  # noqa: E731
    return {
        "max_speed": value("max_speed"), "count": value("count"), "arm.on": value("arm_on"),
        "arm.gains": [value(f"arm_gains[{index}]") for index in range(value("arm_gains_count"))],
    }  # fmt: skip


def some(values: dict[str, Any]) -> dict[str, Any]:
    return {name: values[name] for name in ("max_speed", "count", "arm.on", "arm.gains")}


@pytest.fixture(params=RULES)
def joint(request: pytest.FixtureRequest) -> Iterator[Joint]:
    with made_joint(CONFIG, "ROS_Parameters", DOMAIN, rule=request.param) as made:
        yield made


def runs(joint: Joint) -> bool:
    return bool(joint.get("block", "xValid"))


def test_every_kind_is_set_at_once(joint: Joint) -> None:
    """A new object has the file's values; a set reaches the program in one scan."""
    asker = Asker(joint)
    assert asker.values() == INITIAL
    joint.until(lambda: runs(joint), "the PLC")
    assert held(joint) == some(INITIAL)
    answers = asker.begin("SetParametersAtomically", parameters=wishes(NEW))
    joint.until(lambda: joint.get("block", "xNew"), "the set")
    assert held(joint) == some(NEW)
    joint.until(lambda: answers, "the answer")
    assert answers[0]["result"] == {"successful": True, "reason": ""}
    assert asker.values() == INITIAL | NEW
    joint.until(lambda: asker.changed() == set(NEW), "the events")
    results = asker.ask("SetParameters", parameters=wishes({"count": 7, "serial": "B", "max_speed": 9.0}))
    assert [each["successful"] for each in results["results"]] == [True, False, False]
    assert asker.values() == {**INITIAL, **NEW, "count": 7}
    assert joint.get("block", "udiSets") == 3  # the file's, and two


def test_a_program_changes_a_value(joint: Joint) -> None:
    """ROS sees it, a read-only one too; a PLC that restarts has it again, and so has the next bridge."""
    asker = Asker(joint)
    joint.until(lambda: runs(joint), "the PLC")
    joint.machine.set("ROS_Parameters.values.serial", "C-3")
    joint.machine.set("ROS_Parameters.values.count", 11)
    joint.until(lambda: asker.changed() == {"serial", "count"}, "the event")
    assert asker.values() == {**INITIAL, "serial": "C-3", "count": 11}
    joint.restart_plc()
    assert held(joint)["count"] == 3
    joint.until(lambda: held(joint)["count"] == 11, "the values from before")
    joint.stop_bridge()
    joint.start_bridge()
    assert asker.values() == {**INITIAL, "serial": "C-3", "count": 11}
    joint.until(lambda: asker.set({"count": 12})[0], "a set by the next bridge")
    assert held(joint)["count"] == 12


def test_nobody_takes_a_set(joint: Joint) -> None:
    """It is refused; a PLC that runs again takes nothing that was refused."""
    asker = Asker(joint)
    joint.until(lambda: runs(joint), "the PLC")
    joint.machine.stop()
    joint.scan = lambda *_, **__: None  # type: ignore[method-assign]
    joint.until(lambda: asker.set({"count": 5}) == (False, "PLC is not running"), "the refusal")
    assert asker.values() == INITIAL
    del joint.scan  # type: ignore[attr-defined]
    joint.machine.start()
    joint.until(lambda: asker.set({"max_speed": 1.0})[0], "the PLC again")
    assert held(joint) == some({**INITIAL, "max_speed": 1.0})


def test_values_of_the_plc() -> None:
    """``initial: plc``: what the program starts with holds, again after each restart of it."""
    with made_joint(FROM_PLC, "ROS_Parameters", DOMAIN) as joint:
        joint.machine.set("ROS_Parameters.values.count", 42)
        asker = Asker(joint)
        joint.until(lambda: asker.values()["count"] == 42, "the PLC's value")
        joint.until(lambda: asker.set({"count": 43})[0], "a set")
        joint.restart_plc()
        joint.until(lambda: asker.values()["count"] == 3, "the PLC's value after its start")
        assert held(joint)["count"] == 3
        assert not asker.set({"count": 43, "max_speed": 3.0})[0]
        joint.until(lambda: asker.set({"count": 44})[0], "another set")
        assert held(joint)["count"] == 44


def test_a_bridge_killed_before_the_plc_takes(joint: Joint) -> None:
    """What it had given to the PLC is taken, once and whole; the next bridge shows it."""
    asker = Asker(joint)
    joint.until(lambda: runs(joint), "the PLC")
    scan: Callable[..., None] = joint.scan
    joint.until(lambda: asker.set({"count": 4})[0], "a set that shows that the PLC is seen to live")
    answers = asker.begin("SetParametersAtomically", parameters=wishes({"count": 5, "max_speed": 1.5}))
    joint.scan = lambda *_, **__: None  # type: ignore[method-assign]
    assert isinstance(joint.bridge, object)
    given = joint.bridge._own.parameters  # type: ignore[union-attr]
    joint.until(lambda: given._sets and given._sets[0].number, "the set in the object")
    joint.stop_bridge()
    assert not answers
    scan(count=20)
    assert held(joint) == some({**INITIAL, "count": 5, "max_speed": 1.5})
    joint.start_bridge()
    del joint.scan  # type: ignore[attr-defined]
    joint.until(lambda: asker.values()["count"] == 5, "the values of the set")
    assert asker.values()["max_speed"] == 1.5


@pytest.mark.parametrize("backend", ["memory", "dds", "zenoh"])
def test_use_sim_time(backend: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """As on every node it is listed and set while the bridge runs; the PLC's block of ROS time follows."""
    pytest.importorskip({"memory": "rosplc", "dds": "cyclonedds", "zenoh": "zenoh"}[backend])
    for name, value in LOCAL.items():
        monkeypatch.setenv(name, value)
    with free_domain() as domain, ros_side(backend, domain) as (side, options):
        config = CONFIG.replace(f"backend: memory, domain: {DOMAIN}", side) + "time: {plc: true}\n"
        with made_joint(config, "ROS_Parameters", domain, backend, options=options) as joint:
            joint.until(lambda: runs(joint), "bridge and PLC")
            clock = joint.peer.advertise("/clock", CLOCK, Qos(depth=1))
            asker = Asker(joint)

            def sim() -> bool:
                clock.write(fields.pack(store(), CLOCK, {"clock": {"sec": 7, "nanosec": 5}}))
                seen = joint.machine.get("ROS_Read.ros_time.xSim")
                return bool(seen) and joint.machine.get("ROS_Read.ros_time.uliNow") == 7_000_000_005

            assert asker.ask("ListParameters", prefixes=[], depth=0)["result"]["names"][0] == "use_sim_time"
            assert asker.ask("GetParameters", names=["use_sim_time"])["values"][0]["bool_value"] is False
            joint.until(lambda: not sim() and joint.machine.get("ROS_Read.ros_time.xKnown"), "system time")
            assert asker.use_sim_time(True) == [(True, "")]
            joint.until(sim, "the time of /clock")
            assert asker.ask("GetParameters", names=["use_sim_time"])["values"][0]["bool_value"] is True
            joint.until(lambda: asker.changed() == {"use_sim_time"}, "the event")
            assert asker.use_sim_time(False, count=4) == [(True, "")]
            assert held(joint)["count"] == 4
            joint.until(lambda: not joint.machine.get("ROS_Read.ros_time.xSim"), "the system's time")
            joint.until(lambda: clock.matched == 0, "the end of the subscription")

            joint.machine.stop()
            joint.scan = lambda *_, **__: None  # type: ignore[method-assign]
            refused = (False, "PLC is not running")
            joint.until(lambda: asker.use_sim_time(True, count=5) == [refused], "the refusal")
            assert asker.ask("GetParameters", names=["use_sim_time"])["values"][0]["bool_value"] is False
            assert asker.use_sim_time(True, atomically=False, count=5) == [(True, ""), refused]
            joint.until(lambda: clock.matched == 1, "the subscription")
