"""The bridge's own endpoints on rclpy: bytes in, bytes out, their state, and the middleware's events.

The hot paths are :meth:`RclpySubscription.take` and :meth:`RclpyPublisher.write`. The available events
depend on the version of rclpy and on the middleware, and an unsupported event prevents an endpoint from
being created. Therefore, creation is tried with fewer and fewer events.
"""

from __future__ import annotations

import importlib
import inspect
import operator
import threading
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from typing import Any, Literal

from rclpy.duration import Duration
from rclpy.exceptions import InvalidHandle
from rclpy.qos import DurabilityPolicy, HistoryPolicy, LivelinessPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message, serialize_message
from rclpy.subscription import Subscription as NativeSubscription

from rosplc.errors import BackendError
from rosplc.model import TypeStore
from rosplc.model.types import ArrayType, FieldType, MessageType, PrimitiveType, SequenceType, StringType
from rosplc.ros._base import (
    BaseClient,
    BaseEndpoint,
    BasePublisher,
    BaseSubscription,
    KeepingServer,
    is_cdr,
    is_service,
)
from rosplc.ros.backend import EndpointInfo, Qos, Reply
from rosplc.ros.names import join, service_type_name

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
    """Return the settings of a discovered profile; the depth is not announced and is set to 1."""
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
    """Return a duration in ns; 0 if it is infinite (in discovered profiles) or unspecified (in our own)."""
    ns = int(duration.nanoseconds)
    return ns if 0 < ns < _INFINITE_NS else 0


