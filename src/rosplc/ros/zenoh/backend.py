"""The Zenoh backend: one session, one node, one receive thread over all subscriptions."""

from __future__ import annotations

import itertools
import json
import logging
import queue
import threading
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import zenoh

from rosplc.clock import Clock
from rosplc.errors import BackendError
from rosplc.ros._base import BaseNode, Context, Problem, domain_number, opener
from rosplc.ros.backend import GraphInfo, Qos
from rosplc.ros.zenoh.endpoint import Endpoint, ZenohPublisher, ZenohSubscription
from rosplc.ros.zenoh.keys import NO_TYPE_HASH, OTHER, SPACE, Entity, Kind, TokenTable, explain
from rosplc.ros.zenoh.service import ZenohClient, ZenohServer

LARGEST_FILE = 1 << 20  # Bytes that a configuration of Zenoh's may have.

OPTIONS = ("mode", "connect", "listen", "config")  # The keys of `ros.zenoh`.

_MODES = ("peer", "client")
_FILE, _OVERRIDE = "ZENOH_SESSION_CONFIG_URI", "ZENOH_CONFIG_OVERRIDE"

# As rmw_zenoh's DEFAULT_RMW_ZENOH_SESSION_CONFIG.json5 has them, so that the bridge is found
# wherever a ROS 2 node would be. Three differ, each for its reason.
_DEFAULTS: tuple[tuple[str, object], ...] = (
    ("mode", "peer"),
    ("connect/endpoints", ["tcp/localhost:7447"]),
    ("connect/timeout_ms", {"router": -1, "peer": -1, "client": 0}),
    ("connect/exit_on_failure", {"router": False, "peer": False, "client": True}),
    # Differs: a router that comes back is found within a second, not within four.
    ("connect/retry", {"period_init_ms": 1000, "period_max_ms": 1000, "period_increase_factor": 1}),
    ("listen/endpoints", ["tcp/localhost:0"]),
    ("scouting/multicast/enabled", False),
    ("scouting/gossip/enabled", True),
    ("scouting/gossip/target", {"router": ["router", "peer"], "peer": ["router"]}),
    ("scouting/gossip/autoconnect_strategy", {"peer": {"to_router": "always", "to_peer": "greater-zid"}}),
    ("timestamping/enabled", {"router": True, "peer": True, "client": True}),
    ("queries_default_timeout", 600_000),
    ("transport/unicast/open_timeout", 60_000),
    ("transport/unicast/accept_timeout", 60_000),
    ("transport/unicast/accept_pending", 10_000),
    ("transport/unicast/max_sessions", 10_000),
    # Differs: 16 batches of 64 KiB wait for a slow peer before messages are dropped, not 2.
    ("transport/link/tx/queue/size/data", 16),
    # Differs: shared memory between sessions would put segments of the library's into /dev/shm.
    ("transport/shared_memory/enabled", False),
)


@dataclass(frozen=True)
class SessionConfig:
    """The configuration of a session."""

    config: Any
    mode: str  # ``peer`` or ``client`` (or ``router``, if a file has it)
    endpoints: tuple[str, ...]  # where it connects to


def session_config(options: Mapping[str, object], environment: Mapping[str, str]) -> SessionConfig:
    """Return a session's configuration; ROS013 for an invalid option in ``ros.zenoh``, ROS010 for a variable.

    Later items take precedence: rmw_zenoh's defaults or a file instead of them (``ros.zenoh.config``, else
    ``ZENOH_SESSION_CONFIG_URI``), then ``ros.zenoh``'s other keys, then ``ZENOH_CONFIG_OVERRIDE``.
    """
    for key in options:
        if key not in OPTIONS:
            raise _bad(key, f"unknown key {key!r}; use one of {', '.join(OPTIONS)}")
    config = _base(options, environment)
    if (mode := options.get("mode")) is not None:
        if mode not in _MODES:
            raise _bad("mode", f"{mode!r} is not a valid mode; use {' or '.join(_MODES)}")
        _insert(config, "mode", mode)
    for key in ("connect", "listen"):
        if (value := options.get(key)) is not None:
            try:
                _insert(config, f"{key}/endpoints", _endpoints(key, value))
            except zenoh.ZError as error:
                raise _bad(key, f"{value!r} has an invalid endpoint: {words(error)}") from error
    for path, text in _overrides(environment.get(_OVERRIDE, "")):
        try:
            config.insert_json5(path, text)
        except (zenoh.ZError, UnicodeError) as error:  # a variable may hold bytes that are no text
            what = f"{_OVERRIDE} sets {path}={text}: {words(error)}"
            raise BackendError("ROS010", what, where=_OVERRIDE) from error
    mode = json.loads(config.get_json("mode"))
    mode = mode if isinstance(mode, str) else "peer"
    if mode == "client":
        # One attempt at a time: the backend tries again itself, and starts without a router.
        for path, value in (("connect/timeout_ms", 0), ("connect/exit_on_failure", True)):
            _insert(config, path, value)
    return SessionConfig(config, mode, _connects_to(config, mode))


