"""The common parts of all backends: node, endpoints, counts, delivery, calls, and mismatch diagnosis."""

from __future__ import annotations

import itertools
import logging
import os
import threading
from collections import OrderedDict, deque
from collections.abc import Callable, Collection, Hashable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal, TypeVar

from rosplc.clock import SYSTEM, Clock
from rosplc.errors import BackendError
from rosplc.harmless import one_line
from rosplc.model import TypeStore
from rosplc.reasons import Reason
from rosplc.ros import backend
from rosplc.ros.names import join, resolve_topic, validate_namespace, validate_node_name

MOST_REASONS = 8  # Peers of one topic that a reason names; the others are counted.
LONGEST_REASON = 500  # Characters about one peer.
MOST_REMEMBERED = 1000  # Reasons that a backend remembers to have logged; further ones are not logged.
MOST_CALLERS = 10_000  # Callers of a service that wait for a response; the bridge's own limits are far below.

Problem = tuple[str, str]  # An error code, or an empty text, and words.

SETTLE_NS = 1_000_000_000  # matching may take a moment; nothing is called a mismatch before
_PADDING = (b"", b"\0", b"\0\0", b"\0\0\0")
_B = TypeVar("_B")


@dataclass(frozen=True)
class Context:
    """The arguments for opening a node; see :func:`rosplc.ros.open_backend`."""

    store: TypeStore
    node_name: str
    namespace: str = "/"
    domain: int | None = None
    remap: Mapping[str, str] = field(default_factory=dict)
    environment: Mapping[str, str] = field(default_factory=lambda: os.environ)
    options: Mapping[str, object] = field(default_factory=dict)
    clock: Clock = SYSTEM


def opener(make: Callable[[Context], _B]) -> Callable[..., _B]:
    """Return a backend module's ``open_backend``, with the arguments of :func:`rosplc.ros.open_backend`."""

    def open_backend(store: TypeStore, node_name: str, *places: Any, **others: Any) -> _B:
        given = {key: value for key, value in others.items() if value is not None}
        return make(Context(store, node_name, *places, **given))

    return open_backend


def domain_number(domain: int | None, environment: Mapping[str, str], most: int | None = None) -> int | None:
    """Return the ROS domain: the given one, else ``ROS_DOMAIN_ID``, else None; ROS010 above ``most``."""
    source = "ros.domain" if domain is not None else "ROS_DOMAIN_ID"
    text = str(domain) if domain is not None else environment.get("ROS_DOMAIN_ID") or ""
    if not text:
        return None
    if not text.isascii() or not text.isdigit() or len(text) > 9 or (most is not None and int(text) > most):
        to = "of 0 or greater" if most is None else f"from 0 to {most}"
        raise BackendError("ROS010", f"{source} is {text[:80]!r}; use an integer {to}", where=source)
    return int(text)


def listed(texts: Iterable[str]) -> str:
    """Join the problems of several peers into one line of bounded length: peers choose their own names."""
    unique = list(dict.fromkeys(texts))
    lines = map(one_line, unique[:MOST_REASONS])
    shown = [line if len(line) <= LONGEST_REASON else f"{line[: LONGEST_REASON - 1]}…" for line in lines]
    if len(unique) > MOST_REASONS:
        shown.append(f"and {len(unique) - MOST_REASONS} more")
    return "; ".join(shown)


class LogOnce:
    """Remembers what has been logged, so that a graph with invented names fills neither memory nor log."""

    def __init__(self) -> None:
        self._known: set[Hashable] = set()

    def first(self, what: Hashable) -> bool:
        """Return whether to log this now."""
        if what in self._known or len(self._known) >= MOST_REMEMBERED:
            return False
        self._known.add(what)
        return True


