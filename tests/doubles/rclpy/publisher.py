"""rclpy/publisher.py."""

from __future__ import annotations

from typing import Any


class Publisher:
    def __init__(
        self,
        publisher_impl: Any,
        msg_type: Any,
        topic: str,
        qos_profile: Any,
        event_callbacks: Any,
        callback_group: Any,
    ) -> None:
        self.__publisher = publisher_impl
        self.msg_type = msg_type
        self.topic = topic
        self.qos_profile = qos_profile
        self.event_handlers = event_callbacks.create_event_handlers(callback_group, publisher_impl, topic)

    def publish(self, msg: Any) -> None:
        with self.handle:
            if isinstance(msg, bytes):
                self.__publisher.publish_raw(msg)
            elif isinstance(msg, self.msg_type):
                raise NotImplementedError("the double sends raw bytes only")
            else:
                raise TypeError(f"Expected {self.msg_type}, got {type(msg)}")

    def get_subscription_count(self) -> int:
        with self.handle:
            return len(self.__publisher.endpoint.matched())

    @property
    def topic_name(self) -> str:
        with self.handle:
            return str(self.__publisher.endpoint.topic)

    @property
    def handle(self) -> Any:
        return self.__publisher

    def destroy(self) -> None:
        for handler in self.event_handlers:
            handler.destroy()
        self.__publisher.destroy_when_not_in_use()
