"""DDS through the cyclonedds wheel."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from typing import ClassVar

from rosplc.ros import Qos
from tests.conformance.backends.base import Abilities, Harness
from tests.conformance.backends.node import Calling, Node, Outbox
from tests.conformance.backends.rtps import Impostor
from tests.interop.graphs import LOCAL, free_domain
from tests.lib.waiting import wait_for


class DdsNode(Node):
    """A node that tells its writers' ids."""

    def client(self, service: str, type_name: str) -> Calling:
        """Call a service."""
        calling = super().client(service, type_name)
        self._guid = calling.client.guid  # type: ignore[attr-defined]
        return calling

    def advertise(self, topic: str, type_name: str, qos: Qos | None = None) -> Outbox:
        """Send a topic."""
        outbox = super().advertise(topic, type_name, qos)
        self._guid = outbox.publisher.guid  # type: ignore[attr-defined]
        return outbox

    def guid(self) -> bytes:
        """Return the id of the last writer."""
        guid: bytes = self._guid
        return guid


class DdsHarness(Harness):
    """A DDS domain on the loopback interface."""

    backend = "dds"
    title = "dds"
    node_class = DdsNode
    abilities: ClassVar[Abilities] = Abilities(
        source_stamps=True,
        matches_qos=True,
        latched_depth=True,
        latched_by_publisher=False,
        tells_definitions=True,
        checks_outgoing=True,
        checks_incoming=True,
        counts_losses=False,
        drops_on_full_links=False,
        shows_qos=True,
        shows_hashes=True,
        many_nodes=True,
        sees_callers=True,
        refuses_with_words=False,
        remembers_callers=True,
        has_hub=False,
    )

    @classmethod
    def missing(cls) -> str | None:
        """Return what is not installed."""
        return None if importlib.util.find_spec("cyclonedds") else "no wheel of cyclonedds for this machine"

    def start(self) -> None:
        """Take a domain."""
        self.domain = self.stack.enter_context(free_domain())
        self.environment = dict(LOCAL)

    def rogue(self, topic: str, type_name: str) -> Callable[[bytes], object]:
        """Send in the name of another process's writer; what is written through a library fits the type."""
        assert self.domain is not None
        before = self._matched(topic)
        node = self.process("rogue")
        outbox = node.advertise(topic, type_name)
        wait_for(outbox.matched)
        wait_for(lambda: self._matched(topic) > before)
        return Impostor(self.domain, node.call(0, "guid")).send

    def bother(self, service: str, type_name: str) -> int:
        """Send in the name of another process's client: too short, too long, of another encapsulation."""
        assert self.domain is not None
        node = self.process("rogue")
        client = node.client(service, type_name)
        wait_for(client.ready)
        send = Impostor(self.domain, node.call(0, "guid")).send
        header = b"\0\1\0\0" + bytes(16)
        hostile = (header[:12], header, header + b"\xff\xff\xff\xff", header + b"\5\0\0\0ab")
        for payload in (*hostile, b"abcdefgh", b"\0\7\0\0" + bytes(20)):
            send(payload)
        return len(hostile)

    def _matched(self, topic: str) -> int:
        """Return how many publishers the subscriptions of a topic have matched."""
        statuses = (status for node in self._nodes for status in node.status())
        return sum(status.matched for status in statuses if (status.topic, status.direction) == (topic, "in"))