def _bad(key: str, what: str) -> BackendError:
    return BackendError("ROS013", what, where=f"ros.zenoh.{key}")


def words(error: Exception) -> str:
    """Return the library's error text without the position in its sources."""
    return str(error).split(" at /")[0]


def _insert(config: Any, path: str, value: object) -> None:
    config.insert_json5(path, json.dumps(value))


def _base(options: Mapping[str, object], environment: Mapping[str, str]) -> Any:
    path, code, where = options.get("config"), "ROS013", "ros.zenoh.config"
    if path is None and environment.get(_FILE):
        path, code, where = environment[_FILE], "ROS010", _FILE
    if path is None:
        config = zenoh.Config()
        for key, value in _DEFAULTS:
            _insert(config, key, value)
        return config
    if not isinstance(path, str | Path):
        raise BackendError(code, f"{path!r} is not a file path", where=where)
    try:
        # Read here first: the library's words for a missing file do not name it, and it would read a device
        # without end.
        with Path(path).open("rb") as file:
            size = len(file.read(LARGEST_FILE + 1))
        if size > LARGEST_FILE:
            raise BackendError(code, f"{path} is larger than {LARGEST_FILE} bytes", where=where)
        return zenoh.Config.from_file(str(path))
    except (OSError, ValueError) as error:
        what = getattr(error, "strerror", None) or str(error)
        raise BackendError(code, f"{str(path)[:300]!r} cannot be read: {what}", where=where) from error
    except zenoh.ZError as error:
        what = f"{path} is not a Zenoh configuration: {words(error)}"
        raise BackendError(code, what, where=where) from error


def _endpoints(key: str, value: object) -> list[str]:
    if isinstance(value, str):
        value = [value]
    if not isinstance(value, list | tuple) or not all(isinstance(one, str) for one in value):
        raise _bad(key, f"{value!r} is not a list of endpoints such as tcp/192.168.1.10:7447")
    return list(value)


def _overrides(text: str) -> Iterator[tuple[str, str]]:
    """Split ``key=value;key=value`` as rmw_zenoh does; a value is JSON5."""
    for part in filter(None, (part.strip() for part in text.split(";"))):
        path, equals, value = part.partition("=")
        if not equals or not path.strip() or not value.strip():
            raise BackendError("ROS010", f"{_OVERRIDE} contains {part!r}; use key=value", where=_OVERRIDE)
        yield path.strip(), value.strip()


def _connects_to(config: Any, mode: str) -> tuple[str, ...]:
    found = json.loads(config.get_json("connect/endpoints"))
    if isinstance(found, dict):
        found = found.get(mode) or []
    return tuple(str(endpoint) for endpoint in found or [])


_logger = logging.getLogger("rosplc.ros.zenoh")

_RETRY_NS = 1_000_000_000
_PATIENCE_NS = 2_000_000_000  # a router on this machine or next to it answers sooner


