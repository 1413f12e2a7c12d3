"""What rclpy's executors use of its C++ part: src/rclpy/wait_set.cpp."""

from __future__ import annotations

import time
from types import SimpleNamespace
from typing import Any

from rclpy import _graph
from rclpy._handles import RCLError


class WaitSet:
    """As rcl's: of a kind it takes as many as it was made for, and after a wait only those that are ready."""

    def __init__(
        self,
        subscriptions: int,
        guards: int,
        timers: int,
        clients: int,
        services: int,
        events: int,
        context: Any,
    ) -> None:
        if not context.valid():
            raise RCLError("failed to initialize wait set: the given context is not valid")
        kinds = ("subscription", "guard_condition", "timer", "client", "service", "event")
        self._room = dict(zip(kinds, (subscriptions, guards, timers, clients, services, events), strict=True))
        self.clear_entities()

    def clear_entities(self) -> None:
        self._entities: dict[str, list[Any]] = {kind: [] for kind in self._room}

    def _add(self, kind: str, entity: Any) -> int:
        if len(self._entities[kind]) == self._room[kind]:
            raise RCLError(f"failed to add {kind} to wait set: {kind}s set is full")
        self._entities[kind].append(entity)
        return len(self._entities[kind]) - 1

    def add_subscription(self, subscription: Any) -> int:
        return self._add("subscription", subscription)

    def add_guard_condition(self, gc: Any) -> int:
        return self._add("guard_condition", gc)

    def add_timer(self, timer: Any) -> int:
        return self._add("timer", timer)

    def add_client(self, client: Any) -> int:
        return self._add("client", client)

    def add_service(self, service: Any) -> int:
        return self._add("service", service)

    def add_event(self, event: Any) -> int:
        return self._add("event", event)

    def wait(self, timeout: int) -> None:
        end = None if timeout < 0 else time.monotonic() + timeout / 1e9
        with _graph.changed:
            while not any(each._ready() for kind in self._entities.values() for each in kind):
                left = None if end is None else end - time.monotonic()
                if left is not None and left <= 0:
                    break
                _graph.changed.wait(left)
            for kind, entities in self._entities.items():
                self._entities[kind] = [each if each._ready() else None for each in entities]
            for guard in filter(None, self._entities["guard_condition"]):
                guard._triggered = False

    def is_ready(self, entity_type: str, index: int) -> bool:
        return self._entities[entity_type][index] is not None

    def get_ready_entities(self, entity_type: str) -> list[int]:
        return [each.pointer for each in self._entities[entity_type] if each is not None]


rclpy_implementation = SimpleNamespace(WaitSet=WaitSet)
