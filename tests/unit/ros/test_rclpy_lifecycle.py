"""The ROS package's lifecycle node, driven through its states over the double of rclpy."""

from __future__ import annotations

import importlib
import importlib.util
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

import rosplc
from rosplc.model import TypeStore
from rosplc.ros import LATCHED, Backend, Qos, open_backend
from rosplc.shm import Namespace
from tests.doubles.ros2 import double, installed
from tests.lib.waiting import wait_for

PACKAGE = Path(__file__).parents[3] / "packaging" / "ros2" / "rosplc_bridge"
INT32 = "std_msgs/msg/Int32"

pytestmark = [
    pytest.mark.needs(when=importlib.util.find_spec("rclpy") is None, why="the real rclpy is here"),
    pytest.mark.verifies("lifecycle", own="a test double of rclpy"),
]


def int32(number: int) -> bytes:
    return b"\0\1\0\0" + number.to_bytes(4, "little")


class Cell:
    """A lifecycle node of the package, spun in a thread, and another node that talks to it."""

    def __init__(self, config: Path, prefix: str, domain: int) -> None:
        self.prefix = prefix
        self.context = importlib.import_module("rclpy.context").Context()
        self.context.init(args=["--ros-args", "-p", f"config:={config}"], domain_id=domain)
        module = importlib.import_module("rosplc_bridge.lifecycle_node")
        self.node: Any = module.BridgeNode("cell", context=self.context)
        self.executor = importlib.import_module("rclpy.executors").SingleThreadedExecutor(
            context=self.context
        )
        self.executor.add_node(self.node)
        self.thread = threading.Thread(target=self.executor.spin)
        self.thread.start()
        self.other: Backend = open_backend("rclpy", TypeStore.bundled("jazzy"), "other", domain=domain)

    def trigger(self, transition: str) -> str:
        """Trigger a transition on the executor's thread, as the service does; return the state."""
        done = threading.Event()

        def run() -> None:
            try:
                getattr(self.node, f"trigger_{transition}")()
            finally:
                done.set()

        self.executor.create_task(run)
        done.wait()
        return str(self.node.state)

    def topic(self, name: str) -> Any:
        return self.node._bridge.status().topic(name)

    def log(self) -> str:
        lines = importlib.import_module("rclpy.logging").LINES
        return "\n".join(text for _, name, text in lines if name == "cell")

    def close(self) -> None:
        self.other.close()
        self.executor.shutdown()
        self.thread.join()
        self.node.destroy_node()
        self.context.try_shutdown()


@pytest.fixture(params=["jazzy", "humble"])
def cell(
    request: pytest.FixtureRequest, tmp_path: Path, shm_namespace: Namespace, free_domain_number: int
) -> Iterator[Cell]:
    config = tmp_path / "rosplc.yaml"
    config.write_text(
        f"bridge: cell1\nprefix: {shm_namespace.prefix}\nros: {{backend: rclpy, distro: jazzy}}\n"
        f"topics:\n  /down: {{type: {INT32}, to: plc}}\n  /up: {{type: {INT32}, to: ros}}\n"
    )
    with double(request.param, [str(PACKAGE)]):
        cell = Cell(config, shm_namespace.prefix, free_domain_number)
        yield cell
        cell.close()


@pytest.fixture
def free_domain_number() -> int:
    return 7  # the double's graph lives in this process alone


def test_states_open_and_close_what_they_say(cell: Cell) -> None:
    """Configured the PLC can attach, active messages pass both ways, inactive none does."""
    source = cell.other.advertise("/down", INT32, Qos())
    got: list[bytes] = []
    sink = cell.other.subscribe("/up", INT32, Qos(), lambda payload, _: got.append(payload))
    assert cell.trigger("configure") == "inactive"
    with (
        rosplc.attach("/down", prefix=cell.prefix) as down,
        rosplc.attach("/up", prefix=cell.prefix, write=True) as up,
    ):
        assert source.matched == sink.matched == 0
        for life in range(1, 3):
            assert cell.trigger("activate") == "active"
            wait_for(lambda: source.matched and sink.matched)
            source.write(int32(life))
            message = down.wait(timeout=100)
            assert message is not None
            assert message.data == life
            up.write({"data": 10 * life})
            wait_for(lambda n=life: len(got) == n)
            assert got[-1] == int32(10 * life)
            assert cell.trigger("deactivate") == "inactive"
            wait_for(lambda: source.matched == sink.matched == 0)
            source.write(int32(99))
            up.write({"data": 99})
            wait_for(lambda n=life: cell.topic("/up").lost == n)
            assert len(got) == life
    assert cell.trigger("cleanup") == "unconfigured"
    assert cell.trigger("configure") == "inactive"
    assert cell.trigger("shutdown") == "finalized"


