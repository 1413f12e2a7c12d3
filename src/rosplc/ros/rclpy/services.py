"""Services on rclpy: its servers and clients take objects of Python, the bridge bytes.

rclpy sends what a server's callback returns, at once or when a coroutine has ended; one that waits keeps its
callback group occupied and the executor spinning. So the callback returns the request itself, and what the
executor then gives to ``send_response``, the request's header beside it, is kept until the answer comes.
"""

from __future__ import annotations

import re
import threading
from functools import partial
from typing import Any

from rclpy.serialization import deserialize_message, serialize_message

from rosplc.ros._base import BaseClient, KeepingServer
from rosplc.ros.backend import Reply
from rosplc.ros.rclpy.endpoint import RclpyEndpointBase

_MANGLED = re.compile(r"(\w+)::(srv|action)::dds_::(\w+)_(?:Request|Response)_\Z")


def service_type(name: str) -> str:
    """Return the service's name for the type of one of its two topics, as DDS has it; others as they are."""
    found = _MANGLED.match(name)
    return "/".join(found.groups()) if found else name


class _Service(RclpyEndpointBase):
    serves = True

    def _converted(self, payload: bytes, part: str) -> Any:
        """Return a message as an object; ROS008 if the bytes are none of the type."""
        try:
            return deserialize_message(payload, getattr(self.entity.srv_type, part))
        except Exception as error:
            raise self._refusal(str(error).strip() or type(error).__name__) from error


class RclpyServer(_Service, KeepingServer):
    """A service that is served; see :class:`rosplc.ros.backend.ServiceServer`."""

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self._attached = threading.Event()

    def attach(self, entity: Any) -> None:
        """Take over rclpy's server."""
        self._respond, entity.send_response = entity.send_response, self._receive
        self._attached.set()

    def make(self, node: Any, *details: Any, **others: Any) -> Any:
        """Create rclpy's server."""
        kind, name, settings = details
        return node.create_service(kind, name, self.hold, qos_profile=settings, **others)

    def hold(self, request: Any, _response: Any) -> Any:
        """Return the request in place of a response: the callback of rclpy's server."""
        self._attached.wait()  # it may come before the server's creation has returned
        return request

    def _receive(self, request: Any, header: Any) -> None:
        self._take(serialize_message(request), self.new_caller(), int(header.source_timestamp), header)

    def _count(self, entity: Any) -> int:
        return int(self._node.fitting(self))

    def _answer(self, caller: bytes, origin: Any, payload: bytes) -> bool:
        response = self._converted(payload, "Response")
        try:
            self._respond(response, origin)
        except RuntimeError as error:
            raise self._failed_to_send(error) from error
        return True


class RclpyClient(_Service, BaseClient):
    """A service that is called; see :class:`rosplc.ros.backend.ServiceClient`."""

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self._futures: dict[int, Any] = {}
        self._sending = threading.Lock()

    def make(self, node: Any, *details: Any, **others: Any) -> Any:
        """Create rclpy's client."""
        kind, name, settings = details
        return node.create_client(kind, name, qos_profile=settings, **others)

    def attach(self, entity: Any) -> None:
        """Take over rclpy's client."""
        pending = entity.get_pending_request

        def get_pending_request(sequence_number: int) -> Any:
            with self._sending:  # before Kilted, a response may come before its request is noted
                return pending(sequence_number)

        entity.get_pending_request = get_pending_request

    def _count(self, entity: Any) -> int:
        try:
            return int(entity.service_is_ready())
        except RuntimeError:  # the context was shut down
            return 0

    def _receivers(self) -> frozenset[bytes]:
        # Over a middleware that has no topics for services, one that is ready is all that is known.
        return (self._node.servers(self.topic) or frozenset({b""})) if self.matched else frozenset()

    def _send(self, number: int, payload: bytes) -> None:
        request = self._converted(payload, "Request")
        try:
            with self._sending:
                future = self.entity.call_async(request)
        except RuntimeError as error:
            raise self._failed_to_send(error) from error
        self._futures[number] = future
        future.add_done_callback(partial(self._receive, number))

    def _receive(self, number: int, future: Any) -> None:
        self._futures.pop(number, None)
        if (response := future.result()) is not None:
            self.end(number, Reply(serialize_message(response)))

    def look(self) -> None:
        """End the calls whose servers have gone: rclpy tells nobody of it."""
        if self.calls and not self.closed:
            self.end_orphans(self._receivers())

    def _withdraw(self, number: int) -> None:
        future = self._futures.pop(number, None)
        if future is not None:
            self.entity.remove_pending_request(future)

    def gone(self, *servers: Any) -> None:
        """End the calls that no other servers have received than these."""
        super().gone(*servers)
        for number in tuple(self._futures.keys() - self.calls.keys()):
            self._withdraw(number)

    def forget(self, number: int) -> None:
        """Wait no longer for a call."""
        super().forget(number)
        self._withdraw(number)