def graph_info(
    nodes: Iterable[str],
    endpoints: Iterable[backend.EndpointInfo],
    services: Iterable[backend.EndpointInfo] = (),
) -> backend.GraphInfo:
    """Return the sorted graph of these nodes, endpoints and service endpoints."""
    found, calls = (
        tuple(sorted(each, key=lambda info: (info.topic, info.direction, info.node)))
        for each in (endpoints, services)
    )
    topics: dict[str, set[str]] = {}
    for one in found:
        topics.setdefault(one.topic, set()).add(one.type_name)
    types = {topic: tuple(sorted(each)) for topic, each in topics.items()}
    return backend.GraphInfo(tuple(sorted(set(nodes))), found, types, calls)


def is_cdr(payload: bytes) -> bool:
    """Return whether the bytes begin with a plain CDR header."""
    return len(payload) >= 4 and payload[0] == 0 and payload[1] <= 1


def differs(ours: str, theirs: str) -> bool:
    """Return whether two announced type hashes prove different definitions; an empty one proves nothing."""
    return bool(ours and theirs and ours != theirs)


def is_service(type_name: str) -> bool:
    """Return whether a type is a service type, including those derived from an action."""
    derived = type_name.endswith(("_SendGoal", "_GetResult"))
    part = type_name.endswith(("_Request", "_Response"))
    return not part and ("/srv/" in type_name or ("/action/" in type_name and derived))


def describe(peer: backend.EndpointInfo, name: str = "") -> str:
    """Return what a peer (``name``, or its node) does: ``node /talker publishes /chatter as …``."""
    service = is_service(peer.type_name)
    verbs = ("serves", "calls") if service else ("subscribes to", "publishes")
    return f"{name or f'node {peer.node}'} {verbs[peer.direction == 'out']} {peer.topic} as {peer.type_name}"


def explain(
    peer: backend.EndpointInfo,
    ours: BaseEndpoint | backend.EndpointInfo,
    name: str = "",
    *,
    matched: bool = False,
) -> Problem | None:
    """Return why a peer and our endpoint of the other direction do not match; None if not known."""
    # The peer is called ``name``, or by its node. What the middleware has ``matched`` has settings that fit.
    does = describe(peer, name)
    if peer.type_name != ours.type_name:
        return "ROS003", f"{does}, but the local type is {ours.type_name}"
    if differs(ours.type_hash, peer.type_hash):
        here, there = map(_short, (ours.type_hash, peer.type_hash))
        return "ROS003", f"{does} with another definition (type hash {there}, locally {here})"
    if matched:
        return None
    offered, requested = (peer.qos, ours.qos) if peer.direction == "out" else (ours.qos, peer.qos)
    problems = [*filter(None, [backend.incompatibility(offered, requested)]), *peer.obstacles]
    return ("ROS004", f"{does}, but {'; '.join(problems)}") if problems else None


def _short(type_hash: str) -> str:
    return f"{type_hash[7:15]}…" if type_hash.startswith("RIHS01_") else "none (Humble)"


def queue_of(qos: backend.Qos) -> backend.Qos:
    """Return a service's settings, with room for what arrives between two polls of the receive thread."""
    # The profile's depth of 10 would lose the rest of a burst without a trace; peers do not see the depth.
    return replace(qos, depth=max(qos.depth, 1000))


