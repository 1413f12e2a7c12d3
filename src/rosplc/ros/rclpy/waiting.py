"""The wait set of the bridge's own node, reused as long as the node's entities are the same.

rclpy's executors create a wait set for each message. Here, the bridge's subscriptions are emptied at each
wake-up; anything else that is ready (services, timers, tasks, events) is left to the executor.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from contextlib import ExitStack
from typing import Any

from rclpy.exceptions import InvalidHandle
from rclpy.executors import ShutdownException, TimeoutException

from rosplc.ros.rclpy.endpoint import RclpySubscription

_logger = logging.getLogger("rosplc.ros.rclpy")
_KINDS = ("subscription", "guard_condition", "timer", "client", "service")  # in rclpy's order
_EVENTS_NS = 1_000_000_000  # between looks at the events of a busy node: they are most of its entities
_QUIET_NS = 250_000_000  # without any message, after which events are waited for as well


def _ours(entity: Any) -> RclpySubscription | None:
    owner = getattr(getattr(entity, "callback", None), "__self__", None)
    return owner if isinstance(owner, RclpySubscription) else None


class Waiting:
    """Serves a node on one thread; uses only the executor if this rclpy lacks the required internals."""

    def __init__(self, executor: Any, node: Any) -> None:
        self._executor, self._node = executor, node
        self._alone = False
        self._rest = True  # whether the executor may have something to do
        self._set: Any = None
        self._held = ExitStack()  # what is waited for is not destroyed meanwhile
        self._takes: dict[int, Callable[[], bool]] = {}
        self._events_at = 0

    def spin_once(self) -> None:
        """Wait, and process what is ready; raises what the executor raises."""
        if self._alone:
            self._executor.spin_once()
        elif self._rest:
            self._do_one()
        else:
            try:
                self._rest = self._receive()
            except Exception as error:
                self._rest = True
                # Not when an entity has just been destroyed, or all of them.
                if not isinstance(error, InvalidHandle) and self._executor.context.ok():
                    _logger.warning("rclpy's executor receives all messages, which uses more CPU: %s", error)
                    self._alone = True
                    self.release()
                    vars(self._executor).pop("can_execute", None)

    def release(self) -> None:
        """Release the wait set."""
        self._set = None
        self._held.close()

    def _do_one(self) -> None:
        for take in self._takes.values():  # however much else there is to do
            take()
        try:
            task = self._executor.wait_for_ready_callbacks(timeout_sec=0)[0]
        except TimeoutException:  # nothing is left; entities may have come or gone
            self._rest = False
            self.release()
        except ShutdownException:
            pass
        else:
            task()
            task.result()

    def _holds(self, handle: Any) -> bool:
        try:
            self._held.enter_context(handle)
        except InvalidHandle:
            return False
        return True

    def _gather(self) -> Any:
        from rclpy.impl.implementation_singleton import rclpy_implementation

        node, executor = self._node, self._executor
        able = type(executor).can_execute
        executor.can_execute = lambda entity: _ours(entity) is None and able(executor, entity)
        guards = [*node.guards, executor._guard, executor._sigint_gc]
        found = (node.subscriptions, guards, node.timers, node.clients, node.services)
        handles = [[each.handle for each in kind if self._holds(each.handle)] for kind in found]
        self._events = [event for event in node.waitables if self._holds(event)]
        sizes = [*map(len, handles), len(self._events)]
        made = rclpy_implementation.WaitSet(*sizes, executor.context.handle)
        adds = [getattr(made, f"add_{kind}") for kind in _KINDS]
        self._adds = [(add, handle) for add, kind in zip(adds, handles, strict=True) for handle in kind]
        owners = ((each.handle.pointer, _ours(each)) for each in node.subscriptions)
        self._takes = {pointer: owner.take for pointer, owner in owners if owner is not None}
        return made

    def _receive(self) -> bool:
        """Wait, and empty the subscriptions that are ready; return whether anything else is ready."""
        if self._set is None:
            self._set = self._gather()
        if self._executor._tasks:  # come while the executor looked, which has taken their guard's trigger
            return True
        waits, wide = self._set, time.monotonic_ns() >= self._events_at
        waits.clear_entities()
        for add, handle in self._adds:
            add(handle)
        for event in self._events if wide else ():
            event.add_to_wait_set(waits)
        waits.wait(-1 if wide else _QUIET_NS)
        ready = waits.get_ready_entities("subscription")
        rest = any(map(waits.get_ready_entities, _KINDS[1:]))
        if wide:
            rest = any([rest, *(event.is_ready(waits) for event in self._events)])
            self._events_at = time.monotonic_ns() + _EVENTS_NS
        elif not ready and not rest:
            self._events_at = 0
        for pointer in ready:
            take = self._takes.get(pointer)
            rest |= take is None or not take()
        return rest
