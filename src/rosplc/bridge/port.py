"""The PLC's side of a stream: what carrying asks of a transport, and what it offers to one.

A transport is two classes: a :class:`Port` for one stream, and :class:`Ports` for all of a kind in one
direction, which one thread polls and takes from with one call per tick. The shared-memory channel
(:mod:`rosplc.bridge.channel`) and classic memory (:mod:`rosplc.bridge.classic`) are two of them.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Collection, Hashable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

from rosplc.bridge.status import PortStatus
from rosplc.clock import SYSTEM, Clock
from rosplc.config.resolve import Plan
from rosplc.errors import ChannelError, RosplcError
from rosplc.ros import EndpointStatus
from rosplc.shm import Namespace, beat
from rosplc.shm.files import USUAL, Rights

if TYPE_CHECKING:
    from rosplc.bridge.stream import Stream

log = logging.getLogger("rosplc.bridge")

QUIET_NS = 10_000_000_000  # time between two log lines of one kind
STILL_TURNS = 5  # of so many looks at what costs much, one is at a topic on which nothing happens
_MOST_KINDS = 1000


class RepeatedWarnings:
    """Logs the first warning of a kind, such as ``(topic, code)``, then one in ten seconds, with a count."""

    def __init__(self, logger: logging.Logger) -> None:
        self._logger = logger
        self._seen: dict[Hashable, tuple[int, int]] = {}

    def warn(self, kind: Hashable, now_ns: int, text: str) -> None:
        """Log ``text``, or count it if its kind was logged within the last ten seconds."""
        last, held = self._seen.get(kind, (None, 0))
        if last is not None and now_ns - last < QUIET_NS:
            self._seen[kind] = (last, held + 1)
            return
        if len(self._seen) >= _MOST_KINDS:
            self._seen.clear()
        self._seen[kind] = (now_ns, 0)
        self._logger.warning("%s%s", text, f" (similar messages suppressed: {held})" if held else "")


@dataclass(frozen=True)
class Context:
    """What the streams of one bridge have in common."""

    namespace: Namespace
    bridge: str
    bridge_id: bytes
    distro: str
    rights: Rights = USUAL
    beat_ns: int = 100_000_000  # the beat that is promised
    # how long silence must last beyond what a topic allows before it is reported, and how long its
    # end
    debounce_ns: int = 500_000_000
    clock: Clock = SYSTEM
    beating: dict[object, Any] = field(default_factory=dict, compare=False)  # readers, writers; by port
    warnings: RepeatedWarnings = field(default_factory=lambda: RepeatedWarnings(log))

    @property
    def beat_ms(self) -> int:
        """The promised beat in milliseconds."""
        return max(1, self.beat_ns // 1_000_000)

    def beat(self) -> None:
        """Let what is open beat."""
        beat(list(self.beating.values()))


class Notes:
    """What went wrong with a topic or service, for its status and the log."""

    def __init__(self, plan: Plan, context: Context) -> None:
        self.context = context
        self.still = False  # whether nothing changed between the last two looks, nor has since
        self.problem = ""  # why it cannot be carried at present; empty if it is
        self._name = plan.name
        self._endpoint: Any = None  # in ROS
        self._reason: tuple[str, str, int] | None = None  # words, code, when

    def note(self, now_ns: int, words: str, code: str = "") -> None:
        """Remember and log what went wrong."""
        self._reason, self.still = (words, code, now_ns), False
        suffix = f" [{code}]" if code else ""
        self.context.warnings.warn((self._name, code), now_ns, f"{self._name}: {words}{suffix}")

    def fail(self, now_ns: int, error: Exception) -> None:
        """Remember an error that keeps it from being carried until its object is opened again."""
        words, code = str(error) or type(error).__name__, ""
        if isinstance(error, RosplcError):
            words, code = error.what, error.code
        self.problem = f"{words} [{code}]" if code else words
        self.note(now_ns, words, code)

    def concerns(self, endpoints: Collection[Any]) -> bool:
        """Return whether its endpoint is one of these."""
        return bool(endpoints) and self._endpoint in endpoints

    def noted(self, now_ns: int, endpoint: EndpointStatus | None) -> dict[str, Any]:
        """Return what a status says about it: the endpoint's trouble where there is none from here."""
        reason, code, when = self._reason or ("", "", 0)
        recent = bool(reason) and now_ns - when < QUIET_NS
        if endpoint is not None and endpoint.code and not recent:
            reason, code, recent = endpoint.reason, endpoint.code, True
        return {"problem": self.problem, "reason": reason, "code": code, "recent": recent}


