"""The ROS package's lifecycle node over real rclpy, driven through its services."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

import rosplc
from rosplc.model import TypeStore
from rosplc.ros import Backend, Qos, open_backend
from rosplc.shm import Namespace
from tests.interop.graphs import LOCAL
from tests.lib.waiting import repeat_until, wait_for

pytestmark = [pytest.mark.ros2, pytest.mark.timeout(300), pytest.mark.verifies("lifecycle", real="rclpy")]

PACKAGE = Path(__file__).parents[3] / "packaging" / "ros2" / "rosplc_bridge"
INT32 = "std_msgs/msg/Int32"
RUN = """
import rclpy
from rosplc_bridge.lifecycle_node import BridgeNode
rclpy.init()
rclpy.spin(BridgeNode("cell"))
"""


def int32(number: int) -> bytes:
    return b"\0\1\0\0" + number.to_bytes(4, "little")


class Manager:
    """What ``ros2 lifecycle`` does: calls of the node's services."""

    def __init__(self, domain: int) -> None:
        import rclpy
        from lifecycle_msgs.srv import ChangeState, GetState
        from rclpy.context import Context
        from rclpy.executors import SingleThreadedExecutor

        self._context: Any = Context()
        self._context.init(domain_id=domain)
        self._node: Any = rclpy.create_node("manager", context=self._context)
        self._executor: Any = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._kinds = {"change_state": ChangeState, "get_state": GetState}
        self._clients = {
            name: self._node.create_client(kind, f"/cell/{name}") for name, kind in self._kinds.items()
        }

    def call(self, service: str, **fields: Any) -> Any:
        """Call a service of the node; return the answer."""
        assert self._clients[service].wait_for_service(60.0)
        future = self._clients[service].call_async(self._kinds[service].Request(**fields))
        self._executor.spin_until_future_complete(future, 60.0)
        return future.result()

    def change(self, transition: str) -> str:
        """Trigger a transition; return the state that the node is in then."""
        from lifecycle_msgs.msg import Transition

        number = getattr(Transition, f"TRANSITION_{transition.upper()}")
        self.call("change_state", transition=Transition(id=number))
        return str(self.call("get_state").current_state.label)

    def close(self) -> None:
        """Leave the graph."""
        self._executor.shutdown()
        self._node.destroy_node()
        self._context.try_shutdown()


@pytest.fixture
def manager(domain: int, tmp_path: Path, shm_namespace: Namespace) -> Iterator[Manager]:
    config = tmp_path / "rosplc.yaml"
    config.write_text(
        f"bridge: cell1\nprefix: {shm_namespace.prefix}\nros: {{backend: rclpy, distro: kilted}}\n"
        f"topics:\n  /down: {{type: {INT32}, to: plc}}\n  /up: {{type: {INT32}, to: ros}}\n"
    )
    environment = {**os.environ, **LOCAL, "ROS_DOMAIN_ID": str(domain), "PYTHONPATH": str(PACKAGE)}
    command = [sys.executable, "-c", RUN, "--ros-args", "-p", f"config:={config}"]
    process = subprocess.Popen(command, env=environment)
    manager = Manager(domain)
    yield manager
    manager.close()
    process.terminate()
    process.wait()


@pytest.fixture
def other(domain: int) -> Iterator[Backend]:
    backend = open_backend("dds", TypeStore.bundled("kilted"), "other", domain=domain, environment=LOCAL)
    yield backend
    backend.close()


def test_services_configure_and_activate(manager: Manager, other: Backend, shm_namespace: Namespace) -> None:
    """Configured the PLC can attach, active messages pass both ways, inactive the topics are gone."""
    got: list[bytes] = []
    source = other.advertise("/down", INT32, Qos())
    sink = other.subscribe("/up", INT32, Qos(), lambda payload, _: got.append(payload))
    assert manager.change("configure") == "inactive"
    prefix = shm_namespace.prefix
    with rosplc.attach("/down", prefix=prefix) as down, rosplc.attach("/up", prefix=prefix, write=True) as up:
        assert source.matched == sink.matched == 0
        for life in (1, 2):
            assert manager.change("activate") == "active"
            wait_for(lambda: source.matched and sink.matched, "the bridge's topics")
            source.write(int32(life))
            message = down.wait(timeout=60)
            assert message is not None
            assert message.data == life
            # What is sent in the moment of the match may be lost.
            repeat_until(
                lambda n=life: up.write({"data": n}), lambda n=life: int32(n) in got, "a message", every=0.5
            )
            assert manager.change("deactivate") == "inactive"
            wait_for(lambda: source.matched == sink.matched == 0, "the end of the bridge's topics")
    assert manager.change("cleanup") == "unconfigured"
    assert manager.change("unconfigured_shutdown") == "finalized"
