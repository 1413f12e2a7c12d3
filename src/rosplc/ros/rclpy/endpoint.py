"""The bridge's own endpoints on rclpy: bytes in, bytes out, how they fare, and the middleware's events.

The hot paths are :meth:`RclpySubscription.receive` and :meth:`RclpyPublisher.write`. Which events there are
depends on the version of rclpy and on the middleware, and one that is not supported keeps an endpoint from
being created. So the events are asked for from many to few.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Iterator
from typing import Any, Literal

from rclpy.duration import Duration
from rclpy.exceptions import InvalidHandle
from rclpy.qos import DurabilityPolicy, HistoryPolicy, LivelinessPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription as NativeSubscription

from rosplc.errors import BackendError
from rosplc.ros._base import BaseEndpoint, BasePublisher, BaseSubscription, is_cdr
from rosplc.ros.backend import EndpointInfo, Qos
from rosplc.ros.names import join

_INFINITE_NS = 2**31 * 10**9  # DDS's infinite seconds; what middlewares make of it in rmw is longer
# What rmw_dds_common reports for participants that are no ROS nodes.
_NAMELESS = {"", "_NODE_NAME_UNKNOWN_", "_CREATED_BY_BARE_DDS_APP_"}


def profile(qos: Qos) -> Any:
    """Return rclpy's profile for an endpoint."""
    reliable, transient = qos.reliability == "reliable", qos.durability == "transient_local"
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=qos.depth,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if transient else DurabilityPolicy.VOLATILE,
        **({"lifespan": Duration(nanoseconds=qos.lifespan_ns)} if qos.lifespan_ns else {}),
    )


def settings(found: Any) -> Qos:
    """Return the settings of a profile that discovery shows; the depth is not announced and is 1."""
    best_effort = found.reliability == ReliabilityPolicy.BEST_EFFORT
    transient = found.durability == DurabilityPolicy.TRANSIENT_LOCAL
    return Qos(
        "best_effort" if best_effort else "reliable",
        "transient_local" if transient else "volatile",
        1,
        deadline_ns=_bounded(found.deadline),
        lease_ns=_bounded(found.liveliness_lease_duration),
    )


def _bounded(duration: Any) -> int:
    """Return a duration in ns; 0 if it is infinite (as discovery shows it) or unspecified (as here)."""
    ns = int(duration.nanoseconds)
    return ns if 0 < ns < _INFINITE_NS else 0


def read_peers(infos: Iterable[Any], topic: str, direction: Literal["in", "out"]) -> list[EndpointInfo]:
    """Return what ``get_publishers_info_by_topic`` or ``get_subscriptions_info_by_topic`` gave."""
    return [
        EndpointInfo(
            topic,
            info.topic_type,
            direction,
            "" if info.node_name in _NAMELESS else join(info.node_namespace, info.node_name),
            settings(info.qos_profile),
            _hash(info),
            _obstacles(info.qos_profile) if direction == "in" else (),
        )
        for info in infos
    ]


def _hash(info: Any) -> str:
    text = str(getattr(info, "topic_type_hash", ""))  # Humble has none
    return text if text.startswith("RIHS") else ""  # INVALID, if the peer announces none


def _obstacles(requested: Any) -> tuple[str, ...]:
    # rclpy's own qos_check_compatible takes unspecified durations for shorter ones than infinite.
    manual = requested.liveliness == LivelinessPolicy.MANUAL_BY_TOPIC
    return ("the subscriber wants manual liveliness",) if manual else ()


try:
    from rclpy.event_handler import (
        PublisherEventCallbacks,
        SubscriptionEventCallbacks,
        UnsupportedEventTypeError,
    )
except ImportError:  # ROS 2 Humble
    from rclpy.qos_event import PublisherEventCallbacks, SubscriptionEventCallbacks, UnsupportedEventTypeError


_GIVES_STAMPS = hasattr(NativeSubscription, "CallbackType")  # since ROS 2 Iron
_BATCH = 64  # messages taken from one subscription before the others get their turn
_EVENTS = (
    ("incompatible_qos", "incompatible_type", "message_lost"),
    ("incompatible_qos", "incompatible_type"),
    (),
)


