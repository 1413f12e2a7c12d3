"""The bridge's own endpoints on rclpy: bytes in, bytes out, and how they fare.

The hot paths are :meth:`RclpySubscription.receive` and :meth:`RclpyPublisher.write`.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from typing import Any, Literal

from rclpy.exceptions import InvalidHandle

from rosplc.errors import BackendError
from rosplc.ros.backend import EndpointStatus, OnMessage, Qos

__all__ = ["RclpyPublisher", "RclpySubscription"]

_logger = logging.getLogger("rosplc.ros.rclpy")

_BATCH = 64  # messages taken from one subscription before the others get their turn

Diagnose = Callable[["RclpySubscription | RclpyPublisher"], tuple[str, str]]
"""Returns code and words for what keeps peers from matching an endpoint."""

Closed = Callable[["RclpySubscription | RclpyPublisher"], None]


class _Endpoint:
    """What both directions have in common.

    Args:
        topic: The absolute topic name before remapping by ROS arguments.
        type_name: The ROS type name.
        qos: The settings.
        diagnose: Asked for the reason in :meth:`status`.
        on_close: Called once; it destroys the entity.
    """

    direction: Literal["in", "out"]

    def __init__(
        self, topic: str, type_name: str, qos: Qos, profile: Any, diagnose: Diagnose, on_close: Closed
    ) -> None:
        self.topic = topic
        self.type_name = type_name
        self.qos = qos
        self.profile = profile
        self.entity: Any = None  # set by the backend; a message may come before
        self.lost = 0  # set by the middleware's event
        self._diagnose = diagnose
        self._on_close = on_close
        self._lock = threading.RLock()  # re-entrant: on_message may close its own subscription
        self.closed = False
        self._messages = 0
        self._rejected = 0
        self._failed = 0
        self._last_ns = 0

    @property
    def matched(self) -> int:
        """Peers that exchange messages with this endpoint."""
        entity = self.entity
        if self.closed or entity is None:
            return 0
        try:
            return self._count(entity)
        except InvalidHandle:  # destroyed at this moment
            return 0

    def _count(self, entity: Any) -> int:
        raise NotImplementedError

    def close(self) -> None:
        """Destroy the entity; closing twice is harmless."""
        with self._lock:
            if self.closed:
                return
            self.closed = True
        self._on_close(self)  # type: ignore[arg-type]

    def status(self) -> EndpointStatus:
        """Return the present state."""
        code, reason = ("ROS009", "closed") if self.closed else self._diagnose(self)  # type: ignore[arg-type]
        if self._rejected and not reason and self.direction == "in":
            reason = f"{self._rejected} messages on {self.topic} were none that a ROS 2 node sends"
        return EndpointStatus(
            self.topic, self.type_name, self.direction, self.matched, self._messages, self.lost,
            self._rejected, self._failed, self._last_ns, reason, code,
        )  # fmt: skip


class RclpySubscription(_Endpoint):
    """A raw subscription; see :class:`rosplc.ros.backend.Subscription`.

    Attributes:
        fitting: Counts the publishers that fit, for rclpy versions that do not count the matched
            ones (before ROS 2 Iron).
    """

    direction: Literal["in"] = "in"

    def __init__(
        self, on_message: OnMessage, fitting: Callable[[RclpySubscription], int], *arguments: Any
    ) -> None:
        super().__init__(*arguments)
        self._on_message = on_message
        self._fitting = fitting

    def _count(self, entity: Any) -> int:
        count = getattr(entity, "get_publisher_count", None)
        return int(count()) if count is not None else self._fitting(self)

    def receive(self, payload: bytes, info: dict[str, Any]) -> None:
        """Deliver a message; the callback where rclpy gives its information too."""
        self._receive(payload, info["source_timestamp"], stamped=True)

    def receive_plain(self, payload: bytes) -> None:
        """Deliver a message; the callback for rclpy versions that give no stamp with it."""
        self._receive(payload, 0, stamped=False)

    def _receive(self, payload: bytes, stamp_ns: int, *, stamped: bool) -> None:
        """Deliver a message and those that wait behind it.

        The executor builds a wait set over all entities of the node for each message it takes. What
        else has arrived is taken here at once, as the executor's own ``_take_subscription`` does.
        """
        with self._lock:
            self._deliver(payload, stamp_ns)
            for _ in range(_BATCH):
                entity = self.entity
                if self.closed or entity is None:
                    return
                try:
                    with entity.handle:
                        taken = entity.handle.take_message(entity.msg_type, True)
                except InvalidHandle:
                    return
                except Exception as error:
                    self.refuse(error)
                    continue
                if taken is None:
                    return
                # All stamps of a topic are of one kind, though these messages would have theirs.
                self._deliver(taken[0], taken[1]["source_timestamp"] if stamped else 0)

    def refuse(self, error: object) -> None:
        """Count a message that no ROS 2 node sends."""
        self._rejected += 1
        level = logging.WARNING if self._rejected == 1 else logging.DEBUG
        _logger.log(level, "%s: a message was refused: %s", self.topic, error)

    def _deliver(self, payload: bytes, stamp_ns: int) -> None:
        if self.closed:
            return
        if len(payload) < 4 or payload[0] != 0 or payload[1] > 1:
            self.refuse("it has no header of plain CDR")
            return
        now = time.time_ns()
        self._messages += 1
        self._last_ns = now
        try:
            self._on_message(payload, stamp_ns or now)
        except Exception:
            self._failed += 1
            if self._failed == 1:
                _logger.exception("%s: the receiver of its messages failed", self.topic)


class RclpyPublisher(_Endpoint):
    """A publisher of serialized messages; see :class:`rosplc.ros.backend.Publisher`."""

    direction: Literal["out"] = "out"

    def _count(self, entity: Any) -> int:
        return int(entity.get_subscription_count())

    def write(self, payload: bytes, stamp_ns: int | None = None) -> bool:
        """Send one message; rclpy stamps it itself, with the present time.

        Raises:
            BackendError: As :meth:`rosplc.ros.backend.Publisher.write`, and ROS002 if the middleware
                refuses.
        """
        size = len(payload)
        if size < 4 or payload[0] != 0 or payload[1] > 1:  # the middleware would send anything
            with self._lock:
                self._rejected += 1
            raise BackendError(
                "ROS008", f"a message was not sent on {self.topic}: it has no header of plain CDR"
            )
        data = bytes(payload) + bytes(-size % 4)
        with self._lock:
            if self.closed:
                raise BackendError("ROS009", f"the publisher of {self.topic} is closed")
            try:
                self.entity.publish(data)
            except InvalidHandle as error:  # the node was destroyed by its owner
                raise BackendError("ROS009", f"the publisher of {self.topic} is closed") from error
            except RuntimeError as error:
                raise BackendError(
                    "ROS002", f"a message was not sent on {self.topic}: {str(error).strip()}"
                ) from error
            self._messages += 1
            self._last_ns = time.time_ns()
        return True