class BaseEndpoint:
    """The counts and the closing of an endpoint; ``type_hash`` is empty if there is none to compare."""

    direction: Literal["in", "out"]
    peer_does: str  # what a node does that this endpoint exchanges messages with
    kind: str
    serves = False  # whether it belongs to a service
    sink: backend.Sink = None  # what passes messages on without Python

    def __init__(self, node: Any, topic: str, type_name: str, qos: backend.Qos, type_hash: str = "") -> None:
        self.topic, self.type_name, self.qos, self.type_hash = topic, type_name, qos, type_hash
        self.closed = False
        self._node = node
        self._clock: Clock = node.clock
        self._lock = threading.RLock()  # re-entrant: on_message may close its own subscription
        self._delivering = threading.RLock()  # held while something is delivered without the lock
        self._messages = self._dropped = self._rejected = self._failed = self._last_ns = 0

    @property
    def matched(self) -> int:
        """Number of peers that exchange messages with this endpoint."""
        return 0 if self.closed else self._matched()

    def _matched(self) -> int:
        raise NotImplementedError

    def _problem(self) -> Problem:
        """Return what prevents peers from matching; empty texts if there is no problem."""
        found: Problem = self._node.diagnose(self)
        return found

    def _losses(self) -> int:
        """Return the number of messages that the middleware reported as lost."""
        return 0

    def _late(self) -> int:
        """Return how often a promised deadline was missed."""
        return 0

    def _unfit(self) -> int:
        """Return the number of messages that the middleware refused because they do not fit the type."""
        return 0

    def _asked(self) -> tuple[str, str, int, int, int]:
        """Return what only the middleware knows: problem, number of peers, losses, missed deadlines."""
        return (*self._problem(), self.matched, self._losses(), self._late())

    def status(self) -> backend.EndpointStatus:
        """Return the current state."""
        code, reason, matched, losses, late = ("ROS009", "closed", 0, 0, 0) if self.closed else self._asked()
        messages, last_ns = self._messages, self._last_ns
        if (sink := self.sink) is not None and sink.messages:
            messages += sink.messages
            last_ns = max(last_ns, self._clock.time_ns() - self._clock.monotonic_ns() + sink.last_ns)
        return backend.EndpointStatus(
            self.topic, self.type_name, self.direction, matched, messages, self._dropped + losses,
            self._rejected + self._unfit(), self._failed, last_ns, reason, code, late,
        )  # fmt: skip

    def reject(self, error: object) -> None:
        """Count a message that is not a valid ROS message."""
        with self._lock:
            self._rejected += 1
            first = self._rejected == 1
        level = logging.WARNING if first else logging.DEBUG
        # As text: a log that keeps an exception would keep what was received, such as a query of Zenoh.
        self._node.logger.log(level, "%s: a message was refused: %s", self.topic, str(error))

    def _hand_over(self, receiver: Callable[..., object], *arguments: object) -> None:
        """Call the receiver; its exceptions are caught."""
        try:
            receiver(*arguments)
        except Exception:
            self._failed += 1
            if self._failed == 1:
                self._node.logger.exception("%s: processing a received message failed", self.topic)

    def _checked(self, payload: bytes) -> bytes:
        """Return a message padded to whole words; ROS008 if it has no plain CDR header."""
        if not is_cdr(payload):
            raise self._refusal("no plain CDR header")
        return bytes(payload) + _PADDING[-len(payload) & 3]

    def _refusal(self, why: str) -> BackendError:
        with self._lock:
            self._rejected += 1
        return BackendError("ROS008", f"a message was not sent on {self.topic}: {why}")

    def _closed(self) -> BackendError:
        return BackendError("ROS009", f"the {self.kind} of {self.topic} is closed")

    def close(self) -> None:
        """Stop sending or receiving; a second call does nothing."""
        with self._lock:
            if self.closed:
                return
            self.closed = True
        self._node.forget(self)
        if self.sink is not None:
            self.sink.close()


class BaseSubscription(BaseEndpoint):
    """A subscription; see :class:`rosplc.ros.backend.Subscription`."""

    direction: Literal["in"] = "in"
    peer_does = "publishes"
    kind = "subscription"

    def __init__(self, on_message: backend.OnMessage, *arguments: Any) -> None:
        super().__init__(*arguments)
        self._on_message = on_message

    def _deliver(self, payload: bytes, stamp_ns: int) -> None:
        """Deliver one message and count it; exceptions of the receiver are caught."""
        self._messages += 1
        self._last_ns = self._clock.time_ns()
        self._hand_over(self._on_message, payload, stamp_ns or self._last_ns)

    def _problem(self) -> Problem:
        code, reason = super()._problem()
        if not reason and self._rejected:
            reason = f"{self._rejected} messages on {self.topic} were not valid ROS 2 messages"
        return code, reason


