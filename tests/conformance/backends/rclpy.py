"""rclpy: the installed one, or else the double of tests/doubles."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from dataclasses import replace
from typing import Any, ClassVar

from rosplc.model import TypeStore
from rosplc.ros import Qos
from tests.conformance.backends.base import Abilities, AnyNode, Harness
from tests.conformance.backends.node import Calling, Inbox, Node, Opening, Outbox, Served
from tests.doubles.ros2 import double, installed
from tests.interop.graphs import free_domain

_DOUBLE = importlib.util.find_spec("rclpy") is None


class RclpyNode(Node):
    """A node on a machine of its own: with the double, each may have its own message packages."""

    def __init__(self, opening: Opening) -> None:
        super().__init__(opening)
        self._store = TypeStore.bundled(opening.distro)
        for name, text in opening.definitions.items():
            self._store = self._store.with_definition(name, text)

    def subscribe(
        self, topic: str, type_name: str, qos: Qos | None = None, receiver: str = "collect"
    ) -> Inbox:
        """Receive a topic."""
        with installed(self._store):
            return super().subscribe(topic, type_name, qos, receiver)

    def serve(self, service: str, type_name: str, receiver: str = "echo") -> Served:
        """Serve a service."""
        with installed(self._store):
            return super().serve(service, type_name, receiver)

    def client(self, service: str, type_name: str) -> Calling:
        """Call a service."""
        with installed(self._store):
            return super().client(service, type_name)

    def advertise(self, topic: str, type_name: str, qos: Qos | None = None) -> Outbox:
        """Send a topic."""
        with installed(self._store):
            return super().advertise(topic, type_name, qos)


class RclpyHarness(Harness):
    """A domain of the double, or of the installed rclpy."""

    backend = "rclpy"
    title = "rclpy-double" if _DOUBLE else "rclpy"
    real = not _DOUBLE
    reaches_out = not _DOUBLE
    node_class = RclpyNode if _DOUBLE else Node
    imitates: ClassVar[str] = "jazzy"
    abilities: ClassVar[Abilities] = Abilities(
        source_stamps=False,  # stamps are carried, but rclpy lets nobody choose one
        matches_qos=True,
        latched_depth=True,
        latched_by_publisher=False,
        tells_definitions=True,
        checks_outgoing=False,
        checks_incoming=False,
        counts_losses=False,
        drops_on_full_links=False,
        shows_qos=True,
        shows_hashes=True,
        many_nodes=True,
        sees_callers=False,
        refuses_with_words=False,
        remembers_callers=False,
        has_hub=False,
    )

    def start(self) -> None:
        """Take a domain, and install the double where rclpy is missing."""
        self.domain = self.stack.enter_context(free_domain())
        if _DOUBLE:
            self.stack.enter_context(double(self.imitates))

    def node(self, name: str, **different: Any) -> AnyNode:
        """Join with a node."""
        return super().node(name, **different)

    def rogue(self, topic: str, type_name: str) -> Callable[[bytes], object] | None:
        """Publish on the middleware, past the backend's checks."""
        from rclpy.context import Context
        from rclpy.node import Node as NativeNode
        from rclpy.qos import QoSProfile

        from rosplc.ros.rclpy.endpoint import message_class

        context = Context()
        context.init(args=[], domain_id=self.domain)
        self.stack.callback(context.try_shutdown)
        node = NativeNode("rogue", context=context)
        self.stack.callback(node.destroy_node)
        publisher = node.create_publisher(message_class(type_name), topic, QoSProfile(depth=10))
        return publisher.publish


class RclpyHumbleHarness(RclpyHarness):
    """The double as it is on ROS 2 Humble: no type hashes, no stamps, no counts of publishers."""

    title = "rclpy-double-humble"
    real = False
    repeats = True
    distros = ("humble",)
    imitates = "humble"
    abilities = replace(RclpyHarness.abilities, tells_definitions=False, shows_hashes=False)

    @classmethod
    def missing(cls) -> str | None:
        """Return why there is nothing to test."""
        return None if _DOUBLE else "the installed rclpy is tested instead of its double"
