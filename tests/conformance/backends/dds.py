"""DDS through the cyclonedds wheel."""

from __future__ import annotations

import importlib.util
from typing import ClassVar

from tests.conformance.backends.base import Abilities, Harness
from tests.interop.graphs import LOCAL, free_domain


class DdsHarness(Harness):
    """A DDS domain on the loopback interface."""

    backend = "dds"
    title = "dds"
    abilities: ClassVar[Abilities] = Abilities(
        source_stamps=True,
        matches_qos=True,
        latched_depth=True,
        latched_by_publisher=False,
        tells_definitions=True,
        checks_outgoing=True,
        checks_incoming=True,
        counts_losses=False,
        shows_qos=True,
        shows_hashes=True,
        many_nodes=True,
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
