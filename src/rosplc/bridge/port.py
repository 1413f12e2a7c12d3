"""The PLC's side of a stream: the interface between the carriers and a transport.

A transport has two classes: a :class:`Port` for one stream, and :class:`Ports` for all ports of one kind
and direction, which one thread polls with one call per tick. There are two transports: the shared-memory
channel (:mod:`rosplc.bridge.channel`) and classic memory (:mod:`rosplc.bridge.classic`).
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
STILL_TURNS = 5  # costly checks of a topic on which nothing happens are made once in so many turns
_MOST_KINDS = 1000


class RepeatedWarnings:
    """Logs the first warning of a kind, such as ``(topic, code)``; then one in ten seconds, with a count."""

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
    """The data that all streams of one bridge share."""

    namespace: Namespace
    bridge: str
    bridge_id: bytes
    distro: str
    rights: Rights = USUAL
    beat_ns: int = 100_000_000  # the beat that is promised
    # how long silence must last beyond what a topic allows before it is reported, and how long its end
    debounce_ns: int = 500_000_000
    clock: Clock = SYSTEM
    beating: dict[object, Any] = field(default_factory=dict, compare=False)  # readers, writers; by port
    warnings: RepeatedWarnings = field(default_factory=lambda: RepeatedWarnings(log))

    @property
    def beat_ms(self) -> int:
        """The promised heartbeat period in milliseconds."""
        return max(1, self.beat_ns // 1_000_000)

    def beat(self) -> None:
        """Send a heartbeat on all open lines."""
        beat(list(self.beating.values()))


class Notes:
    """The problems of a topic or service, for its status and the log."""

    def __init__(self, plan: Plan, context: Context) -> None:
        self.context = context
        self.still = False  # whether nothing changed between the last two looks, nor has since
        self.problem = ""  # why it cannot be carried at present; empty if it is
        self._name = plan.name
        self._endpoint: Any = None  # in ROS
        self._reason: tuple[str, str, int] | None = None  # words, code, when

    def note(self, now_ns: int, words: str, code: str = "") -> None:
        """Store and log a problem."""
        self._reason, self.still = (words, code, now_ns), False
        suffix = f" [{code}]" if code else ""
        self.context.warnings.warn((self._name, code), now_ns, f"{self._name}: {words}{suffix}")

    def fail(self, now_ns: int, error: Exception) -> None:
        """Store an error that stops the carrying until the object is opened again."""
        words, code = str(error) or type(error).__name__, ""
        if isinstance(error, RosplcError):
            words, code = error.what, error.code
        self.problem = f"{words} [{code}]" if code else words
        self.note(now_ns, words, code)

    def concerns(self, endpoints: Collection[Any]) -> bool:
        """Return whether the endpoint is one of these."""
        return self._endpoint in endpoints

    def noted(self, now_ns: int, endpoint: EndpointStatus | None) -> dict[str, Any]:
        """Return the status fields for problems: those noted here, otherwise the endpoint's."""
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
    """The PLC's side of one stream; methods with a body are default implementations.

    A port reports to its stream with :meth:`Stream.receive`, ``delivered``, ``refuse``, ``note``, ``fail``
    and ``renewed``.
    """

    adopted: bool  # whether :meth:`open` found an object and kept it; never asked before that
    side: Stream
    # Takes messages without Python while it is open: to the PLC its own, else the publisher's.
    sink: Any = None

    def open(self) -> None:
        """Create or adopt the object, and claim it; SHM116 if another bridge holds its name."""

    def close(self) -> None:
        """Close the object, which keeps its last state; a second call does nothing."""

    def retire(self) -> None:
        """Retire and close the object: its users are notified, and its name becomes free."""
        self.close()

    def check(self, now_ns: int) -> bool:
        """Check object and PLC once per second; True: open the object again; ChannelError: unusable."""
        return not self.owned()

    def put(self, data: bytes, stamp_ns: int, flags: int, now_ns: int) -> None:
        """Convert a message and send it to the PLC, now or soon; every outcome is reported to the stream."""
        raise ChannelError("SHM110", "only the PLC can write to a to_ros channel", where=self.side.plan.topic)

    def open_sink(self, limit_ns: int) -> None:
        """Open the sink for the next messages; a silence of more than ``limit_ns`` (0: any) closes it."""
        return

    def owned(self) -> bool:
        """Return whether this bridge still carries the object; for messages to ROS."""
        return True

    def retained(self) -> tuple[bytes, int, int] | None:
        """Return the PLC's last message if an earlier bridge took it: bytes, stamp and the stamp's clock."""
        return None

    def tell(self, matched: int) -> None:
        """Show the PLC the number of ROS endpoints."""
        return

    def loss(self, count: int) -> str:
        """Describe why messages were lost, and the remedy."""

    def status(self, now_ns: int) -> PortStatus:
        """Return the known state of the PLC; callable from any thread."""


_P = TypeVar("_P", bound=Port)


class Ports(Protocol[_P]):
    """All ports of one kind in one direction; used by one thread at a time, except for :meth:`wake`."""

    def make(self, side: Stream) -> _P:
        """Return the port of a stream without opening anything."""

    def add(self, port: _P) -> None:
        """Start to serve an open port."""
        return

    def remove(self, port: _P) -> None:
        """Stop serving a port; does nothing if it is not served."""
        return

    def poll(self, due_ns: int | None) -> None:
        """Sleep until something is new, until a point in monotonic time, or until :meth:`wake`."""

    def wake(self) -> None:
        """Make :meth:`poll` return soon; callable from any thread."""

    def take(self, now_ns: int) -> tuple[int | None, list[_P]]:
        """Take new messages from all ports and forward them; write waiting messages.

        Return when the next call is due at the latest (None: nothing waits), and which ports to open again.
        """
        return None, []


class Waiting(Ports[_P]):
    """Ports that are not polled: only time and :meth:`wake` end their sleep."""

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
        """End the sleep; callable from any thread."""
        self._event.set()
