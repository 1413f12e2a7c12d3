"""The bridge's own endpoints on Zenoh; ``arrived``, ``deliver_next`` and ``write`` are the hot paths."""

from __future__ import annotations

import threading
from collections import OrderedDict, deque
from typing import Any

import zenoh
import zenoh.ext

from rosplc.ros._base import BaseEndpoint, BasePublisher, Problem, QueuedSubscription, is_cdr
from rosplc.ros.backend import OnMessage
from rosplc.ros.zenoh.keys import Attachment, Entity, gid_of, pack, topic_key, unpack

_HEARTBEAT_S = 0.5  # as rmw_zenoh's reliable and transient_local publishers
_SENDERS = 1024  # publishers whose sequence numbers a subscription remembers
_MOST_LOST = 1 << 20  # a larger step in the sequence is no loss but nonsense, and counting begins again


class Endpoint(BaseEndpoint):
    """The common base of both directions; :meth:`declare` sets the session's id."""

    def __init__(self, node: Any, entity: Entity) -> None:
        assert entity.qos is not None
        super().__init__(node, entity.topic, entity.type_name, entity.qos, entity.type_hash)
        self.entity = entity
        self._key = topic_key(entity.domain, entity.topic, entity.type_name, entity.type_hash)
        self._declared: list[Any] = []  # in the order in which they are withdrawn

    def _peers(self) -> int:
        ours = self.type_name, self.type_hash  # a message's key has both
        return sum((one.type_name, one.type_hash) == ours for one in self._node.others(self.entity))

    def _matched(self) -> int:
        return self._peers() if self._connected() else 0

    def _connected(self) -> bool:
        """Return whether messages are transferred, and not only tokens."""
        return True

    def _problem(self) -> Problem:
        code, reason = super()._problem()
        if not reason and self._peers() and not self._connected():
            reason = "Zenoh is still connecting"
        return code, reason

    def declare(self, session: Any, entity: Entity) -> None:
        """Declare the endpoint first to Zenoh, then to ROS: a node that sees its token can reach it."""
        # Not under the lock: the library calls back from other threads while it declares, and waits.
        self.entity = entity
        declared = self._declare(session)
        declared.insert(0, session.liveliness().declare_token(entity.token))
        with self._lock:
            if not self.closed:
                self._declared = declared
                return
        self._withdraw(declared)

    def _declare(self, session: Any) -> list[Any]:
        raise NotImplementedError

    def close(self) -> None:
        """Withdraw the declarations; a second call does nothing."""
        super().close()
        with self._lock:
            declared, self._declared = self._declared, []
        self._withdraw(declared)

    def _withdraw(self, declared: list[Any]) -> None:
        for one in declared:
            try:
                one.undeclare()
            except zenoh.ZError as error:  # the session is gone already
                self._node.logger.debug("%s: %s", self.topic, error)


def read(payload: Any, attachment: Any) -> tuple[bytes, Attachment]:
    """Return payload and attachment; ValueError if they are not from a ROS 2 node."""
    if payload is None or attachment is None:
        raise ValueError("the payload or the attachment is missing; every ROS 2 message has both")
    data: bytes = payload.to_bytes()
    if not is_cdr(data):
        raise ValueError("no plain CDR header")
    return data, unpack(attachment.to_bytes())


class Sender(Endpoint):
    """A sending endpoint; ``_route`` shows whether there are receivers."""

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self._route: Any = None
        self._asking = threading.Lock()  # the library's objects refuse to be withdrawn while they are asked
        self._gid = b""

    def _connected(self) -> bool:
        try:
            with self._asking:
                # Tokens overtake the declarations that open the way; before, the library sends nothing.
                return self._route is not None and bool(self._route.matching_status.matching)
        except zenoh.ZError:
            return False  # it is being closed

    def _withdraw(self, declared: list[Any]) -> None:
        with self._asking:
            self._route = None
        super()._withdraw(declared)