class Queued(BaseEndpoint):
    """An endpoint for which up to ``_room`` messages wait until the receive thread delivers them."""

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self._waiting: deque[tuple[Any, ...]] = deque()
        self._room = MOST_CALLERS if self.serves else self.qos.depth

    def _put(self, *message: Any) -> bool:
        """Queue arguments for :meth:`_take`; return False if the oldest were dropped. The lock is held."""
        self._waiting.append(message)
        if len(self._waiting) <= self._room:
            return True
        self._waiting.popleft()
        self._dropped += 1
        return False

    def _take(self, *message: Any) -> None:
        raise NotImplementedError

    def deliver_next(self) -> bool:
        """Deliver one waiting message, if any; called only by the receive thread."""
        with self._delivering:
            with self._lock:
                if self.closed or not self._waiting:
                    return False
                message = self._waiting.popleft()
            self._take(*message)
            return True

    def close(self) -> None:
        """Stop receiving; after this returns, no callback runs, unless this was called from it."""
        super().close()
        with self._delivering:
            self._waiting.clear()


class QueuedSubscription(Queued, BaseSubscription):
    """A subscription whose messages wait in a queue of ``depth`` for the receive thread."""

    _take = BaseSubscription._deliver


class BasePublisher(BaseEndpoint):
    """A publisher; see :class:`rosplc.ros.backend.Publisher`."""

    direction: Literal["out"] = "out"
    peer_does = "subscribes to"
    kind = "publisher"

    def _emit(self, payload: bytes, stamp_ns: int) -> bool:
        """Send one message; False if it was dropped. The lock is held."""
        raise NotImplementedError

    def write(self, payload: bytes, stamp_ns: int | None = None) -> bool:
        """Send one message; see :meth:`rosplc.ros.backend.Publisher.write`."""
        data = self._checked(payload)
        with self._lock:
            if self.closed:
                raise self._closed()
            now = self._clock.time_ns()
            if not self._emit(data, now if stamp_ns is None else stamp_ns):
                self._dropped += 1
                return False
            self._messages += 1
            self._last_ns = now
        return True


class KeepingServer(BaseEndpoint):
    """A service server; keeps a caller's data until the call is answered or refused."""

    direction: Literal["in"] = "in"
    peer_does = "calls"
    kind = "server"
    serves = True
    remembers = False

    def __init__(self, on_request: backend.OnRequest, *arguments: Any) -> None:
        super().__init__(*arguments)
        self._on_request = on_request
        self._callers: OrderedDict[bytes, Any] = OrderedDict()
        self._life, self._numbers = os.urandom(8), itertools.count(1)

    def new_caller(self) -> bytes:
        """Return the 16-byte id of a new caller that has no other identification."""
        return self._life + next(self._numbers).to_bytes(8, "little")

    def _take(self, payload: bytes, caller: bytes, stamp_ns: int, origin: Any) -> None:
        """Deliver one request; ``origin`` is passed to :meth:`_answer`."""
        with self._lock:
            self._callers[caller] = origin
            too_many = len(self._callers) > MOST_CALLERS
            evicted = self._callers.popitem(last=False)[1] if too_many else None
            self._dropped += too_many
        if too_many:
            self._drop(evicted)
        with self._delivering:
            if not self.closed:
                self._messages += 1
                self._last_ns = self._clock.time_ns()
                self._hand_over(self._on_request, payload, caller, stamp_ns)

    def _answer(self, caller: bytes, origin: Any, payload: bytes) -> bool:
        """Send a response to a waiting caller, without the lock; False if the caller is gone."""
        raise NotImplementedError

    def _waits(self, caller: bytes, origin: Any) -> bool:
        """Return whether a caller is still waiting; ``origin`` is missing only if ``remembers`` is set."""
        return True

    def _present(self, caller: bytes, origin: Any) -> bool:
        return (origin is not None or self.remembers) and self._waits(caller, origin)

    def _drop(self, origin: Any) -> None:
        """Tell a caller, without the lock, that no response will follow; ROS 2 does not support this."""

    def reply(self, caller: bytes, payload: bytes) -> bool:
        """Send a response; see :meth:`rosplc.ros.backend.ServiceServer.reply`."""
        data = self._checked(payload)
        with self._lock:
            if self.closed:
                raise self._closed()
            origin = self._callers.pop(caller, None)
        try:
            return self._present(caller, origin) and self._answer(caller, origin, data)
        except BackendError:
            with self._lock:
                if origin is not None and not self.closed:
                    self._callers[caller] = origin  # another response may fit
            raise

    def refuse(self, caller: bytes, text: str) -> bool:
        """End a call without a response."""
        with self._lock:
            origin = self._callers.pop(caller, None)
            return not self.closed and self._present(caller, origin)

    def present(self, caller: bytes) -> bool:
        """Return whether a caller is still waiting, as far as the middleware knows."""
        with self._lock:
            return not self.closed and self._present(caller, self._callers.get(caller))

    def close(self) -> None:
        """Stop serving; after this returns, no callback runs, unless this was called from it."""
        super().close()
        with self._delivering, self._lock:
            dropped, self._callers = self._callers, OrderedDict()
        for origin in dropped.values():
            self._drop(origin)


