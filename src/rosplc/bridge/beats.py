"""One thread that beats for everything of this process that has no loop of its own."""

from __future__ import annotations

import os
import threading
import time
import weakref
from typing import ClassVar, Protocol

from rosplc.errors import ChannelError

__all__ = ["BEAT_MS", "Beating", "Beats"]

BEAT_MS = 100
"""The beat that is promised and kept, in milliseconds."""


class Beating(Protocol):
    """What can be kept alive."""

    @property
    def closed(self) -> bool:
        """Whether it needs no beat any more."""

    def beat(self) -> None:
        """Show that it lives."""


class Beats:
    """The thread and its members; it ends when the last member has gone."""

    _all: ClassVar[weakref.WeakSet[Beating]] = weakref.WeakSet()
    _lock = threading.Lock()
    _running = False

    @classmethod
    def add(cls, member: Beating) -> None:
        """Beat for a member until it is closed or nobody refers to it any more."""
        with cls._lock:
            cls._all.add(member)
            if not cls._running:
                cls._running = True
                threading.Thread(target=cls._run, name="rosplc-beats", daemon=True).start()

    @classmethod
    def _run(cls) -> None:
        while True:
            time.sleep(BEAT_MS / 1e3)
            with cls._lock:
                members = [member for member in cls._all if not member.closed]
                if not members:
                    cls._running = False
                    return
            for member in members:
                try:
                    member.beat()
                except (ChannelError, ValueError):
                    continue  # write() and read() report it to whoever can act
            del members, member  # or this thread would keep alive what nobody else refers to

    @classmethod
    def _forked(cls) -> None:
        # Threads stay with the parent, and so does what it owns (rosplc.shm.owned).
        cls._lock = threading.Lock()
        cls._all = weakref.WeakSet()
        cls._running = False


os.register_at_fork(after_in_child=Beats._forked)
