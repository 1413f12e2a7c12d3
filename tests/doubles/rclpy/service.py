"""rclpy/service.py and src/rclpy/service.cpp."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rclpy import _graph
from rclpy._handles import RCLError
from rclpy.client import ServiceHandle
from rclpy.serialization import deserialize_message, serialize_message


class Header:
    """rmw_service_info_t."""

    def __init__(self, info: dict[str, Any]) -> None:
        self.source_timestamp = info["source_timestamp"]
        self.received_timestamp = info["received_timestamp"]
        self._client = info["client"]


class _Handle(ServiceHandle):
    def service_take_request(self, pyrequest_type: Any) -> tuple[Any, Any]:
        taken = self.take()
        if taken is None:
            return None, None
        return deserialize_message(taken[0], pyrequest_type), Header(taken[1])

    def service_send_response(self, pyresponse: Any, header: Header) -> None:
        if _graph.unsupported & {"publish"}:  # a test lets sending fail
            raise RCLError("failed to send response: test")
        self.writer.send(serialize_message(pyresponse), client=header._client)


class Service:
    def __init__(
        self,
        service_impl: Any,
        srv_type: Any,
        srv_name: str,
        callback: Callable[[Any, Any], Any],
        callback_group: Any,
        qos_profile: Any,
    ) -> None:
        self.__service = service_impl
        self.srv_type = srv_type
        self.srv_name = srv_name
        self.callback = callback
        self.callback_group = callback_group
        self.qos_profile = qos_profile

    def send_response(self, response: Any, header: Any) -> None:
        if not isinstance(response, self.srv_type.Response):
            raise TypeError
        if not isinstance(header, Header):
            raise TypeError
        with self.handle:
            self.__service.service_send_response(response, header)

    @property
    def handle(self) -> Any:
        return self.__service

    def destroy(self) -> None:
        self.__service.destroy_when_not_in_use()
