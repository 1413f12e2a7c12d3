"""How a channel stands, in one word: the words and levels of ``/diagnostics``, seen from outside.

A bridge knows its topics and says more; whoever looks from outside knows what stands in the objects,
which goes on when the bridge is dead.
"""

from __future__ import annotations

import enum

from rosplc.levels import Level

__all__ = ["ALL_WELL", "State"]


class State(enum.Enum):
    """How a channel stands. The order is that of severity: the worst stands first.

    The value is the word for people and for JSON.
    """

    UNREADABLE = "unreadable"
    """The object cannot be used: damaged, closed to this user, no object of this format."""
    MISSING = "missing"
    """The configuration names the topic, and there is no object."""
    DEAD = "dead"
    """Bridge or PLC hold a claim, and do not beat any more: killed, stopped, or stuck."""
    NO_BRIDGE = "no bridge"
    """The bridge ended in order, and left the last message."""
    REFUSED = "refused"
    """Messages did not fit and were refused, within the last ten seconds."""
    LOST = "lost"
    """Messages of a topic on which each one counts were lost, within the last ten seconds."""
    STALE = "stale"
    """The last message is older than the topic allows."""
    SILENT = "silent"
    """No message came yet, for longer than the topic allows."""
    NO_PLC = "no PLC"
    """No PLC task reads it, or writes it."""
    UNKNOWN = "looking"
    """Looked at for too short a time to say who is alive; or the bridge is starting."""
    OK = "ok"
    """Nothing is wrong; perhaps nobody publishes, where that is allowed."""

    @property
    def severity(self) -> int:
        """0 for ``ok``, more for what is worse."""
        return _SEVERITY[self]

    @property
    def level(self) -> Level:
        """The level that ``/diagnostics`` gives it."""
        return _LEVELS.get(self, Level.OK)


_SEVERITY = {state: number for number, state in enumerate(reversed(State))}
_LEVELS = {
    State.UNREADABLE: Level.ERROR,
    State.MISSING: Level.ERROR,
    State.DEAD: Level.ERROR,
    State.NO_BRIDGE: Level.WARN,
    State.REFUSED: Level.WARN,
    State.LOST: Level.WARN,
    State.STALE: Level.STALE,
    State.SILENT: Level.STALE,
    State.NO_PLC: Level.WARN,
}

ALL_WELL = (State.OK, State.UNKNOWN)
"""The states in which nothing is wrong."""