class Link:
    """Opens the session once, and monitors the connection to a router.

    A peer's session opens immediately, and the library keeps trying to connect in the background. A client's
    session opens only if a router answers; a thread tries until then, so the start order does not matter.
    """

    def __init__(self, config: SessionConfig, on_open: Callable[[Any], None], clock: Clock) -> None:
        # ``on_open`` is called with the session, from :meth:`start` or from a thread of its own.
        self._config, self._on_open, self._clock = config, on_open, clock
        self._lock = threading.Lock()
        self._ended = threading.Event()
        self._tried = threading.Event()
        self._thread: threading.Thread | None = None
        self._session: Any = None
        self._seen = False  # whether there has been a router
        self._refusal = ""
        self.trouble = ""  # in words, why no other node can be reached; empty if some can

    def start(self) -> None:
        """Open the session, or start trying; ROS002 if it fails for another reason than a missing router."""
        if self._config.mode == "client":
            self._thread = threading.Thread(target=self._keep_trying, name="rosplc-zenoh-open", daemon=True)
            self._thread.start()
            self._clock.wait(self._tried, _PATIENCE_NS)
        elif not self._open() or self._refusal:
            raise BackendError("ROS002", f"Zenoh cannot open a session: {self._refusal}")
        self.look()

    def _keep_trying(self) -> None:
        while not self._open() and not self._clock.wait(self._ended, _RETRY_NS):
            pass

    def _open(self) -> bool:
        try:
            session: Any = zenoh.open(self._config.config)
            with self._lock:
                if not self._ended.is_set():
                    self._session = session
            if self._session is None:
                session.close()
            else:
                self._on_open(session)
        except zenoh.ZError as error:
            self._refusal = words(error)
        else:
            self._refusal = ""
        self._tried.set()
        return self._session is not None

    def look(self) -> None:
        """Check whether a router or peer is connected, and log changes."""
        trouble = self._diagnose()
        if trouble and trouble != self.trouble:
            _logger.warning("%s [ROS016]%s", trouble, f" ({self._refusal})" if self._refusal else "")
        elif trouble != self.trouble:
            _logger.info("connected to %s", " or ".join(self._config.endpoints))
        self.trouble = trouble

    def _diagnose(self) -> str:
        where = " or ".join(self._config.endpoints)
        if not where:
            return ""  # others connect to us
        try:
            if self._session is not None:
                info = self._session.info
                if info.routers_zid():
                    self._seen = True
                    return ""
                if info.peers_zid() and not self._seen:
                    return ""  # connected with a peer directly, as configured
        except zenoh.ZError:
            return ""  # it is being closed
        if self._seen:
            return f"the Zenoh router at {where} is gone; new nodes cannot be discovered"
        return f"no Zenoh router answers at {where}"

    def close(self) -> None:
        """Stop trying, and close the session."""
        with self._lock:
            self._ended.set()
        if self._thread is not None and self._thread is not threading.current_thread():
            self._thread.join(_PATIENCE_NS / 1e9)  # what opens later is closed at once
        if self._session is not None:
            try:
                self._session.close()
            except zenoh.ZError as error:
                _logger.debug("closing the session: %s", error)


_LETTERS: tuple[Kind, ...] = ("MS", "MP", "SS", "SC")
_TICK_S = 0.5  # how often the receive thread looks at what has no event of its own


