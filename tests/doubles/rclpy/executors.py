"""rclpy/executors.py: one wait set over all entities for each thing that is done, as there."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable
from typing import Any

from rclpy import _graph
from rclpy._distro import HUMBLE
from rclpy._handles import Destroyable, InvalidHandle
from rclpy.task import Task


class ExternalShutdownException(Exception):
    pass


class ShutdownException(Exception):
    pass


class TimeoutException(Exception):
    pass


class _GuardHandle(Destroyable):
    _triggered = False

    def _ready(self) -> bool:
        return self._triggered


class _Guard:
    """rclpy/guard_condition.py."""

    def __init__(self) -> None:
        self.handle = _GuardHandle(lambda: None)

    def trigger(self) -> None:
        with self.handle, _graph.changed:
            self.handle._triggered = True
            _graph.changed.notify_all()

    def destroy(self) -> None:
        self.handle.destroy_when_not_in_use()


class Executor:
    def _take_subscription(self, sub: Any) -> Any:
        return _take(sub)

    def _take_service(self, srv: Any) -> Any:
        with srv.handle:
            request, header = srv.handle.service_take_request(srv.srv_type.Request)

        def execute() -> None:
            if header is not None:
                srv.send_response(srv.callback(request, srv.srv_type.Response()), header)

        return execute

    def _take_client(self, client: Any) -> Any:
        with client.handle:
            header, response = client.handle.take_response(client.srv_type.Response)

        def execute() -> None:
            if header is not None:
                with contextlib.suppress(KeyError):  # the request was cancelled
                    future = client.get_pending_request(header.request_id.sequence_number)
                    future._set_executor(self)
                    future.set_result(response)

        return execute

    def __init__(self, *, context: Any = None) -> None:
        if context is None:
            from rclpy.utilities import get_default_context

            context = get_default_context()
        if not context.ok():
            raise RuntimeError("failed to create guard condition: the given context is not valid")
        self._context = context
        self._nodes: list[Any] = []
        self._tasks: list[Task] = []
        self._guard: Any = _Guard()
        self._sigint_gc: Any = _Guard()
        self._is_shutdown = False
        context.on_shutdown(self.wake)

    @property
    def context(self) -> Any:
        return self._context

    def create_task(self, callback: Callable[..., Any], *args: Any, **kwargs: Any) -> Task:
        task = Task(callback, args, kwargs)
        with _graph.changed:
            self._tasks.append(task)
            self._guard.trigger()  # None after the shutdown
        return task

    def shutdown(self, timeout_sec: float | None = None) -> bool:
        with _graph.changed:
            if not self._is_shutdown:
                self._guard.trigger()
                self._guard.destroy()
                self._sigint_gc.destroy()
            self._is_shutdown, self._guard, self._sigint_gc = True, None, None
            self._nodes = []
        return True

    def add_node(self, node: Any) -> bool:
        with _graph.changed:
            if node in self._nodes:
                return False
            self._nodes.append(node)
        node.executor = self
        self.wake()
        return True

    def remove_node(self, node: Any) -> None:
        with _graph.changed:
            if node in self._nodes:
                self._nodes.remove(node)
                self.wake()

    def wake(self) -> None:
        with _graph.changed:
            if self._guard is not None:
                self._guard.trigger()

    def get_nodes(self) -> list[Any]:
        return list(self._nodes)

    def spin(self) -> None:
        while self._context.ok() and not self._is_shutdown:
            self.spin_once()

    def spin_once(self, timeout_sec: float | None = None) -> None:
        raise NotImplementedError

    def can_execute(self, entity: Any) -> bool:
        return bool(entity.callback_group.can_execute(entity))

    def wait_for_ready_callbacks(self, *args: Any, **kwargs: Any) -> tuple[Task, Any, Any]:
        return self._wait(*args, **kwargs), None, None

    def _wait(self, timeout_sec: float | None = None) -> Task:
        end = None if timeout_sec is None or timeout_sec < 0 else time.monotonic() + timeout_sec
        with _graph.changed:
            while True:
                if self._is_shutdown:
                    raise ShutdownException
                if not self._context.ok():
                    raise ExternalShutdownException
                if self._tasks:
                    return self._tasks.pop(0)
                if (work := self._ready()) is not None:
                    return Task(work)
                left = None if end is None else end - time.monotonic()
                if left is not None and left <= 0:
                    self._guard.handle._triggered = False  # taken by the wait that found nothing else
                    raise TimeoutException
                _graph.changed.wait(left)

    def _ready(self) -> Callable[[], None] | None:
        for node in self._nodes:
            for handler in list(node.waitables):
                if handler._waiting() and self.can_execute(handler):
                    handler._ready_to_take_data = True
                    return _guarded(handler, lambda h=handler: h.callback(h.take_data()))  # type: ignore[misc]
            for subscription in list(node.subscriptions):
                if subscription.handle._ready() and self.can_execute(subscription):
                    return _handled(subscription, self._take_subscription)
            for entities, take in ((node.services, self._take_service), (node.clients, self._take_client)):
                for entity in list(entities):
                    if entity.handle._ready() and self.can_execute(entity):
                        return _handled(entity, take)
        return None


class SingleThreadedExecutor(Executor):
    def __init__(self, *, context: Any = None) -> None:
        super().__init__(context=context)

    def spin_once(self, timeout_sec: float | None = None) -> None:
        with contextlib.suppress(ShutdownException, TimeoutException):
            handler = self.wait_for_ready_callbacks(timeout_sec=timeout_sec)[0]
            handler()
            handler.result()  # what a callback raises comes out here, as in rclpy


def _guarded(entity: Any, work: Callable[[], None]) -> Callable[[], None]:
    def run() -> None:
        if entity.callback_group.beginning_execution(entity):
            try:
                work()
            finally:
                entity.callback_group.ending_execution(entity)

    return run


def _handled(entity: Any, take: Callable[[Any], Any]) -> Callable[[], None]:
    """As ``_make_handler``: what a take raises leaves the callback group occupied."""

    def run() -> None:
        if entity.callback_group.beginning_execution(entity):
            call = take(entity)
            try:
                if call is not None:
                    call()
            finally:
                entity.callback_group.ending_execution(entity)

    return run


def _take(subscription: Any) -> Callable[[], None] | None:
    try:
        with subscription.handle:
            taken = subscription.handle.take_message(subscription.msg_type, subscription.raw)
    except InvalidHandle:
        if HUMBLE:  # there the executor does not expect it
            raise
        return None
    if taken is None:
        return None
    if HUMBLE or subscription._callback_type.name == "MessageOnly":
        return lambda: subscription.callback(taken[0])
    return lambda: subscription.callback(*taken)
