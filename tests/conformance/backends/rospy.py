"""ROS 1 through Debian's rospy, with a master of each test's own."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import ClassVar

from tests.conformance.backends.base import Abilities, Harness, Peer
from tests.interop.ros1.graph import PACKAGES, lend
from tests.lib.waiting import wait_for


class RospyHarness(Harness):
    """A master on the loopback interface."""

    backend = "rospy"
    title = "rospy"
    packages = PACKAGES
    distros = ("noetic",)
    abilities: ClassVar[Abilities] = Abilities(
        source_stamps=False,
        matches_qos=False,
        latched_depth=False,
        latched_by_publisher=True,
        tells_definitions=True,
        checks_outgoing=False,
        checks_incoming=False,
        counts_losses=True,
        drops_on_full_links=False,
        shows_qos=False,
        shows_hashes=False,
        many_nodes=True,
        sees_callers=True,
        refuses_with_words=True,
        remembers_callers=False,
        has_hub=True,
    )

    def start(self) -> None:
        """Take a master that nobody uses."""
        self._graph = self.stack.enter_context(lend())
        self.environment = dict(self._graph.environment)

    def restart_hub(self, silent_s: float = 0.0) -> None:
        """Kill the master and start another one."""
        self._graph.kill_master()
        time.sleep(silent_s)
        self._graph.start_master()

    def foreign_peers(self) -> tuple[str, ...]:
        """Programs of rospy and roscpp."""
        return ("rospy", "roscpp")

    def foreign(self, which: str, name: str) -> Peer:
        """Start one."""
        return self._graph.peer(which, name)

    def rogue(self, topic: str, type_name: str) -> Callable[[bytes], object] | None:
        """Send through another node: nothing looks at the bytes there."""
        node = self.node("rogue")
        outbox = node.advertise(topic, type_name)
        wait_for(outbox.matched)
        return outbox.write
