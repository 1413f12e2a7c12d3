"""The session with Zenoh: opened as soon as it can be, and whether a router is reached.

A peer's session opens at once, and the library connects in the background, again and again. A
client's opens only where a router answers; so that the bridge starts in any order, a thread
tries until one does.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from typing import Any

import zenoh

from rosplc.clock import Clock
from rosplc.errors import BackendError
from rosplc.ros.zenoh.config import SessionConfig, words

_logger = logging.getLogger("rosplc.ros.zenoh")

_RETRY_NS = 1_000_000_000
_PATIENCE_NS = 2_000_000_000  # a router on this machine or next to it answers sooner


class Link:
    """Opens the session, once.

    Args:
        config: How.
        on_open: Called with the session, from :meth:`start` or from a thread of its own.
        clock: Time.

    Attributes:
        trouble: In words, why no other node can be reached; empty if some can.
    """

    def __init__(self, config: SessionConfig, on_open: Callable[[Any], None], clock: Clock) -> None:
        self._config, self._on_open, self._clock = config, on_open, clock
        self._lock = threading.Lock()
        self._ended = threading.Event()
        self._tried = threading.Event()
        self._thread: threading.Thread | None = None
        self._session: Any = None
        self._seen = False  # whether there has been a router
        self._refusal = ""
        self.trouble = ""

    def start(self) -> None:
        """Open the session, or begin to try.

        Raises:
            BackendError: ROS002 if the library refuses for another reason than an absent router.
        """
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