def test_a_latched_topic_is_there_for_late_subscribers_after_each_activation(cell: Cell) -> None:
    """The last message, and whether substitutes are being published, come again; received is published."""
    path = Path(cell.node.get_parameter("config").value)
    stale = "stale_after: 10min, on_stale: {value: {data: 1}, period: 10s}"
    path.write_text(path.read_text().replace("to: ros", f"to: ros, latched: true, {stale}"))
    cell.trigger("configure")
    with rosplc.attach("/up", prefix=cell.prefix, write=True) as up:
        for life, value in enumerate((7, 7, 8)):
            if value == 8:
                up.write({"data": value})  # while inactive
                wait_for(lambda: cell.topic("/up").received == 2)
            cell.trigger("activate")
            if not life:
                up.write({"data": value})
                wait_for(lambda: cell.topic("/up").published == 1)
            got: dict[str, list[bytes]] = {"/up": [], "/up/substituted": []}
            sinks = [
                cell.other.subscribe(topic, kind, LATCHED, lambda data, _, to=got[topic]: to.append(data))
                for topic, kind in (("/up", INT32), ("/up/substituted", "std_msgs/msg/Bool"))
            ]
            wait_for(lambda got=got, value=value: int32(value) in got["/up"] and got["/up/substituted"])
            assert got == {"/up": [int32(value)], "/up/substituted": [b"\0\1\0\0\0\0\0\0"]}
            for sink in sinks:
                sink.close()
            cell.trigger("deactivate")
    wait_for(lambda: cell.topic("/up").published == 2)
    assert (cell.topic("/up").received, cell.topic("/up").lost) == (2, 0)


def test_parameters_show_the_bridge(cell: Cell) -> None:
    """Name, file, version, topics and types can be read by anybody, and set by nobody."""
    parameter = importlib.import_module("rclpy.parameter").Parameter
    assert cell.node.get_parameter("version").value == rosplc.__version__
    cell.trigger("configure")
    values = {name: cell.node.get_parameter(name).value for name in ("bridge", "topics", "types")}
    assert values == {"bridge": "cell1", "topics": ["/down", "/up"], "types": [INT32, INT32]}
    for name in (*values, "config", "version"):
        (result,) = cell.node.set_parameters([parameter(name, value="other")])
        assert not result.successful, name
    # Configured again from a changed file, they follow.
    cell.trigger("cleanup")
    path = Path(cell.node.get_parameter("config").value)
    path.write_text(path.read_text().replace("cell1", "cell2"))
    cell.trigger("configure")
    assert cell.node.get_parameter("bridge").value == "cell2"


def test_wrong_configuration_is_a_failure_that_says_why(cell: Cell) -> None:
    """Configuring fails with the file's errors in the node's log, and works once they are mended."""
    path = Path(cell.node.get_parameter("config").value)
    good = path.read_text()
    path.write_text(good.replace("to: plc", "to: pcl"))
    assert cell.trigger("configure") == "unconfigured"
    assert f"{path}:5" in cell.log()
    assert "CFG004" in cell.log()
    path.write_text(good)
    assert cell.trigger("configure") == "inactive"


def test_type_that_is_not_installed_fails_to_configure(cell: Cell) -> None:
    """A missing message package is found when configuring, not when activating."""
    store = TypeStore.bundled("jazzy")
    with installed(store, without=["std_msgs"]):
        assert cell.trigger("configure") == "unconfigured"
    assert "ROS011" in cell.log()
    assert cell.trigger("configure") == "inactive"


def test_defect_leads_back_to_the_beginning(cell: Cell, monkeypatch: pytest.MonkeyPatch) -> None:
    """An exception that is no rosplc error is logged, and everything is let go."""
    managed = importlib.import_module("rosplc.bridge.managed").ManagedBridge
    cell.trigger("configure")

    def broken(_: object) -> None:
        raise KeyError("defect")

    with monkeypatch.context() as patch:
        patch.setattr(managed, "activate", broken)
        assert cell.trigger("activate") == "unconfigured"
    assert "KeyError" in cell.log()
    assert cell.trigger("configure") == "inactive"
    assert cell.trigger("activate") == "active"