_call_numbers = itertools.count(1)  # of this process: a client that is opened again repeats none
NO_SERVER = backend.Reply(None, "not executed", Reason.NO_SERVER, "no server is available")
SERVER_GONE = backend.Reply(None, "fate unknown", Reason.SERVER_GONE, "the server went offline")


class BaseClient(BaseEndpoint):
    """A service client; ``calls`` has the backend's data and the ``on_reply`` of each call."""

    direction: Literal["out"] = "out"
    peer_does = "serves"
    kind = "client"
    serves = True

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self.calls: dict[int, tuple[backend.OnReply, Any]] = {}
        self._after = 0  # responses to calls that are not open any more

    @property
    def ready(self) -> bool:
        """Whether a matching server, whose responses can be read, is known now."""
        return self.matched > 0

    def end(self, number: int, reply: backend.Reply) -> None:
        """End a call, unless it has ended or is forgotten; exceptions of the receiver are caught."""
        with self._delivering:
            with self._lock:
                on_reply, _ = self.calls.pop(number, (None, None))
                self._after += on_reply is None and reply.payload is not None
            if on_reply is not None:
                self._hand_over(on_reply, reply)

    def _late(self) -> int:
        return self._after

    def _receivers(self) -> Collection[Any]:
        """Return the servers that a request would reach now (:meth:`gone`); none if it must not be sent."""
        raise NotImplementedError

    def _send(self, number: int, payload: bytes) -> backend.Reply | None:
        """Send a request, without the lock; return the end of the call if it was not sent."""
        raise NotImplementedError

    def call(self, payload: bytes, on_reply: backend.OnReply) -> int:
        """Send a request; see :meth:`rosplc.ros.backend.ServiceClient.call`."""
        data = self._checked(payload)
        with self._lock:
            receivers = set(self._receivers())
            if self.closed:
                raise self._closed()
            number = next(_call_numbers)
            self.calls[number] = (on_reply, receivers)
        try:
            refusal = self._send(number, data) if receivers else NO_SERVER
        except BaseException:
            self.forget(number)
            raise
        with self._lock:
            if refusal is None:
                self._messages += 1
                self._last_ns = self._clock.time_ns()
                return number
            open_ = self.calls.pop(number, None)
        if open_ is not None:  # in this thread, which must wait for no callback of another
            self._hand_over(on_reply, refusal)
        return number

    def gone(self, *servers: Any) -> None:
        """End the calls that only these servers, which are gone, have received."""
        with self._lock:
            affected = [number for number, (_, receivers) in self.calls.items() if receivers & set(servers)]
            for number in affected:
                self.calls[number][1].difference_update(servers)
            ended = [number for number in affected if not self.calls[number][1]]
        for number in ended:
            self.end(number, SERVER_GONE)

    def end_orphans(self, servers: Collection[Any]) -> None:
        """End the calls that were received only by servers that are no longer among these."""
        with self._lock:
            called = set().union(*(receivers for _, receivers in self.calls.values()))
        if dead := called.difference(servers):
            self.gone(*dead)

    def forget(self, number: int) -> None:
        """Stop waiting for a call."""
        with self._lock:
            self.calls.pop(number, None)

    def close(self) -> None:
        """End every open call with ``fate unknown``; after that, no callback runs."""
        super().close()
        with self._delivering:
            for number in tuple(self.calls):
                self.end(number, backend.Reply(None, "fate unknown", Reason.NONE, "the client was closed"))


