"""The node's registration with the master: made, watched, and made again.

rospy registers once and believes that it stays so. A master that was restarted knows no node; rospy's
nodes then talk only to those that they know and are invisible to all others. Here the master is
asked every second what it knows, and told what it lacks.
"""

from __future__ import annotations

import contextlib
import logging
import threading
import time
from collections.abc import Callable
from typing import Any

from rosplc.ros.rospy.inbound import Incoming
from rosplc.ros.rospy.master import Master, RefusedError, SystemState, UnreachableError
from rosplc.ros.rospy.outbound import Outgoing
from rosplc.ros.rospy.services import RospyServer

_logger = logging.getLogger("rosplc.ros.rospy")

_TICK_NS = 250_000_000
_PERIOD_NS = 1_000_000_000
_SHARE = 50  # the watch takes at most this part of the time, however large the graph

Key = tuple[str, str]  # Direction (`in` or `out`) and topic, or `serve` and service.
Registered = Incoming | Outgoing | RospyServer


class Registration:
    """A thread that keeps the master's knowledge of one node right."""

    def __init__(self, node: Any, master: str) -> None:
        self.trouble = ""  # why the master cannot be reached, in words; empty if it can
        self.state = SystemState()  # what the master knew when it was last asked
        self._node, self._clock = node, node.clock
        self._master = Master(master, node.node, clock=node.clock)
        self._registered: dict[Key, Registered] = {}
        self._due_ns = 0
        self._wake = threading.Event()
        self._closing = False
        self._thread = threading.Thread(target=self._run, name="rosplc-master", daemon=True)
        self._thread.start()

    def wake(self) -> None:
        """Make the thread look at the topics now."""
        self._wake.set()

    def close(self) -> None:
        """End; the master is told that the node leaves, if it answers."""
        self._closing = True
        self._wake.set()
        if threading.current_thread() is not self._thread:
            self._thread.join(5.0)
        if not self.trouble and not self._thread.is_alive():
            # By URI: the master leaves a newer node of our name alone.
            with contextlib.suppress(UnreachableError, RefusedError):
                for topic in self._registered.values():
                    topic.unregister(self._master)
        self._registered = {}
        self._master.close()

    def _run(self) -> None:
        while not self._closing:
            self._clock.wait(self._wake, _TICK_NS)
            self._wake.clear()
            if self._closing:
                return
            try:
                self._turn()
            except Exception:  # a defect; but the node has to stay registered
                _logger.exception("looking after node %s had an error", self._node.node)
                self._clock.sleep(500_000_000)

    def _turn(self) -> None:
        wanted: dict[Key, Registered] = self._node.topics()
        now = self._clock.monotonic_ns()
        if not self.trouble or now >= self._due_ns:
            try:
                if now >= self._due_ns:
                    self._watch(wanted)
                self._settle(wanted)
            except UnreachableError as error:
                self._lost(str(error))
        for one in (*wanted.values(), *self._node.clients()):
            one.update()

    def _watch(self, wanted: dict[Key, Registered]) -> None:
        node, uri = self._node.node, self._master.uri
        start, busy = self._clock.monotonic_ns(), time.thread_time_ns()
        self._due_ns = start + _PERIOD_NS
        self.state = self._master.state(self.state)
        # A service has one server: one that another node has taken is left to it until it leaves.
        lacks = [
            key
            for key in self._registered
            if node not in (known := self._known(*key)) and not (key[0] == "serve" and known)
        ]
        if lacks and node in self.state.nodes:
            other = self._master.node_uri(node)
            if other and other != self._node.uri:
                self._node.moved(other)
                return
        for key in lacks:
            del self._registered[key]
        if self.trouble:
            _logger.info("the ROS master at %s answers; node %s registers", uri, node)
            self.trouble = ""
        elif lacks:
            what = f"the ROS master at {uri} had forgotten {len(lacks)} topics or services of node {node}"
            _logger.warning("%s (it was restarted, or they were removed); they are registered again", what)
        for key, topic in wanted.items():
            if isinstance(topic, Outgoing):
                named = self._known("in", topic.topic)
                for stranger, (since, _) in list(topic.strangers.items()):
                    # One that came after the master was asked is missing in the answer by right.
                    if stranger not in named and since < start:
                        topic.strangers.pop(stranger, None)
            elif isinstance(topic, Incoming) and len(self._known("out", key[1])) != len(topic.publishers):
                self._registered.pop(key, None)  # a notice was missed: registering again tells who there is
        self._due_ns = max(self._due_ns, start + _SHARE * (time.thread_time_ns() - busy))

    def _known(self, direction: str, topic: str) -> frozenset[str]:
        state = self.state
        tables = {"in": state.subscribers, "out": state.publishers, "serve": state.services}
        return tables[direction].get(topic, frozenset())

    def _settle(self, wanted: dict[Key, Registered]) -> None:
        for key in [key for key, topic in self._registered.items() if wanted.get(key) is not topic]:
            self._ask(key, self._registered[key].unregister)
            del self._registered[key]
        for key, topic in wanted.items():
            if key not in self._registered and not self._closing:
                self._ask(key, topic.register)
                self._registered[key] = topic

    def _ask(self, key: Key, method: Callable[[Master], object]) -> None:
        try:
            method(self._master)
        except RefusedError as error:
            _logger.warning("the ROS master refuses %s: %s", key, error)

    def _lost(self, why: str) -> None:
        text = f"the ROS master at {self._master.uri} does not answer ({why})"
        if not self.trouble:
            _logger.warning("%s; node %s keeps trying", text, self._node.node)
        self.trouble = text
        self._due_ns = self._clock.monotonic_ns() + _PERIOD_NS
