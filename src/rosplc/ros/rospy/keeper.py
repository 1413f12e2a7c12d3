"""The node's standing with the master: registers, watches, and registers again.

rospy registers once and believes that it stays so. A master that was restarted knows nobody; rospy's
nodes then go on talking to whom they know and are invisible to everybody else. Here the master is
asked every second what it knows, and told what it lacks.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from typing import Any

from rosplc.ros.rospy.inbound import Incoming
from rosplc.ros.rospy.master import Master, RefusedError, SystemState, UnreachableError
from rosplc.ros.rospy.outbound import Outgoing

__all__ = ["Keeper"]

_logger = logging.getLogger("rosplc.ros.rospy")

_TICK_S = 0.25
_PERIOD_S = 1.0
_SHARE = 50  # the watch takes at most this part of the time, however large the graph

Endpoint = Incoming | Outgoing
Key = tuple[str, str]
"""Direction (``in`` or ``out``) and topic."""


class Keeper:
    """A thread that keeps the master's knowledge of one node right.

    Args:
        node: The node's full name.
        master: The master's URI.
        uri: The node's own URI.
        wanted: Returns the endpoints as they should be registered.
        moved: Called with the URI of another node that has this node's name.

    Attributes:
        trouble: Why the master cannot be reached, in words; empty if it can.
        state: What the master knew when it was last asked.
        asked: Whether the master has ever answered.
    """

    def __init__(
        self,
        node: str,
        master: str,
        uri: str,
        wanted: Callable[[], dict[Key, Endpoint]],
        moved: Callable[[str], None],
    ) -> None:
        self.trouble = ""
        self.state = SystemState()
        self.asked = False
        self._node = node
        self._master = Master(master, node)
        self._uri = uri
        self._wanted = wanted
        self._moved = moved
        self._registered: dict[Key, Endpoint] = {}
        self._due = 0.0
        self._wake = threading.Event()
        self._closing = False
        self._thread = threading.Thread(target=self._run, name="rosplc-master", daemon=True)
        self._thread.start()

    def wake(self) -> None:
        """Make the thread look at the endpoints now."""
        self._wake.set()

    def close(self, *, withdraw: bool) -> None:
        """End; the master is told that the node leaves, if it answers."""
        self._closing = True
        self._wake.set()
        if threading.current_thread() is not self._thread:
            self._thread.join(5.0)
        if withdraw and not self.trouble and not self._thread.is_alive():
            try:
                for direction, topic in self._registered:
                    self._master.unregister(direction, topic, self._uri)
            except (UnreachableError, RefusedError) as error:
                _logger.debug("leaving without a word to the master: %s", error)
        self._registered = {}
        self._master.close()

    def _run(self) -> None:
        while not self._closing:
            self._wake.wait(_TICK_S)
            self._wake.clear()
            if self._closing:
                return
            try:
                self._turn()
            except Exception:  # a defect; but the node has to stay registered
                _logger.exception("looking after node %s had an error", self._node)
                time.sleep(0.5)

    def _turn(self) -> None:
        wanted = self._wanted()
        now = time.monotonic()
        if not self.trouble or now >= self._due:
            try:
                if now >= self._due:
                    self._watch(wanted)
                self._settle(wanted)
            except UnreachableError as error:
                self._lost(str(error))
        for endpoint in wanted.values():
            if isinstance(endpoint, Incoming):
                endpoint.update()
            else:
                endpoint.check()

    def _watch(self, wanted: dict[Key, Endpoint]) -> None:
        start, busy = time.monotonic(), time.thread_time()
        self._due = start + _PERIOD_S
        self.state = self._master.state(self.state)
        self.asked = True
        lacks = [key for key in self._registered if self._node not in self._known(key)]
        if lacks and self._node in self.state.nodes and (other := self._elsewhere()):
            self._moved(other)
            return
        for key in lacks:
            del self._registered[key]
        if self.trouble:
            _logger.info("the ROS master at %s answers; node %s registers", self._master.uri, self._node)
            self.trouble = ""
        elif lacks:
            _logger.warning(
                "the ROS master at %s had forgotten %d topics of node %s (it was restarted, or somebody "
                "removed them); they are registered again",
                self._master.uri,
                len(lacks),
                self._node,
            )
        for key, endpoint in wanted.items():
            known = self.state.publishers.get(key[1], frozenset())
            if isinstance(endpoint, Incoming) and len(known) != len(endpoint.publishers):
                self._registered.pop(key, None)  # a notice was missed: registering again tells who there is
            if isinstance(endpoint, Outgoing):
                named = self.state.subscribers.get(key[1], frozenset())
                for stranger, (since, _) in list(endpoint.strangers.items()):
                    # One that came after the master was asked is missing in the answer by right.
                    if stranger not in named and since < start:
                        endpoint.strangers.pop(stranger, None)
        self._due = max(self._due, start + _SHARE * (time.thread_time() - busy))

    def _elsewhere(self) -> str:
        """Return the URI of another node of the same name; empty if it is us."""
        uri = self._master.node_uri(self._node)
        return uri if uri and uri != self._uri else ""

    def _known(self, key: Key) -> frozenset[str]:
        table = self.state.subscribers if key[0] == "in" else self.state.publishers
        return table.get(key[1], frozenset())

    def _settle(self, wanted: dict[Key, Endpoint]) -> None:
        for key in [key for key, endpoint in self._registered.items() if wanted.get(key) is not endpoint]:
            self._ask(self._master.unregister, *key, self._uri)
            del self._registered[key]
        for key, endpoint in wanted.items():
            if key not in self._registered and not self._closing:
                publishers = self._ask(self._master.register, *key, endpoint.kind._type, self._uri)
                self._registered[key] = endpoint
                if isinstance(endpoint, Incoming) and publishers is not None:
                    endpoint.publishers = tuple(publishers)

    def _ask(self, method: Callable[..., Any], *arguments: Any) -> Any:
        try:
            return method(*arguments)
        except RefusedError as error:
            _logger.warning("the ROS master refuses %s: %s", arguments[:2], error)
            return None

    def _lost(self, why: str) -> None:
        if not self.trouble:
            _logger.warning(
                "the ROS master at %s does not answer (%s); node %s keeps trying",
                self._master.uri,
                why,
                self._node,
            )
        self.trouble = f"the ROS master at {self._master.uri} does not answer ({why})"
        self._due = time.monotonic() + _PERIOD_S
