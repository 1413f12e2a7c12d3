"""Parameters of the PLC (executed Structured Text), as rclpy's AsyncParameterClient sees and sets them."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

from tests.interop.graphs import LOCAL
from tests.lib.waiting import repeat_until
from tests.verification.joint import Joint, made_joint

pytestmark = [pytest.mark.ros2, pytest.mark.timeout(300), pytest.mark.verifies("parameters", real="rclpy")]

CONFIG = """bridge: params
ros: {backend: rclpy, distro: kilted, domain: DOMAIN}
shm: {directory: FOLDER}
diagnostics: {enabled: false}
time: {plc: true}
parameters:
  declare:
    max_speed: {type: double, value: 0.5, range: [0, 2], description: metres per second}
    count: {type: integer, value: 3}
    serial: {type: string, value: A-1, read_only: true}
    arm.on: {type: bool}
    arm.raw: {type: byte_array, value: [1, 255]}
    arm.flags: {type: bool_array, value: [true]}
    arm.ints: {type: integer_array, value: [-9000000000]}
    arm.gains: {type: double_array, value: [1, 2.5], capacity: 3}
    arm.names: {type: string_array, value: [a, b]}
"""
NAMES = [
    "max_speed",
    "count",
    "serial",
    *(f"arm.{n}" for n in ("on", "raw", "flags", "ints", "gains", "names")),
]


class Client:
    """rclpy's client of the bridge's parameters; while it waits, the PLC runs."""

    def __init__(self, joint: Joint, domain: int) -> None:
        import rclpy
        from rcl_interfaces.msg import ParameterEvent
        from rclpy.executors import SingleThreadedExecutor
        from rclpy.parameter_client import AsyncParameterClient

        self.joint = joint
        self.context = rclpy.Context()
        self.context.init(domain_id=domain)
        self.node = rclpy.create_node("asker", context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.events: list[Any] = []
        self.node.create_subscription(ParameterEvent, "/parameter_events", self._event, 1000)
        self.client = AsyncParameterClient(self.node, "/rosplc_params")
        joint.until(self.client.services_are_ready, "the services")

    def _event(self, event: Any) -> None:
        if event.node == "/rosplc_params":
            self.events.append(event)

    def turn(self) -> None:
        """Take what has come; the PLC runs."""
        self.executor.spin_once(timeout_sec=0)
        self.joint.scan()

    def until(self, condition: Any, what: str) -> None:
        self.joint.until(lambda: self.turn() or condition(), what)

    def ask(self, method: str, *arguments: Any, **options: Any) -> Any:
        future = getattr(self.client, method)(*arguments, **options)
        self.until(future.done, f"the answer of {method}")
        return future.result()

    def values(self) -> list[Any]:
        from rclpy.parameter import parameter_value_to_python

        return [parameter_value_to_python(each) for each in self.ask("get_parameters", NAMES).values]

    def set(self, method: str, **values: Any) -> list[tuple[bool, str]]:
        from rclpy.parameter import Parameter

        asked = [Parameter(name.replace("__", "."), value=value) for name, value in values.items()]
        response = self.ask(method, asked)
        results = response.results if method == "set_parameters" else [response.result]
        return [(each.successful, each.reason) for each in results]

    def close(self) -> None:
        self.executor.shutdown()
        self.node.destroy_node()
        self.context.try_shutdown()


@pytest.fixture
def client(domain: int, monkeypatch: pytest.MonkeyPatch) -> Iterator[Client]:
    for name, value in LOCAL.items():
        monkeypatch.setenv(name, value)
    with made_joint(CONFIG.replace("DOMAIN", str(domain)), "ROS_Parameters", domain, "rclpy") as joint:
        made = Client(joint, domain)
        yield made
        made.close()


OWN = ["use_sim_time", "version", "bridge", "topics", "config"]


def held(client: Client, name: str) -> Any:
    return client.joint.machine.get(f"ROS_Parameters.values.{name}")


def test_what_rclpy_does_with_parameters(client: Client, tmp_path: Path) -> None:
    """List, describe, get, set, set atomically and load; the program has what was set, or nothing of it."""
    listed = client.ask("list_parameters", [], 10).result
    assert list(listed.names) == [*OWN, *NAMES]
    assert list(listed.prefixes) == ["arm"]
    described = client.ask("describe_parameters", ["max_speed", "serial"]).descriptors
    assert (described[0].description, described[0].floating_point_range[0].to_value) == (
        "metres per second",
        2.0,
    )
    assert described[1].read_only
    assert list(client.ask("get_parameter_types", NAMES).types) == [3, 2, 4, 1, 5, 6, 7, 8, 9]
    first = client.values()
    assert first[:4] == [0.5, 3, "A-1", False]
    assert [list(each) for each in first[4:]] == [
        [b"\1", b"\xff"],
        [True],
        [-9_000_000_000],
        [1.0, 2.5],
        ["a", "b"],
    ]

    client.joint.until(lambda: client.joint.get("block", "xValid"), "the PLC")
    assert client.set("set_parameters", count=7, serial="B", max_speed=9.0) == [
        (True, ""), (False, "serial is read-only"), (False, "max_speed must be within 0.0 … 2.0"),
    ]  # fmt: skip
    assert (held(client, "count"), held(client, "max_speed")) == (7, 0.5)
    assert not client.set("set_parameters_atomically", count=8, nothing=1)[0][0]
    assert held(client, "count") == 7
    assert client.set("set_parameters_atomically", count=8, arm__on=True, arm__gains=[3.0]) == [(True, "")]
    assert (held(client, "count"), held(client, "arm_on"), held(client, "arm_gains[0]")) == (8, True, 3.0)

    path = tmp_path / "written.yaml"
    path.write_text(
        yaml.safe_dump({"/rosplc_params": {"ros__parameters": {"count": 9, "arm": {"on": False}}}})
    )
    results = client.ask("load_parameter_file", str(path)).results
    assert [each.successful for each in results] == [True, True]
    assert (held(client, "count"), held(client, "arm_on")) == (9, False)
    changed = lambda: [p.name for event in client.events for p in event.changed_parameters]  # noqa: E731
    client.until(lambda: changed()[-2:] == ["count", "arm.on"], "the events")

    client.joint.machine.set("ROS_Parameters.values.serial", "C-3")
    client.until(lambda: client.values()[2] == "C-3", "what the program has changed")


def test_dump_and_load(client: Client, tmp_path: Path) -> None:
    """A file of all values, as `ros2 param dump` writes it, brings them back; what is only shown is not."""
    from rclpy.parameter import parameter_value_to_python

    client.joint.until(lambda: client.joint.get("block", "xValid"), "the PLC")
    first, names = client.values(), client.ask("list_parameters", [], 0).result.names
    tree: dict[str, Any] = {}
    for name, value in zip(names, client.ask("get_parameters", names).values, strict=True):
        group, _, last = name.rpartition(".")
        plain = parameter_value_to_python(value)
        is_array = not isinstance(plain, bool | int | float | str)
        if name != "arm.raw":  # bytes have no form in such a file, and rclpy refuses them
            (tree.setdefault(group, {}) if group else tree)[last] = list(plain) if is_array else plain
    path = tmp_path / "dumped.yaml"
    path.write_text(yaml.safe_dump({"/rosplc_params": {"ros__parameters": tree}}))
    changed = client.set("set_parameters", count=7, max_speed=1.0, arm__names=["z"], arm__flags=[False, True])
    assert changed == [(True, "")] * 4
    reasons = [each.reason for each in client.ask("load_parameter_file", str(path)).results]
    assert sorted(filter(None, reasons)) == sorted(f"{name} is read-only" for name in (*OWN[1:], "serial"))
    assert [str(each) for each in client.values()] == [str(each) for each in first]


def test_lists_as_rclpy_answers(client: Client) -> None:
    """Prefixes and depth, all together: what a node of rclpy with the same parameters lists."""
    import rclpy
    from rclpy.parameter_client import AsyncParameterClient

    node = rclpy.create_node("same", context=client.context)
    client.executor.add_node(node)
    for name in (*OWN[1:], *NAMES):
        node.declare_parameter(name, "")
    of_rclpy = AsyncParameterClient(client.node, "/same")
    client.until(of_rclpy.services_are_ready, "its services")
    ours, more = client.client, "start_type_description_service"
    for prefixes in ([], ["arm"], ["arm."], ["ar"], ["count", "arm.on"], ["arm", "count"], ["none"], [""]):
        for depth in (0, 1, 2, 10):
            found = []
            for client.client in (ours, of_rclpy):
                result = client.ask("list_parameters", prefixes, depth).result
                found.append(([name for name in result.names if name != more], list(result.prefixes)))
            assert found[0] == found[1], (prefixes, depth)
    client.client = ours
    node.destroy_node()


def test_use_sim_time(client: Client) -> None:
    """A client of rclpy sets it, and the PLC's time is that of /clock."""
    from rosgraph_msgs.msg import Clock

    seen = lambda name: client.joint.machine.get(f"ROS_Read.ros_time.{name}")  # noqa: E731
    client.until(lambda: seen("xKnown"), "the system's time")
    assert not seen("xSim")
    assert client.set("set_parameters", use_sim_time=True) == [(True, "")]
    clock, message = client.node.create_publisher(Clock, "/clock", 1), Clock()
    message.clock.sec = 7
    client.until(
        lambda: clock.publish(message) or (seen("xSim") and seen("uliNow") == 7 * 10**9), "the time of /clock"
    )
    assert client.set("set_parameters_atomically", use_sim_time=False, count=8) == [(True, "")]
    client.until(lambda: not seen("xSim") and held(client, "count") == 8, "the system's time again")


def test_a_killed_bridge_and_a_plc_that_stands(client: Client) -> None:
    """Values outlive the bridge; a set is refused while no PLC takes it."""
    client.joint.until(lambda: client.joint.get("block", "xValid"), "the PLC")
    assert client.set("set_parameters", count=7) == [(True, "")]
    client.joint.kill_bridge()
    client.joint.start_bridge()
    # What is asked of the killed one, which discovery still shows, is lost.
    asked: list[Any] = []
    repeat_until(
        lambda: asked.append(client.client.get_parameters(["count"])),
        lambda: client.turn() or any(each.done() for each in asked),
        "an answer of the next bridge",
    )
    client.until(lambda: client.values()[1] == 7, "the value from before")
    client.joint.scan = lambda *_, **__: None  # type: ignore[method-assign]
    client.until(
        lambda: client.set("set_parameters", count=8) == [(False, "PLC is not running")], "the refusal"
    )
    assert client.values()[1] == 7