class Opener:
    """The methods of a backend that open endpoints."""

    _kinds: tuple[Any, ...]  # the classes of its subscriptions, publishers, servers and clients

    def _open(self, kind: Any, topic: str, type_name: str, qos: backend.Qos, *receiver: Any) -> Any:
        """Open an endpoint of this class, and register it."""
        raise NotImplementedError

    def subscribe(self, topic: str, type_name: str, qos: backend.Qos, on_message: backend.OnMessage) -> Any:
        """Subscribe to a topic; see :meth:`rosplc.ros.backend.Backend.subscribe`."""
        return self._open(self._kinds[0], topic, type_name, qos, on_message)

    def advertise(self, topic: str, type_name: str, qos: backend.Qos) -> Any:
        """Advertise a topic; see :meth:`rosplc.ros.backend.Backend.advertise`."""
        return self._open(self._kinds[1], topic, type_name, qos)

    def serve(self, service: str, type_name: str, qos: backend.Qos, on_request: backend.OnRequest) -> Any:
        """Serve a service; see :meth:`rosplc.ros.backend.Backend.serve`."""
        return self._open(self._kinds[2], service, type_name, qos, on_request)

    def client(self, service: str, type_name: str, qos: backend.Qos) -> Any:
        """Call a service; see :meth:`rosplc.ros.backend.Backend.client`."""
        return self._open(self._kinds[3], service, type_name, qos)