class RclpyEndpointBase(BaseEndpoint):
    """What all endpoints have in common; the topic is the one before remapping by ROS arguments."""

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self.entity: Any = None  # set by the backend; a message may come before
        self.lost = 0  # set by the middleware's event

    def _matched(self) -> int:
        try:
            return 0 if self.entity is None else self._count(self.entity)
        except InvalidHandle:  # destroyed at this moment
            return 0

    def _count(self, entity: Any) -> int:
        raise NotImplementedError

    def make(self, node: Any, *details: Any, **others: Any) -> Any:
        """Create rclpy's entity; the details are type, name and settings."""
        raise NotImplementedError

    def _losses(self) -> int:
        return self.lost

    def _failed_to_send(self, error: RuntimeError) -> BackendError:
        if isinstance(error, InvalidHandle):  # the node was destroyed by its owner
            return self._closed()
        return BackendError("ROS002", f"a message was not sent on {self.topic}: {str(error).strip()}")


class RclpySubscription(BaseSubscription, RclpyEndpointBase):
    """A raw subscription; see :class:`rosplc.ros.backend.Subscription`."""

    def make(self, node: Any, *details: Any, **others: Any) -> Any:
        """Create rclpy's subscription."""
        kind, name, settings = details
        callback = self.receive if _GIVES_STAMPS else self.receive_plain
        return node.create_subscription(kind, name, callback, settings, raw=True, **others)

    def _count(self, entity: Any) -> int:
        count = getattr(entity, "get_publisher_count", None)
        # rclpy counts no matched publishers before ROS 2 Iron: those that fit are counted.
        return int(count()) if count is not None else int(self._node.fitting(self))

    def receive(self, payload: bytes, info: dict[str, Any]) -> None:
        """Deliver a message; the callback where rclpy gives its information too."""
        self._receive(payload, info["source_timestamp"], stamped=True)

    def receive_plain(self, payload: bytes) -> None:
        """Deliver a message; the callback for rclpy versions that give no stamp with it."""
        self._receive(payload, 0, stamped=False)

    def _receive(self, payload: bytes, stamp_ns: int, *, stamped: bool) -> None:
        """Deliver a message and those that wait behind it."""
        # The executor builds a wait set over all entities of the node for each message it takes. What else
        # has arrived is taken here at once, as the executor's own ``_take_subscription`` does.
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
                    self.reject(error)
                    continue
                if taken is None:
                    return
                # All stamps of a topic are of one kind, though these messages would have theirs.
                self._deliver(taken[0], taken[1]["source_timestamp"] if stamped else 0)

    def _deliver(self, payload: bytes, stamp_ns: int) -> None:
        if self.closed:
            return
        if is_cdr(payload):
            super()._deliver(payload, stamp_ns)
        else:
            self.reject("it has no header of plain CDR")


class RclpyPublisher(BasePublisher, RclpyEndpointBase):
    """A publisher of serialized messages; see :class:`rosplc.ros.backend.Publisher`."""

    def make(self, node: Any, *details: Any, **others: Any) -> Any:
        """Create rclpy's publisher."""
        return node.create_publisher(*details, **others)

    def _count(self, entity: Any) -> int:
        return int(entity.get_subscription_count())

    def write(self, payload: bytes, stamp_ns: int | None = None) -> bool:
        """Send one message, stamped by rclpy with the present time; ROS002 if the middleware refuses it."""
        data = self._checked(payload)  # the middleware would send anything
        with self._lock:
            if self.closed:
                raise self._closed()
            try:
                self.entity.publish(data)
            except RuntimeError as error:
                raise self._failed_to_send(error) from error
            self._messages += 1
            self._last_ns = self._clock.time_ns()
        return True


Endpoint = RclpySubscription | RclpyPublisher


def create(make: Callable[..., Any], endpoint: Endpoint, look: Callable[[Endpoint], None]) -> Any:
    """Create an entity with as many events as the middleware supports; raises what rclpy raises."""
    # ``make`` takes ``event_callbacks`` alone; ``look`` is called when a peer does not fit.
    for callbacks in _callbacks(endpoint, look):
        try:
            return make(event_callbacks=callbacks)
        except UnsupportedEventTypeError:
            continue
    raise AssertionError("an endpoint without events needs no support")


def _callbacks(endpoint: Endpoint, look: Callable[[Endpoint], None]) -> Iterator[Any]:
    def misfit(_event: Any) -> None:
        look(endpoint)

    def lost(event: Any) -> None:
        endpoint.lost = event.total_count

    kind = SubscriptionEventCallbacks if endpoint.direction == "in" else PublisherEventCallbacks
    known = inspect.signature(kind.__init__).parameters
    handlers = {"incompatible_qos": misfit, "incompatible_type": misfit, "message_lost": lost}
    for names in _EVENTS:
        # Without the default callbacks: they log through rcl what the status shows better.
        yield kind(use_default_callbacks=False, **{name: handlers[name] for name in names if name in known})