def read_peers(infos: Iterable[Any], topic: str, direction: Literal["in", "out"]) -> list[EndpointInfo]:
    """Convert the result of ``get_publishers_info_by_topic`` or ``get_subscriptions_info_by_topic``."""
    return [
        EndpointInfo(
            topic,
            service_type_name(info.topic_type),
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
    return ("the subscriber requests manual liveliness",) if manual else ()


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
    """The common base of all endpoints; the topic is the name before remapping by ROS arguments."""

    native: str  # what rclpy calls its entity

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

    def details(self) -> dict[str, Any]:
        """Return the arguments for creating rclpy's entity, besides type, name and settings."""
        return {}

    def _losses(self) -> int:
        return self.lost

    def _failed_to_send(self, error: RuntimeError) -> BackendError:
        if isinstance(error, InvalidHandle):  # the node was destroyed by its owner
            return self._closed()
        return BackendError("ROS002", f"a message was not sent on {self.topic}: {str(error).strip()}")


class RclpySubscription(BaseSubscription, RclpyEndpointBase):
    """A raw subscription; see :class:`rosplc.ros.backend.Subscription`."""

    native = "subscription"

    def details(self) -> dict[str, Any]:
        """Return the callback, with the parameters of this rclpy version, and ``raw=True``."""
        callback = self.receive if _GIVES_STAMPS else self.receive_bytes
        return {"callback": callback, "raw": True}

    def _count(self, entity: Any) -> int:
        count = getattr(entity, "get_publisher_count", None)
        # rclpy counts no matched publishers before ROS 2 Iron: those that fit are counted.
        return int(count()) if count is not None else int(self._node.fitting(self))

    def receive(self, payload: bytes, info: dict[str, Any]) -> None:
        """Deliver a message taken by the executor."""
        with self._lock:
            self._deliver(payload, info["source_timestamp"])
            self.take()  # an executor builds a wait set over all entities of the node for the next one

    def receive_bytes(self, payload: bytes) -> None:
        """Deliver a message without a stamp, as before ROS 2 Iron."""
        self.receive(payload, {"source_timestamp": 0})

    def take(self) -> bool:
        """Deliver what has arrived, as rclpy's executor would; return False after the end."""
        with self._lock:
            for _ in range(_BATCH):
                entity = self.entity
                if self.closed or entity is None:
                    return False
                try:
                    with entity.handle:
                        taken = entity.handle.take_message(entity.msg_type, True)
                except InvalidHandle:
                    return False
                except Exception as error:
                    self.reject(error)
                    continue
                if taken is None:
                    break
                # All stamps of a topic are of one kind: where the executor gives none, none are taken.
                self._deliver(taken[0], taken[1]["source_timestamp"] if _GIVES_STAMPS else 0)
            return True

    def _deliver(self, payload: bytes, stamp_ns: int) -> None:
        if self.closed:
            return
        if is_cdr(payload):
            super()._deliver(payload, stamp_ns)
        else:
            self.reject("no plain CDR header")


class RclpyPublisher(BasePublisher, RclpyEndpointBase):
    """A publisher of serialized messages; see :class:`rosplc.ros.backend.Publisher`."""

    native = "publisher"

    def _count(self, entity: Any) -> int:
        return int(entity.get_subscription_count())

    def _emit(self, payload: bytes, stamp_ns: int) -> bool:
        # rclpy stamps it with the present time. The middleware would send anything: hence the check before.
        try:
            self.entity.publish(payload)
        except RuntimeError as error:
            raise self._failed_to_send(error) from error
        return True


Endpoint = RclpySubscription | RclpyPublisher


def create(make: Callable[..., Any], endpoint: Endpoint, look: Callable[[Endpoint], None]) -> Any:
    """Create an entity with as many events as the middleware supports; raises as rclpy does."""
    # ``make`` takes ``event_callbacks`` alone; ``look`` is called when a peer does not fit.
    for callbacks in _callbacks(endpoint, look):
        try:
            return make(event_callbacks=callbacks)
        except UnsupportedEventTypeError:
            continue
    raise AssertionError("rclpy reports an unsupported event, though none was requested")


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


class _Service(RclpyEndpointBase):
    serves = True

    def _converted(self, payload: bytes, part: str) -> Any:
        """Return a message as an object; ROS008 if the bytes are not of the type."""
        try:
            return deserialize_message(payload, getattr(self.entity.srv_type, part))
        except Exception as error:
            raise self._refusal(str(error).strip() or type(error).__name__) from error


class RclpyServer(_Service, KeepingServer):
    """A service server; see :class:`rosplc.ros.backend.ServiceServer`.

    rclpy sends what a server's callback returns; a callback that waits would block its callback group.
    Therefore, the callback returns the request itself, and the arguments that the executor then passes to
    ``send_response``, including the request's header, are kept until the answer arrives.
    """

    native = "service"

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self._attached = threading.Event()

    def attach(self, entity: Any) -> None:
        """Take over rclpy's server."""
        self._respond, entity.send_response = entity.send_response, self._receive
        self._attached.set()

    def details(self) -> dict[str, Any]:
        """Return the callback."""
        return {"callback": self.hold}

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
    """A service client; see :class:`rosplc.ros.backend.ServiceClient`."""

    native = "client"

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self._futures: dict[int, Any] = {}
        self._sending = threading.Lock()

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
        """End the calls whose servers are gone, which rclpy does not report."""
        if self.calls and not self.closed:
            self.end_orphans(self._receivers())

    def _withdraw(self, number: int) -> None:
        future = self._futures.pop(number, None)
        if future is not None:
            self.entity.remove_pending_request(future)

    def gone(self, *servers: Any) -> None:
        """End the calls that only these servers have received."""
        super().gone(*servers)
        for number in tuple(self._futures.keys() - self.calls.keys()):
            self._withdraw(number)

    def forget(self, number: int) -> None:
        """Stop waiting for a call."""
        super().forget(number)
        self._withdraw(number)


# How rosidl_generator_py writes a field's type (resource/_msg.py.em); `char` is uint8 there.
_NAMES = {"bool": "boolean", "byte": "octet", "char": "uint8", "float32": "float", "float64": "double"}


# Where a class of an action keeps those that rosidl derives.
_DERIVED = {
    "SendGoal": "Impl.SendGoalService",
    "GetResult": "Impl.GetResultService",
    "FeedbackMessage": "Impl.FeedbackMessage",
}
_WORDS = {"msg": "message", "srv": "service", "action": "action"}


def message_class(type_name: str) -> Any:
    """Import the class of a message, service or part (``…/Name_Request``); ROS011 if not installed."""
    package, kind, name = type_name.split("/")
    try:
        module = importlib.import_module(f"{package}.{kind}")
    except Exception as error:  # whatever a half-installed package raises
        raise BackendError(
            "ROS011",
            f"the Python package {package}, which contains {type_name}, cannot be imported: {error}",
            remedy=f"Install ros-DISTRO-{package.replace('_', '-')}, or build it with colcon, and source its "
            "setup.bash before starting the bridge.",
        ) from error
    base, *parts = [name] if kind == "msg" else name.split("_")
    if not hasattr(module, base):
        what = f"the installed package {package} has no {_WORDS[kind]} {base} ({module.__file__})"
        raise BackendError("ROS011", what)
    path = ".".join([base, *(_DERIVED.get(part, part) for part in parts)])
    try:
        found = operator.attrgetter(path)(module)
    except AttributeError:
        found = None
    if not hasattr(found, "get_fields_and_field_types") and not hasattr(found, "Request"):
        what = f"the package {package} that Python finds is not a ROS 2 package ({module.__file__})"
        remedy = "Keep ROS 1's packages out of PYTHONPATH, and source the setup.bash of ROS 2 last."
        raise BackendError("ROS011", what, remedy=remedy)
    return found


def field_text(kind: FieldType) -> str:
    """Return a field's type in the notation of a generated class's ``get_fields_and_field_types``."""
    if isinstance(kind, SequenceType):
        bound = "" if kind.bound is None else f", {kind.bound}"
        return f"sequence<{field_text(kind.element)}{bound}>"
    if isinstance(kind, ArrayType):
        return f"{field_text(kind.element)}[{kind.length}]"
    if isinstance(kind, StringType):
        return "string" if kind.bound is None else f"string<{kind.bound}>"
    if isinstance(kind, PrimitiveType):
        return _NAMES.get(kind.name, kind.name)
    package, _, name = kind.name.split("/")
    return f"{package}/{name}"


class MessageClasses:
    """The installed classes of the types in a store, each compared once with the bridge's definition.

    The middleware uses the class's type support: if the definitions differed, values would be in the wrong
    fields.
    """

    def __init__(self, store: TypeStore) -> None:
        self._store = store
        self._found: dict[str, Any] = {}

    def __getitem__(self, type_name: str) -> Any:
        """Return a type's class; TYP001, ROS011 if it is not installed, ROS012 if its fields differ."""
        if type_name not in self._found:
            parts = ("_Request", "_Response") if is_service(type_name) else ("",)
            for part in parts:
                self._compare(self._store[type_name + part], set())
            self._found[type_name] = message_class(type_name)
        return self._found[type_name]

    def _compare(self, message: MessageType, seen: set[str]) -> None:
        if message.name in seen or message.name in self._found:
            return
        seen.add(message.name)
        theirs = list(message_class(message.name).get_fields_and_field_types().items())
        ours = [(field.name, field_text(field.type)) for field in message.fields]
        if ours != theirs:
            what = f"{message.name} differs between the installed package and the bridge's definitions"
            difference = _first_difference(ours, theirs)
            raise BackendError("ROS012", f"{what} ({self._store.distro}): {difference}")
        for name in message.needs:
            self._compare(self._store[name], seen)


def _first_difference(ours: list[tuple[str, str]], theirs: list[tuple[str, str]]) -> str:
    for place, (one, other) in enumerate(zip(ours, theirs, strict=False), 1):
        if one != other:
            return f"field {place}: `{other[1]} {other[0]}` in the package, `{one[1]} {one[0]}` in the bridge"
    more, where = (theirs, "in the package") if len(theirs) > len(ours) else (ours, "in the bridge")
    name, kind = more[min(len(ours), len(theirs))]
    return f"`{kind} {name}` exists only {where}"
