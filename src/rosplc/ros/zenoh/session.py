"""The session with Zenoh: opened as soon as it can be, and whether a router is reached.

A peer's session opens at once, and the library connects in the background, again and again. A client's opens
only where a router answers; so that the bridge starts in any order, a thread tries until one does.

Of its settings, what comes later wins: rmw_zenoh's defaults or a file in their place (``ros.zenoh.config``,
else ``ZENOH_SESSION_CONFIG_URI``), then ``ros.zenoh``'s other keys, then ``ZENOH_CONFIG_OVERRIDE``.
"""

from __future__ import annotations

import json
import logging
import threading
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import zenoh

from rosplc.clock import Clock
from rosplc.errors import BackendError

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
    """What a session is opened with."""

    config: Any
    mode: str  # ``peer`` or ``client`` (or ``router``, if a file has it)
    endpoints: tuple[str, ...]  # where it connects to


def session_config(options: Mapping[str, object], environment: Mapping[str, str]) -> SessionConfig:
    """Return a session's configuration; ROS013 for a bad option of ``ros.zenoh``, ROS010 for a variable."""
    for key in options:
        if key not in OPTIONS:
            raise _bad(key, f"there is no key {key!r}; there are: {', '.join(OPTIONS)}")
    config = _base(options, environment)
    if (mode := options.get("mode")) is not None:
        if mode not in _MODES:
            raise _bad("mode", f"{mode!r} is no mode; it is {' or '.join(_MODES)}")
        _insert(config, "mode", mode)
    for key in ("connect", "listen"):
        if (value := options.get(key)) is not None:
            try:
                _insert(config, f"{key}/endpoints", _endpoints(key, value))
            except zenoh.ZError as error:
                raise _bad(key, f"{value!r} has an endpoint that is none: {words(error)}") from error
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
    """Return the library's words without the place in its sources."""
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
        raise BackendError(code, f"{path!r} is no path of a file", where=where)
    try:
        # Read here first: the library's words for a missing file do not name it, and it would read a device
        # without end.
        with Path(path).open("rb") as file:
            size = len(file.read(LARGEST_FILE + 1))
        if size > LARGEST_FILE:
            raise BackendError(code, f"{path} has more than {LARGEST_FILE} bytes", where=where)
        return zenoh.Config.from_file(str(path))
    except (OSError, ValueError) as error:
        what = getattr(error, "strerror", None) or str(error)
        raise BackendError(code, f"{str(path)[:300]!r} cannot be read: {what}", where=where) from error
    except zenoh.ZError as error:
        what = f"{path} is no configuration of Zenoh: {words(error)}"
        raise BackendError(code, what, where=where) from error


def _endpoints(key: str, value: object) -> list[str]:
    if isinstance(value, str):
        value = [value]
    if not isinstance(value, list | tuple) or not all(isinstance(one, str) for one in value):
        raise _bad(key, f"{value!r} is no list of endpoints such as tcp/192.168.1.10:7447")
    return list(value)


def _overrides(text: str) -> Iterator[tuple[str, str]]:
    """Split ``key=value;key=value`` as rmw_zenoh does; a value is JSON5."""
    for part in filter(None, (part.strip() for part in text.split(";"))):
        path, equals, value = part.partition("=")
        if not equals or not path.strip() or not value.strip():
            raise BackendError("ROS010", f"{_OVERRIDE} has {part!r}; it is key=value", where=_OVERRIDE)
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
    """Opens the session, once."""

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
        """Open the session, or begin to try; ROS002 if the library refuses for more than an absent router."""
        if self._config.mode == "client":
            self._thread = threading.Thread(target=self._keep_trying, name="rosplc-zenoh-open", daemon=True)
            self._thread.start()
            self._clock.wait(self._tried, _PATIENCE_NS)
        elif not self._open() or self._refusal:
            raise BackendError("ROS002", f"Zenoh does not open a session: {self._refusal}")
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
        """Find out whether another node is connected, and log when that changes."""
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
            return f"the Zenoh router at {where} has gone; nodes that start now are not found"
        return f"no Zenoh router answers at {where}"

    def close(self) -> None:
        """Stop trying, close the session."""
        with self._lock:
            self._ended.set()
        if self._thread is not None and self._thread is not threading.current_thread():
            self._thread.join(_PATIENCE_NS / 1e9)  # what opens later is closed at once
        if self._session is not None:
            try:
                self._session.close()
            except zenoh.ZError as error:
                _logger.debug("closing the session: %s", error)
