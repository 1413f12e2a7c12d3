"""The middleware: one graph for all contexts of the process, with DDS's rules of matching.

Newest ``depth`` messages wait and older ones give way; latched publishers serve late subscribers;
other types and excluding settings keep endpoints from matching, and raise events at both.
"""

from __future__ import annotations

import itertools
import threading
import time
from collections import deque
from dataclasses import dataclass, field
from typing import Any

from rclpy._distro import HUMBLE

changed = threading.Condition(threading.RLock())
"""Guards the whole graph; notified when something may be ready."""

endpoints: dict[tuple[int, str], list[Endpoint]] = {}
nodes: dict[int, list[tuple[str, str]]] = {}
unsupported: set[str] = set()
"""Names of events that the middleware does not support; tests put them in."""

_numbers = itertools.count(1)


@dataclass(eq=False)
class Endpoint:
    domain: int
    topic: str
    publishes: bool
    type_name: str
    type_hash: str
    profile: Any
    node_name: str
    node_namespace: str
    number: int = field(default_factory=lambda: next(_numbers))
    waiting: deque[tuple[bytes, dict[str, Any]]] = field(default_factory=deque)
    kept: list[tuple[bytes, dict[str, Any]]] = field(default_factory=list)
    events: dict[str, list[Any]] = field(default_factory=dict)
    bad_settings: int = 0
    other_types: int = 0
    known: set[int] = field(default_factory=set)

    def others(self) -> list[Endpoint]:
        return [e for e in endpoints.get((self.domain, self.topic), ()) if e.publishes != self.publishes]

    def problem(self, other: Endpoint) -> str:
        # Since Iron type hashes are announced; here they keep endpoints apart, as over Zenoh.
        if self.type_name != other.type_name or (not HUMBLE and self.type_hash != other.type_hash):
            return "type"
        from rclpy.qos import _excluding

        offered, wanted = (self, other) if self.publishes else (other, self)
        return _excluding(offered.profile, wanted.profile)[0]

    def matched(self) -> list[Endpoint]:
        with changed:
            return [other for other in self.others() if not self.problem(other)]

    def _meet(self, other: Endpoint) -> None:
        """Raise the event that an endpoint which does not fit causes, once."""
        problem = self.problem(other)
        if not problem or other.number in self.known:
            return
        self.known.add(other.number)
        if problem == "type":
            self.other_types += 1
            self._raise("incompatible_type", total_count=self.other_types, total_count_change=1)
        else:
            from rclpy.qos import QoSPolicyKind

            self.bad_settings += 1
            self._raise(
                "incompatible_qos",
                total_count=self.bad_settings,
                total_count_change=1,
                last_policy_kind=QoSPolicyKind[problem],
            )

    def _raise(self, event: str, **values: Any) -> None:
        if event in self.events:
            self.events[event].append(Status(**values))

    def put(self, payload: bytes, info: dict[str, Any]) -> None:
        while len(self.waiting) >= self.profile.depth:
            self.waiting.popleft()
        self.waiting.append((payload, info))

    def send(self, payload: bytes, **info: Any) -> None:
        now = time.time_ns()
        message = (payload, {"source_timestamp": now, "received_timestamp": now, **info})
        with changed:
            if self._latched():
                self.kept = [*self.kept, message][-self.profile.depth :]
            for other in self.matched():
                other.put(*message)
            changed.notify_all()

    def _latched(self) -> bool:
        return bool(self.profile.durability.name == "TRANSIENT_LOCAL")

    def join(self) -> None:
        with changed:
            endpoints.setdefault((self.domain, self.topic), []).append(self)
            for other in self.others():
                self._meet(other)
                other._meet(self)
                if not self.publishes and not self.problem(other) and self._latched():
                    for message in other.kept[-self.profile.depth :]:
                        self.put(*message)
            changed.notify_all()

    def leave(self) -> None:
        with changed:
            here = endpoints.get((self.domain, self.topic), [])
            if self in here:
                here.remove(self)
                if not here:
                    del endpoints[self.domain, self.topic]
            changed.notify_all()


class Status:
    """An event's payload, as the middleware gives it; only the fields that its kind has."""

    def __init__(self, **values: Any) -> None:
        self.__dict__.update(values)
