"""What rclpy/event_handler.py (rclpy/qos_event.py on Humble) has: handlers of the middleware's events."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rclpy import _graph
from rclpy._distro import HUMBLE
from rclpy._handles import Destroyable, UnsupportedEventTypeError

_OPTIONAL = {"incompatible_qos", "incompatible_type"}  # unsupported ones are let go, where they are


class _Handle(Destroyable):
    def __init__(self, ready: Callable[[], bool]) -> None:
        super().__init__(lambda: None)
        self._ready = ready


class EventHandler:
    def __init__(
        self, *, callback_group: Any, callback: Callable[[Any], None], event_type: str, parent_impl: Any
    ) -> None:
        if event_type in _graph.unsupported:
            raise UnsupportedEventTypeError("event is unsupported")
        self.callback_group = callback_group
        self.callback = callback
        self.event_type = event_type
        self._endpoint = parent_impl.endpoint
        self._handle = _Handle(self._waiting)
        self._index: int | None = None
        self._ready_to_take_data = False
        self._endpoint.events[event_type] = []
        callback_group.add_entity(self)

    def _waiting(self) -> bool:
        return bool(self._endpoint.events.get(self.event_type))

    def add_to_wait_set(self, wait_set: Any) -> None:
        with self._handle:
            self._index = wait_set.add_event(self._handle)

    def is_ready(self, wait_set: Any) -> bool:
        if self._index is not None and wait_set.is_ready("event", self._index):
            self._ready_to_take_data = True
        return self._ready_to_take_data

    def take_data(self) -> Any:
        if not self._ready_to_take_data:
            return None
        self._ready_to_take_data = False
        with self._handle:
            return self._endpoint.events[self.event_type].pop(0)

    def __enter__(self) -> None:
        self._handle.__enter__()

    def __exit__(self, *error: object) -> None:
        self._handle.__exit__(*error)

    def destroy(self) -> None:
        self._endpoint.events.pop(self.event_type, None)
        self._handle.destroy_when_not_in_use()


def _create(chosen: dict[str, Any], defaults: bool, callback_group: Any, parent: Any) -> list[EventHandler]:
    handlers = []
    for event, callback in chosen.items():
        if callback is None and not (defaults and event in _OPTIONAL):
            continue
        try:
            handlers.append(
                EventHandler(
                    callback_group=callback_group,
                    callback=callback or (lambda _: None),
                    event_type=event,
                    parent_impl=parent,
                )
            )
        except UnsupportedEventTypeError:
            # Humble lets only its own default callback go; later ones do so with the user's too.
            if event not in _OPTIONAL or (HUMBLE and callback is not None):
                raise
    return handlers


class _Callbacks:
    def __init__(self, use_default_callbacks: bool, **chosen: Any) -> None:
        self._chosen = chosen
        self.use_default_callbacks = use_default_callbacks

    def create_event_handlers(self, callback_group: Any, parent: Any, topic_name: str) -> list[EventHandler]:
        return _create(self._chosen, self.use_default_callbacks, callback_group, parent)


if HUMBLE:

    class SubscriptionEventCallbacks(_Callbacks):
        def __init__(
            self,
            *,
            deadline: Any = None,
            incompatible_qos: Any = None,
            liveliness: Any = None,
            message_lost: Any = None,
            use_default_callbacks: bool = True,
        ) -> None:
            super().__init__(
                use_default_callbacks, incompatible_qos=incompatible_qos, message_lost=message_lost
            )

    class PublisherEventCallbacks(_Callbacks):
        def __init__(
            self,
            *,
            deadline: Any = None,
            liveliness: Any = None,
            incompatible_qos: Any = None,
            use_default_callbacks: bool = True,
        ) -> None:
            super().__init__(use_default_callbacks, incompatible_qos=incompatible_qos)

else:

    class SubscriptionEventCallbacks(_Callbacks):  # type: ignore[no-redef]
        def __init__(
            self,
            *,
            deadline: Any = None,
            incompatible_qos: Any = None,
            liveliness: Any = None,
            message_lost: Any = None,
            incompatible_type: Any = None,
            matched: Any = None,
            use_default_callbacks: bool = True,
        ) -> None:
            super().__init__(
                use_default_callbacks,
                incompatible_qos=incompatible_qos,
                message_lost=message_lost,
                incompatible_type=incompatible_type,
                matched=matched,
            )

    class PublisherEventCallbacks(_Callbacks):  # type: ignore[no-redef]
        def __init__(
            self,
            *,
            deadline: Any = None,
            liveliness: Any = None,
            incompatible_qos: Any = None,
            incompatible_type: Any = None,
            matched: Any = None,
            use_default_callbacks: bool = True,
        ) -> None:
            super().__init__(
                use_default_callbacks,
                incompatible_qos=incompatible_qos,
                incompatible_type=incompatible_type,
                matched=matched,
            )
