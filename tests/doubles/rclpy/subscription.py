"""rclpy/subscription.py."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from enum import Enum
from typing import Any

from rclpy._distro import HUMBLE


class _Subscription:
    def __init__(
        self,
        subscription_impl: Any,
        msg_type: Any,
        topic: str,
        callback: Callable[..., Any],
        callback_group: Any,
        qos_profile: Any,
        raw: bool,
        event_callbacks: Any,
    ) -> None:
        self.__subscription = subscription_impl
        self.msg_type = msg_type
        self.topic = topic
        self.callback = callback
        self.callback_group = callback_group
        self.qos_profile = qos_profile
        self.raw = raw
        self.event_handlers = event_callbacks.create_event_handlers(callback_group, subscription_impl, topic)

    @property
    def handle(self) -> Any:
        return self.__subscription

    def destroy(self) -> None:
        for handler in self.event_handlers:
            handler.destroy()
        self.handle.destroy_when_not_in_use()

    @property
    def topic_name(self) -> str:
        with self.handle:
            return str(self.handle.endpoint.topic)


class _WithInfo(_Subscription):
    """Since ROS 2 Iron: the callback may take the message's information, and matches are counted."""

    class CallbackType(Enum):
        MessageOnly = 0
        WithMessageInfo = 1

    def get_publisher_count(self) -> int:
        with self.handle:
            return len(self.handle.endpoint.matched())

    @property
    def callback(self) -> Callable[..., Any]:
        return self._callback

    @callback.setter
    def callback(self, value: Callable[..., Any]) -> None:
        self._callback = value
        for arguments, kind in (
            ((object(),), self.CallbackType.MessageOnly),
            ((object(), object()), self.CallbackType.WithMessageInfo),
        ):
            try:
                inspect.signature(value).bind(*arguments)
            except TypeError:
                continue
            self._callback_type = kind
            return
        raise RuntimeError("Subscription.__init__(): callback should be either be callable with one argument")


class Subscription(_Subscription if HUMBLE else _WithInfo):  # type: ignore[misc]
    pass
