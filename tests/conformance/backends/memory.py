"""The backend inside one process, which has no middleware."""

from __future__ import annotations

from collections.abc import Callable
from typing import ClassVar

from tests.conformance.backends.base import Abilities, Harness
from tests.interop.graphs import free_domain


class MemoryHarness(Harness):
    """A domain of the memory backend."""

    backend = "memory"
    title = "memory"
    reaches_out = False
    abilities: ClassVar[Abilities] = Abilities(
        source_stamps=True,
        matches_qos=True,
        latched_depth=True,
        latched_by_publisher=False,
        tells_definitions=True,
        checks_outgoing=False,
        checks_incoming=False,
        counts_losses=True,
        drops_on_full_links=False,
        shows_qos=True,
        shows_hashes=True,
        many_nodes=True,
        sees_callers=True,
        refuses_with_words=False,
        remembers_callers=False,
        has_hub=False,
    )

    def start(self) -> None:
        """Take a domain; it need not be free of DDS, but this way each test has its own."""
        self.domain = self.stack.enter_context(free_domain())

    def rogue(self, topic: str, type_name: str) -> Callable[[bytes], object] | None:
        """Put bytes into the subscribers' queues."""
        from rosplc.ros.memory import _domains

        def send(payload: bytes) -> None:
            for backend in _domains[self.domain or 0]:
                for endpoint in backend.endpoints():
                    if endpoint.topic == topic and endpoint.direction == "in":
                        endpoint.put(payload, 0)

        return send