@dataclass
class Counters:
    """Messages of one stream; each number is written by one thread."""

    received: int = 0
    published: int = 0
    lost: int = 0
    refused: int = 0
    truncated: int = 0
    substituted: int = 0
    recovered: int = 0


class Port(Protocol):
    """The PLC's side of one stream; what has a body is what a port does that does not say otherwise.

    It tells its stream what comes of messages: :meth:`Stream.receive`, ``delivered``, ``refuse``, ``note``,
    ``fail`` and ``renewed``.
    """

    adopted: bool  # whether :meth:`open` found an object and kept it; never asked before that
    side: Stream
    # What takes messages without Python while it is open: its own towards the PLC, else the publisher's.
    sink: Any = None

    def open(self) -> None:
        """Create or adopt the object, and claim it; SHM116 if another bridge holds its name."""

    def close(self) -> None:
        """Leave the object with its last state; harmless twice."""

    def retire(self) -> None:
        """Give the object up, so that its users are told and its name is free; and close."""
        self.close()

    def check(self, now_ns: int) -> bool:
        """Look after object and peer each second. True: open it again; ChannelError: it is unusable."""
        return not self.owned()

    def put(self, data: bytes, stamp_ns: int, flags: int, now_ns: int) -> None:
        """Convert a message and give it to the PLC, now or soon; every outcome is told to the stream."""
        raise ChannelError("SHM110", "only the PLC can write to a to_ros channel", where=self.side.plan.topic)

    def open_sink(self, limit_ns: int) -> None:
        """Let the sink take what comes next; a silence of more than ``limit_ns`` (0: any) closes it."""
        return

    def owned(self) -> bool:
        """Return whether this bridge still is the one that carries the object; towards ROS."""
        return True

    def retained(self) -> tuple[bytes, int, int] | None:
        """Return the PLC's last message, if an earlier bridge took it: bytes, stamp and its clock."""
        return None

    def tell(self, matched: int) -> None:
        """Show the PLC how many ROS peers there are."""
        return

    def loss(self, count: int) -> str:
        """Describe why messages were lost, and what helps."""

    def status(self, now_ns: int) -> PortStatus:
        """Return what is known of the PLC; from any thread."""


_P = TypeVar("_P", bound=Port)


class Ports(Protocol[_P]):
    """All ports of one kind in one direction; except for :meth:`wake`, used by one thread at a time."""

    def make(self, side: Stream) -> _P:
        """Return the port of a stream; nothing is opened yet."""

    def add(self, port: _P) -> None:
        """Serve an open port from now on."""
        return

    def remove(self, port: _P) -> None:
        """Serve a port no more; harmless if it is not served."""
        return

    def poll(self, due_ns: int | None) -> None:
        """Sleep until there is news, until a point in monotonic time, or until :meth:`wake`."""

    def wake(self) -> None:
        """Make :meth:`poll` return soon; from any thread."""

    def take(self, now_ns: int) -> tuple[int | None, list[_P]]:
        """Take what is new from all ports, and pass it on; write what waits.

        Return when the next call is due at the latest (None: nothing waits), and the ports to open again.
        """
        return None, []


class Waiting(Ports[_P]):
    """Ports whose sleep nothing but time and :meth:`wake` ends."""

    def __init__(self, context: Context) -> None:
        self._context = context
        self._event = threading.Event()

    def poll(self, due_ns: int | None) -> None:
        """Sleep until a point in time or :meth:`wake`."""
        clock = self._context.clock
        wait = None if due_ns is None else due_ns - clock.monotonic_ns()
        if wait is None or wait > 0:
            clock.wait(self._event, wait)
        self._event.clear()

    def wake(self) -> None:
        """End the sleep; from any thread."""
        self._event.set()