class ZenohSubscription(QueuedSubscription, Endpoint):
    """A subscription; see :class:`rosplc.ros.backend.Subscription`.

    Threads of the library fill a queue of ``depth``, dropping the oldest; the receive thread empties it.
    """

    def __init__(self, on_message: OnMessage, node: Any, entity: Entity) -> None:
        super().__init__(on_message, node, entity)
        self._sequences: OrderedDict[bytes, int] = OrderedDict()

    def _declare(self, session: Any) -> list[Any]:
        # "Direct": otherwise the library starts a thread for every subscriber.
        receive = zenoh.handlers.Callback(self.arrived, None, indirect=False)
        if self.qos.durability == "volatile":
            return [session.declare_subscriber(self._key, receive)]
        reliable = self.qos.reliability == "reliable"
        recovery = zenoh.ext.RecoveryConfig(periodic_queries=None, heartbeat=True) if reliable else None
        history = zenoh.ext.HistoryConfig(detect_late_publishers=True, max_samples=self.qos.depth)
        return [
            zenoh.ext.declare_advanced_subscriber(
                session, self._key, receive, history=history, recovery=recovery, subscriber_detection=True
            )
        ]

    def arrived(self, sample: Any) -> None:
        """Queue a message; called by threads of the library, so no exception may escape."""
        try:
            put = sample.kind == zenoh.SampleKind.PUT
            payload, (sequence, stamp_ns, gid) = read(sample.payload if put else None, sample.attachment)
        except Exception as error:
            self.reject(error)
            return
        with self._lock:
            if self.closed:
                return
            self._count_missing(gid, sequence)
            if not self._put(payload, stamp_ns):
                return  # the receive thread knows of as many messages as wait
        self._node.wake(self)

    def _count_missing(self, gid: bytes, sequence: int) -> None:
        """Count messages of a publisher that did not arrive; a sender drops messages if a link is full."""
        last = self._sequences.pop(gid, sequence)
        step = sequence - last
        if abs(step) > _MOST_LOST:
            last = sequence
        elif step > 1:
            self._dropped += step - 1
        self._sequences[gid] = max(sequence, last)
        if len(self._sequences) > _SENDERS:
            self._sequences.popitem(last=False)


class ZenohPublisher(BasePublisher, Sender):
    """A publisher; see :class:`rosplc.ros.backend.Publisher`.

    If a peer's link is full, Zenoh drops messages without a report: ``dropped`` counts only
    messages that the library refused. The receiver detects the gap in the numbers.
    """

    def __init__(self, node: Any, entity: Entity) -> None:
        super().__init__(node, entity)
        self._zenoh: Any = None
        self._sequence = 0
        latched = self.qos.depth if self.qos.durability == "transient_local" else 0
        self._early: deque[tuple[bytes, int]] = deque(maxlen=latched)  # written before there is a session

    def _declare(self, session: Any) -> list[Any]:
        reliable = self.qos.reliability == "reliable"
        how: dict[str, Any] = {
            # Never BLOCK, which rmw_zenoh uses for keep_all alone: one peer would stop every topic.
            "congestion_control": zenoh.CongestionControl.DROP,
            "reliability": zenoh.Reliability.RELIABLE if reliable else zenoh.Reliability.BEST_EFFORT,
        }
        publisher: Any
        if self.qos.durability == "volatile":
            publisher = route = session.declare_publisher(self._key, **how)
        else:
            route = session.declare_publisher(self._key)
            detection = zenoh.ext.MissDetectionConfig(heartbeat=None, sporadic_heartbeat=_HEARTBEAT_S)
            publisher = zenoh.ext.declare_advanced_publisher(
                session,
                self._key,
                cache=zenoh.ext.CacheConfig(self.qos.depth),
                publisher_detection=True,
                sample_miss_detection=detection if reliable else None,
                **how,
            )
        with self._lock:  # the route: an "advanced" publisher does not know whether there is a subscriber
            self._zenoh, self._route, self._gid = publisher, route, gid_of(self.entity.token)
            while self._early:
                self._dropped += not self._emit(*self._early.popleft())
        return [publisher] if publisher is route else [publisher, route]

    def _emit(self, payload: bytes, stamp_ns: int) -> bool:
        if self._zenoh is None:
            self._early.append((payload, stamp_ns))
            return True
        self._sequence += 1
        try:
            self._zenoh.put(payload, attachment=pack(self._sequence, stamp_ns, self._gid))
        except zenoh.ZError:
            return False
        return True