class ZenohBackend(BaseNode):
    """One ROS 2 node on Zenoh; see :class:`rosplc.ros.backend.Backend`."""

    name = "zenoh"
    _kinds = (ZenohSubscription, ZenohPublisher, ZenohServer, ZenohClient)
    logger = logging.getLogger("rosplc.ros.zenoh")

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self._hashes = context.store.distro != "humble"
        self.domain = domain_number(context.domain, context.environment) or 0
        self.tokens = TokenTable()
        self._session: Any = None
        self._session_id = ""
        self._declared: list[Any] = []
        self._numbers = itertools.count(1)
        self._arrived: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self.wake = self._arrived.put
        self._suspects: set[str] = set()
        config = session_config(context.options, context.environment)
        self._link = Link(config, self._connected, self.clock)
        self._link.start()
        self._start(self._run, f"rosplc-zenoh-{self.domain}")

    def _connected(self, session: Any) -> None:
        """Declare the node, subscribe to the other nodes' tokens, and declare the requested endpoints."""
        with self._lock:
            if self._closed:
                return
            self._session, self._session_id = session, str(session.zid())
            node = self._entity("NN", "0")
            # "Direct": otherwise the library starts a thread; and our own tokens come this way, too.
            see = zenoh.handlers.Callback(self._see, None, indirect=False)  # 1.5 has no default there
            liveliness = session.liveliness()
            self._declared = [
                liveliness.declare_token(node.token),
                liveliness.declare_subscriber(f"{SPACE}/{self.domain}/**", see, history=True),
            ]
            for endpoint in self._endpoints:
                endpoint.declare(session, replace(endpoint.entity, session=self._session_id))

    def _entity(self, kind: Kind, number: str, *details: Any) -> Entity:
        names = (self._namespace, self._node_name)
        return Entity(self.domain, self._session_id, "0", number, kind, *names, *details)

    def _see(self, sample: Any) -> None:
        """Note that a token has appeared or disappeared; called by threads of the library."""
        try:
            token = str(sample.key_expr)
            appeared = sample.kind == zenoh.SampleKind.PUT
            topic = self.tokens.appeared(token) if appeared else self.tokens.gone(token)
            if topic is not None:
                self._suspects.add(topic)
        except Exception:  # a defect; but the library would print it and continue silently
            self.logger.exception("cannot process a token")

    # -- endpoints

    def _open(self, kind: Any, topic: str, type_name: str, qos: Qos, *receiver: Any) -> Any:
        with self._lock:
            full, name = self._resolve(topic, type_name)
            details = (full, name, self._hash(name) if self._hashes else NO_TYPE_HASH, qos)
            letters = _LETTERS[self._kinds.index(kind)]
            endpoint = kind(*receiver, self, self._entity(letters, str(next(self._numbers)), *details))
            self._adopt(endpoint)
        return endpoint

    def _adopt(self, endpoint: Endpoint) -> None:
        if self._session is not None:
            try:
                endpoint.declare(self._session, endpoint.entity)
            except zenoh.ZError as error:
                what = f"cannot open {endpoint.topic} as {endpoint.type_name}: {error}"
                raise BackendError("ROS002", what) from error
        self._endpoints.append(endpoint)
        self._suspects.add(endpoint.topic)

    # -- receiving

    def _run(self) -> None:
        next_tick = 0
        while True:
            try:
                endpoint = self._arrived.get(timeout=_TICK_S)
                if endpoint is None:
                    return
                endpoint.deliver_next()
            except queue.Empty:
                pass
            if (now := self.clock.monotonic_ns()) >= next_tick:
                next_tick = now + round(_TICK_S * 1e9)
                self._tick()

    def _tick(self) -> None:
        try:
            self._link.look()
            due, self._suspects = self._suspects, set()
            for endpoint in self.endpoints() if due else ():
                if endpoint.topic in due:
                    self._log(endpoint)
        except Exception:  # a defect; but the topics have to go on
            self.logger.exception("error in the receive thread of %s", self.node)

    def _log(self, endpoint: Endpoint) -> None:
        for code, reason in self._problems(endpoint.entity):
            if self._logged.first((endpoint.topic, reason)):
                self.logger.warning("%s%s", reason, f" [{code}]" if code else "")

    # -- what is wrong

    def others(self, ours: Entity) -> tuple[Entity, ...]:
        """Return the endpoints that may exchange messages with ours."""
        return self.tokens.on(ours.topic, OTHER[ours.kind])

    def _problems(self, ours: Entity) -> list[Problem]:
        return sorted(filter(None, (explain(ours, theirs) for theirs in self.others(ours))), reverse=True)

    def _judge(self, endpoint: Endpoint) -> tuple[bool, list[Problem | None]]:
        trouble = self._link.trouble
        problems = [*self._problems(endpoint.entity), ("ROS016", trouble) if trouble else None]
        return bool(self.others(endpoint.entity)), problems

    def _other_servers(self, endpoint: Endpoint) -> list[str]:
        servers = self.tokens.on(endpoint.topic, "SS")
        return [f"node {one.full_name}" for one in servers if one.token != endpoint.entity.token]

    def graph(self) -> GraphInfo:
        """Return the graph of the other nodes."""
        return self.tokens.graph(self._session_id)

    def _leave(self) -> None:
        self._arrived.put(None)
        self._join()
        self._link.close()
        self.tokens.clear()


# Connect to a ROS 2 graph over Zenoh; arguments and errors as for `rosplc.ros.open_backend`.
#
# Options (`ros.zenoh`): `mode` (`peer` or `client`), `connect` and `listen` (lists of endpoints such as
# `tcp/192.168.1.10:7447`), `config` (Zenoh's JSON5 file). ROS013 or ROS010: invalid option or variable.
open_backend = opener(ZenohBackend)