class BaseNode(Opener):
    """A node's names, types, endpoints and receive thread; its full name is ``node``.

    Raises BackendError ROS001 if the types are for the other ROS version, ROS005 for an invalid name.
    """

    name: str
    capabilities = frozenset({"topics", "services"})
    logger = logging.getLogger("rosplc.ros")
    ros1: bool | None = False  # whether it is a backend of ROS 1; None: it takes the types of both

    def __init__(self, context: Context) -> None:
        if self.ros1 is not None:
            check_ros(self.name, context.store, ros1=self.ros1)
        self._namespace = validate_namespace(context.namespace)
        self._node_name = validate_node_name(context.node_name)
        self.node = join(context.namespace, context.node_name)
        self.clock = context.clock
        self._remap = dict(context.remap)
        self._store = context.store
        self._lock = threading.RLock()
        self._closed = False
        self._endpoints: list[Any] = []
        self._logged = LogOnce()
        self._since: dict[Hashable, int] = {}

    def _resolve(self, topic: str, type_name: str) -> tuple[str, str]:
        """Return the full names of topic and type; raises ROS009 (closed), ROS005 (name), TYP001 (type)."""
        self._usable()
        full = resolve_topic(topic, namespace=self._namespace, node_name=self._node_name, remap=self._remap)
        if not is_service(type_name):
            return full, self._store[type_name].name
        parts = [self._store[type_name + part].name.removesuffix(part) for part in ("_Request", "_Response")]
        return full, parts[0]

    def _hash(self, name: str) -> str:
        """Return the type hash of a message or service."""
        return self._store.service_hash(name) if is_service(name) else self._store.type_hash(name)

    def _usable(self) -> None:
        if self._closed:
            raise BackendError("ROS009", f"node {self.node} has left the graph")

    def endpoints(self) -> tuple[Any, ...]:
        """Return the endpoints."""
        with self._lock:
            return tuple(self._endpoints)

    def forget(self, endpoint: Any) -> None:
        """Note that an endpoint is being closed; called by the endpoint, once."""
        with self._lock:
            if endpoint in self._endpoints:
                self._endpoints.remove(endpoint)

    def status(self) -> tuple[backend.EndpointStatus, ...]:
        """Return the state of all endpoints."""
        return tuple(endpoint.status() for endpoint in self.endpoints())

    # -- what is wrong

    def _judge(self, endpoint: Any) -> tuple[bool, Iterable[Problem | None]]:
        """Return whether an endpoint has peers, and their problems; None for no problem."""
        raise NotImplementedError

    def _other_servers(self, endpoint: Any) -> list[str]:
        """Return the other servers of the service that an endpoint belongs to."""
        return []

    def diagnose(self, endpoint: Any) -> Problem:
        """Return what prevents peers from matching an endpoint; empty texts if there is no problem."""
        peers, found = self._judge(endpoint)
        problems = [*filter(None, found)]
        if endpoint.serves:
            others, serves = self._other_servers(endpoint), endpoint.direction == "in"
            if len(others) + serves > 1:
                what = f"{listed(sorted(others))} serve{'s' * (len(others) == 1)} {endpoint.topic}"
                problems.append(("ROS022", what + " as well" * serves))
        if problems:
            return max(problems)[0], listed(sorted(words for _, words in problems))
        return "", "" if peers else f"no node {endpoint.peer_does} {endpoint.topic}"

    def _warn(self, endpoint: Any) -> None:
        """Log once what prevents peers from matching an endpoint."""
        code, reason = self.diagnose(endpoint)
        with self._lock:
            first = code and self._logged.first((endpoint.kind, endpoint.topic, reason))
        if first:
            self.logger.warning("%s [%s]", reason, code)

    def _settling(self, key: Hashable, ns: int = SETTLE_NS) -> bool:
        """Return whether less than ``ns`` has passed since the first call for this key."""
        now = self.clock.monotonic_ns()
        return now - self._since.setdefault(key, now) < ns

    # -- the receive thread, and the end

    def _start(self, run: Callable[[], None], name: str) -> None:
        self._thread = threading.Thread(target=run, name=name, daemon=True)
        self._thread.start()

    def _join(self) -> None:
        if threading.current_thread() is not self._thread:
            self._thread.join()

    def _stop(self) -> None:
        """Stop everything that could call endpoints that are about to be closed."""

    def _leave(self) -> None:
        """Release all resources, after the endpoints are closed."""

    def close(self) -> None:
        """Leave the graph; see :meth:`rosplc.ros.backend.Backend.close`."""
        with self._lock:
            if self._closed:
                return
            self._closed = True
        self._stop()
        for endpoint in self.endpoints():
            endpoint.close()
        self._leave()


def check_ros(name: str, store: TypeStore, *, ros1: bool = False) -> None:
    """Refuse (ROS001) types of the other ROS version."""
    if (store.distro == "noetic") is not ros1:
        its, theirs, to = ("ROS 1", "ROS 2", "noetic") if ros1 else ("ROS 2", "ROS 1", "a ROS 2 distribution")
        what = f"the {name} backend is for {its}; {store.distro or 'this type store'} is {theirs}"
        raise BackendError("ROS001", what, remedy=f"Set ros.distro to {to}.")
