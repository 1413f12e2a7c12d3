"""rclpy/client.py and src/rclpy/client.cpp."""

from __future__ import annotations

import itertools
from typing import Any

from rclpy import _graph
from rclpy._handles import Destroyable, RCLError
from rclpy.serialization import deserialize_message, serialize_message
from rclpy.task import Future


class ServiceHandle(Destroyable):
    """A service's two endpoints: one reads, one writes."""

    def __init__(self, reader: _graph.Endpoint, writer: _graph.Endpoint) -> None:
        super().__init__(self._leave)
        self.reader, self.writer = reader, writer

    def join(self) -> None:
        self.reader.join()
        self.writer.join()

    def _leave(self) -> None:
        self.writer.leave()
        self.reader.leave()

    def _ready(self) -> bool:
        return bool(self.reader.waiting)

    def take(self) -> Any:
        with _graph.changed:
            return self.reader.waiting.popleft() if self.reader.waiting else None


class _RequestId:
    def __init__(self, sequence_number: int) -> None:
        self.sequence_number = sequence_number


class _Info:
    def __init__(self, sequence_number: int) -> None:
        self.request_id = _RequestId(sequence_number)


class Handle(ServiceHandle):
    def __init__(self, *endpoints: _graph.Endpoint) -> None:
        super().__init__(*endpoints)
        self._sequence = itertools.count(1)

    def send_request(self, pyrequest: Any) -> int:
        if _graph.unsupported & {"publish"}:  # a test lets sending fail
            raise RCLError("failed to send request: test")
        number = next(self._sequence)
        self.writer.send(serialize_message(pyrequest), client=(self.writer.number, number))
        return number

    def service_server_is_available(self) -> bool:
        return bool(self.writer.matched() and self.reader.matched())

    def take_response(self, pyresponse_type: Any) -> tuple[Any, Any]:
        taken = self.take()
        if taken is None or taken[1]["client"][0] != self.writer.number:
            return None, None
        return _Info(taken[1]["client"][1]), deserialize_message(taken[0], pyresponse_type)


class Client:
    def __init__(
        self,
        context: Any,
        client_impl: Any,
        srv_type: Any,
        srv_name: str,
        qos_profile: Any,
        callback_group: Any,
    ) -> None:
        self.context = context
        self.__client = client_impl
        self.srv_type = srv_type
        self.srv_name = srv_name
        self.qos_profile = qos_profile
        self._pending_requests: dict[int, Future] = {}
        self.callback_group = callback_group

    def call_async(self, request: Any) -> Future:
        if not isinstance(request, self.srv_type.Request):
            raise TypeError
        with self.handle:
            sequence_number = self.__client.send_request(request)
        future = Future()
        self._pending_requests[sequence_number] = future
        future.add_done_callback(self.remove_pending_request)
        return future

    def get_pending_request(self, sequence_number: int) -> Future:
        return self._pending_requests[sequence_number]

    def remove_pending_request(self, future: Future) -> None:
        for number, pending in self._pending_requests.items():
            if pending is future:
                del self._pending_requests[number]
                break

    def service_is_ready(self) -> bool:
        with self.handle:
            return bool(self.__client.service_server_is_available())

    @property
    def handle(self) -> Any:
        return self.__client

    def destroy(self) -> None:
        self.__client.destroy_when_not_in_use()
