"""What both directions of a topic share: its object, its counters, its peer's life."""

from __future__ import annotations

import logging
import time
from abc import ABC, abstractmethod
from dataclasses import dataclass, field

from rosplc.bridge.repeats import QUIET_NS, RepeatedWarnings
from rosplc.bridge.status import ClassicStatus, TopicStatus
from rosplc.codec import Codec, Wire
from rosplc.config.objects import describe
from rosplc.config.resolve import TopicPlan
from rosplc.errors import BackendError, ChannelError, RosplcError
from rosplc.ros import Backend, EndpointStatus
from rosplc.shm import Liveness, Namespace, OwnedChannel, Region

__all__ = ["Counters", "Surroundings", "Topic", "log"]

log = logging.getLogger("rosplc.bridge")
_EXPLAINED_NS = 2_000_000_000


@dataclass(frozen=True)
class Surroundings:
    """What the topics of one bridge have in common.

    Attributes:
        namespace: The names of the objects.
        bridge: The bridge's name.
        bridge_id: 16 random bytes, drawn at start.
        distro: The ROS distribution.
        mode: Permission bits of the objects.
        uid: Their owner; None for this process's.
        gid: Their group; None for this process's.
        beat_ns: The beat that is promised.
        debounce_ns: How long silence must last beyond what a topic allows before it is reported, and how long
            its end.
        warnings: Where repeated warnings go.
    """

    namespace: Namespace
    bridge: str
    bridge_id: bytes
    distro: str
    mode: int = 0o660
    uid: int | None = None
    gid: int | None = None
    beat_ns: int = 100_000_000
    debounce_ns: int = 500_000_000
    warnings: RepeatedWarnings = field(default_factory=lambda: RepeatedWarnings(log))

    @property
    def beat_ms(self) -> int:
        """The promised beat in milliseconds."""
        return max(1, self.beat_ns // 1_000_000)


@dataclass
class Counters:
    """Messages of one topic; each is written by one thread."""

    received: int = 0
    published: int = 0
    unchanged: int = 0
    lost: int = 0
    refused: int = 0
    truncated: int = 0
    substituted: int = 0
    recovered: int = 0


class Topic(ABC):
    """One topic of a running bridge.

    Args:
        plan: What to carry, and how.
        around: What the bridge's topics share.

    Attributes:
        plan: As given.
        codec: Wire bytes to record and back.
        channel: The object; None while there is none.
        counters: What was counted since the start.
        peer_alive: Whether the PLC's side beats, as of the last check; None where that cannot be known.
    """

    def __init__(self, plan: TopicPlan, around: Surroundings) -> None:
        self.plan = plan
        self.around = around
        self.codec = Codec(plan.layout, Wire.ROS1 if plan.layout.store.ros_version == 1 else Wire.CDR)
        self.channel: OwnedChannel | None = None
        self.counters = Counters()
        self.last_ns: int | None = None
        self.problem = ""
        self._reason: tuple[str, str, int] | None = None  # words, code, when
        self._started_ns = time.monotonic_ns()
        self._alive: dict[int, tuple[int, Liveness]] = {}
        self.peer_alive: bool | None = False
        self._peer_gone_ns: int | None = None  # when the PLC's side, having been there, was missed first
        self._settled_ns = 0  # when a silence that was reported counts as over
        self._tasks: tuple[str, ...] = ()
        self._lost_before = 0
        self._rate = 0.0
        self._rate_from: tuple[int, int] = (self._started_ns, 0)

    # -- life

    def open(self) -> None:
        """Create or adopt the object.

        Raises:
            ChannelError: As :meth:`OwnedChannel.open`.
        """
        plan, around = self.plan, self.around
        description = describe(plan, distro=around.distro, bridge=around.bridge)
        channel = OwnedChannel.open(
            around.namespace,
            description,
            record_size=plan.layout.size,
            slots=plan.slots,
            mode=around.mode,
            uid=around.uid,
            gid=around.gid,
            bridge_id=around.bridge_id,
        )
        try:
            self._claim(channel)
        except BaseException:
            channel.close()
            raise
        self.channel = channel
        self._alive.clear()
        if channel.replaced_reason:
            # With an error's code it was damaged or something else's, and not just of an older configuration.
            level = logging.WARNING if channel.replaced_reason.endswith("]") else logging.INFO
            log.log(level, "%s: the object was replaced: %s", plan.topic, channel.replaced_reason)

    def close(self) -> None:
        """Leave the object with its last state."""
        channel, self.channel = self.channel, None
        self._unclaim()
        if channel is not None:
            channel.close()

    def retire(self) -> None:
        """Give the object up: whoever has it mapped is told, and its name is free."""
        channel = self.channel
        self._unclaim()
        if channel is not None:
            channel.retire()
        self.close()

    @abstractmethod
    def join(self, backend: Backend) -> None:
        """Subscribe or advertise."""

    def _check_backend(self, backend: Backend) -> None:
        """Raise BackendError ROS019 if the backend would pass over what the topic's QoS promises."""
        if self.plan.qos.promises and "deadline" not in backend.capabilities:
            what = f"the {backend.name} backend carries neither deadline nor lease"
            raise BackendError("ROS019", what, where=self.plan.topic)

    @abstractmethod
    def leave(self) -> None:
        """Take the endpoint off the graph; harmless twice."""

    @abstractmethod
    def _claim(self, channel: OwnedChannel) -> None:
        """Claim what this side claims of an object."""

    @abstractmethod
    def _unclaim(self) -> None:
        """Stop using the object."""

    @abstractmethod
    def beat(self) -> None:
        """Show that this side lives."""

    # -- housekeeping, about once a second

    def check(self, now_ns: int) -> bool:
        """Look after object, peer and rate; return whether the object must be opened again.

        Never calls the ROS side, which may hang while the beats go on.
        """
        self._count_rate(now_ns)
        channel = self.channel  # another thread may open it again meanwhile
        if channel is None:
            return True
        try:
            if not channel.still_there():
                self.note(now_ns, "the object was removed or replaced; it is created again", "SHM120")
                return True
            self._observe(channel.region, now_ns)
        except (ChannelError, ValueError, OSError) as error:
            self.fail(now_ns, error)
            return True
        return False

    def _count_rate(self, now_ns: int) -> None:
        since, count = self._rate_from
        if now_ns - since >= 500_000_000:
            self._rate = (self.counters.received - count) * 1e9 / (now_ns - since)
            self._rate_from = (now_ns, self.counters.received)

    def ask(self, now_ns: int) -> None:
        """Ask the ROS side: tell the PLC how many stand behind it, and note new losses."""
        endpoint = self.endpoint()
        if endpoint is not None:
            self._tell(endpoint.matched)
        lost = self._lost(endpoint)
        if lost > self._lost_before:
            # Whoever lost a message a moment ago may have said why, and better than this can.
            if self._reason is None or now_ns - self._reason[2] > _EXPLAINED_NS:
                self.note(now_ns, self._loss(lost - self._lost_before))
            self._lost_before = lost

    @abstractmethod
    def _tell(self, matched: int) -> None:
        """Write the number of ROS peers into the object."""

    def reopen(self, now_ns: int) -> bool:
        """Close the object and open its name again; return whether that succeeded."""
        try:
            self.close()
            self.open()
        except (RosplcError, OSError, ValueError) as error:
            self.fail(now_ns, error)
            return False
        self.problem = ""
        log.info("%s: the object stands again", self.plan.topic)
        return True

    @abstractmethod
    def _observe(self, region: Region, now_ns: int) -> None:
        """Judge the peer's life.

        Only the words needed are read: with 200 topics, whole snapshots would cost half a percent
        of a core.
        """

    def _lives(self, key: int, beat: int, beat_ms: int, count: int, now_ns: int) -> bool:
        known = self._alive.get(key)
        if known is None or known[0] != beat_ms:
            known = self._alive[key] = (beat_ms, Liveness(beat_ms))
        return known[1].observe(beat, count, now_ns)

    def _hear(self, now_ns: int) -> bool:
        """Note that a message came in; return whether its source was silent for too long before it."""
        since = self._started_ns if self.last_ns is None else self.last_ns
        limit, debounce = self.plan.stale_after_ns, self.around.debounce_ns
        self.last_ns = now_ns
        gap = now_ns - since
        if not limit or gap <= limit:
            return False
        if gap > limit + debounce or now_ns < self._settled_ns:
            self._settled_ns = now_ns + debounce
        self.counters.recovered += 1
        return True

    def _watch_peer(self, alive: bool, now_ns: int) -> None:
        """Keep whether the PLC's side lives, and since when it does not any more."""
        if alive:
            self._peer_gone_ns = None
        elif self.peer_alive:
            self._peer_gone_ns = now_ns
        self.peer_alive = alive

    # -- words

    def note(self, now_ns: int, words: str, code: str = "") -> None:
        """Remember and log what went wrong."""
        self._reason = (words, code, now_ns)
        suffix = f" [{code}]" if code else ""
        self.around.warnings.warn((self.plan.topic, code), now_ns, f"{self.plan.topic}: {words}{suffix}")

    def fail(self, now_ns: int, error: Exception) -> None:
        """Remember an error that keeps the topic from being carried until the object is reopened."""
        if isinstance(error, RosplcError):
            words, code = error.what, error.code
        else:
            words, code = str(error) or type(error).__name__, ""
        self.problem = f"{words} [{code}]" if code else words
        self.note(now_ns, words, code)

    @abstractmethod
    def endpoint(self) -> EndpointStatus | None:
        """Return the state of the ROS side's endpoint, None before there is one."""

    @abstractmethod
    def _lost(self, endpoint: EndpointStatus | None) -> int:
        """Return all losses of this direction."""

    @abstractmethod
    def _loss(self, count: int) -> str:
        """Say in words that messages were lost, and what helps."""

    @abstractmethod
    def _skipped(self) -> int:
        """Return what was held back on purpose."""

    def _substituting(self) -> bool:
        """Return whether something else is passed on in the source's place."""
        return False

    def classic_status(self, now_ns: int) -> ClassicStatus | None:
        """Return what can be known of a classic topic's memory and lock; None for a channel."""
        return None

    def status(self, now_ns: int) -> TopicStatus:
        """Return how the topic stands."""
        plan, count = self.plan, self.counters
        endpoint = self.endpoint()
        reason, code, when = self._reason or ("", "", 0)
        recent = bool(reason) and now_ns - when < QUIET_NS
        if endpoint is not None and endpoint.code and not recent:
            reason, code, recent = endpoint.reason, endpoint.code, True
        since = self._started_ns if self.last_ns is None else self.last_ns
        return TopicStatus(
            topic=plan.topic,
            type_name=plan.type_name,
            direction=plan.direction,
            matched=endpoint.matched if endpoint else 0,
            received=count.received,
            published=count.published,
            skipped=self._skipped(),
            lost=self._lost(endpoint),
            refused=count.refused + (endpoint.rejected if endpoint else 0),
            truncated=count.truncated,
            deadlines_missed=endpoint.late if endpoint else 0,
            rate_hz=self._rate,
            age_ns=None if self.last_ns is None else max(0, now_ns - self.last_ns),
            stale=bool(plan.stale_after_ns) and now_ns - since > plan.stale_after_ns,
            silent=bool(plan.stale_after_ns)
            and (now_ns - since > plan.stale_after_ns + self.around.debounce_ns or now_ns < self._settled_ns),
            substituting=self._substituting(),
            substituted=count.substituted,
            recovered=count.recovered,
            peer_alive=self.peer_alive,
            peer_gone_ns=None if self._peer_gone_ns is None else max(0, now_ns - self._peer_gone_ns),
            tasks=self._tasks,
            problem=self.problem,
            reason=reason,
            code=code,
            recent=recent,
            classic=self.classic_status(now_ns),
        )
