"""Ports over the shared-memory channel: spec/shm-format.md."""

from __future__ import annotations

import logging
from abc import abstractmethod
from collections import defaultdict
from contextlib import suppress
from typing import Any, Generic, TypeVar

from rosplc.bridge.port import STILL_TURNS, Context, Port, Ports, Waiting, log
from rosplc.bridge.status import PortStatus
from rosplc.bridge.stream import Stream
from rosplc.codec import Fault
from rosplc.config.resolve import describe
from rosplc.errors import ChannelError
from rosplc.shm import Group, OwnedChannel, Peer, Reader, Sink, Writer, distance
from rosplc.shm.constants import (
    LINE_SIZE,
    READER_LINE,
    READER_LINES,
    READER_LINES_OFFSET,
    WRITER_LINE,
    reader_line,
)
from rosplc.shm.header import task_name

_U = TypeVar("_U", Writer, Reader)
_P = TypeVar("_P", bound=Port)

_IN_ORDER = 1
_LINE_WORDS = LINE_SIZE // 4
_LONGEST_WAIT_NS = 200_000_000
LAZY_TICK_NS = 10_000_000
"""The tick while no PLC is running: an idle bridge's CPU use comes from these wake-ups."""
_ALERT_NS = 10_000_000_000
"""How long the configured tick applies after a message, with or without a writer's heartbeat."""


class ChannelPort(Port, Generic[_U]):
    """One channel that this bridge owns; ``channel`` and ``user``, its writer or reader, may be None."""

    def __init__(self, side: Stream, context: Context) -> None:
        self.side = side
        self.channel: OwnedChannel | None = None
        self.user: _U | None = None
        self.adopted = False
        self._context = context
        self._peers: defaultdict[int, Peer] = defaultdict(Peer)
        self.peer_alive = False
        self._peer_gone_ns: int | None = None
        self._checks = id(self) >> 4  # not all at once
        self._tasks: tuple[str, ...] = ()
        self._known: tuple[tuple[Any, ...], PortStatus] = ((), PortStatus())

    def open(self) -> None:
        """Create or adopt the object. Raises as :meth:`OwnedChannel.open`."""
        plan, context = self.side.plan, self._context
        channel = OwnedChannel.open(
            context.namespace,
            describe(plan, distro=context.distro, bridge=context.bridge),
            record_size=plan.layout.size,
            slots=plan.slots,
            rights=context.rights,
            bridge_id=context.bridge_id,
        )
        try:
            self.user = self._claim(channel)
        except BaseException:
            channel.close()
            raise
        context.beating[self] = self.user
        self.channel, self.adopted = channel, channel.adopted
        self._peers.clear()
        if channel.replaced_reason:
            # With an error's code it was damaged or something else's, and not just of an older configuration.
            level = logging.WARNING if channel.replaced_reason.endswith("]") else logging.INFO
            log.log(level, "%s: the object was replaced: %s", plan.topic, channel.replaced_reason)

    def close(self) -> None:
        """Close the object, which keeps its last state."""
        self._context.beating.pop(self, None)
        channel, self.channel, self.user = self.channel, None, None
        if channel is not None:
            channel.close()

    def retire(self) -> None:
        """Retire the object: its users are notified, and its name becomes free."""
        if (channel := self.channel) is not None:
            channel.retire()
        self.close()

    @abstractmethod
    def _claim(self, channel: OwnedChannel) -> _U:
        """Claim this side's line of an object."""

    def check(self, now_ns: int) -> bool:
        """Check the object and the PLC; return whether the object must be opened again."""
        channel = self.channel  # another thread may open it again meanwhile
        if channel is None:
            return True
        self._checks += 1
        if not (self.side.still and self._checks % STILL_TURNS) and not channel.still_there():
            self.side.note(now_ns, "the object was removed or replaced; creating it again", "SHM120")
            return True
        tasks, alive = self._tasks, self._observe(channel, now_ns)
        if alive:
            self._peer_gone_ns = None
        elif self.peer_alive:
            self._peer_gone_ns = now_ns
        if alive != self.peer_alive or tasks != self._tasks:
            self.peer_alive, self.side.still = alive, False
        return not self.owned()

    @abstractmethod
    def _observe(self, channel: OwnedChannel, now_ns: int) -> bool:
        """Return whether the PLC's side sends heartbeats."""
        # Reads only the words needed: with 200 topics, whole snapshots would cost half a percent of a core.

    def status(self, now_ns: int) -> PortStatus:
        """Return the known state of the PLC."""
        return self._status(now_ns)

    def _status(self, now_ns: int, lost: int = 0, skipped: int = 0) -> PortStatus:
        gone = None if self._peer_gone_ns is None else max(0, now_ns - self._peer_gone_ns)
        alive, tasks = self.peer_alive, self._tasks
        basis = skipped, lost, alive, gone, tasks
        before, status = self._known
        if basis != before:
            status = PortStatus(skipped=skipped, lost=lost, peer_alive=alive, peer_gone_ns=gone, tasks=tasks)
            self._known = basis, status
        return status


class PortToPlc(ChannelPort[Writer]):
    """A channel that the bridge writes."""

    def __init__(self, side: Stream, context: Context) -> None:
        super().__init__(side, context)
        self.sink = Sink()

    def open_sink(self, limit_ns: int) -> None:
        """Let messages pass directly into the channel."""
        if (writer := self.user) is not None:
            with suppress(ValueError):  # closed at this moment
                self.sink.open(writer, self.side.codec.plan, self.side.plan.truncate, limit_ns)

    def close(self) -> None:
        """Close the object, which keeps its last state."""
        self.sink.close()
        super().close()

    def _claim(self, channel: OwnedChannel) -> Writer:
        writer = channel.writer(self._context.beat_ms)
        self.side.renewed()
        return writer

    def owned(self) -> bool:
        """Return whether the writer works."""
        return self.user is not None

    def put(self, data: bytes, stamp_ns: int, flags: int, now_ns: int) -> None:
        """Convert a message directly into its slot."""
        writer, side = self.user, self.side
        if writer is None:
            side.counters.lost += 1
            return
        try:
            _, cut = writer.publish_wire(
                side.codec.plan,
                data,
                truncate=side.plan.truncate,
                stamp_ns=stamp_ns,
                stamp_clock=1 if stamp_ns else 0,
                flags=flags,
            )
        except Fault as fault:
            side.refuse(fault, now_ns)
        except (ChannelError, ValueError) as error:
            # Retired, damaged, claimed or just closed: the next check opens the name again.
            side.counters.lost += 1
            side.renewed()
            if self.user is writer:
                self._context.beating.pop(self, None)
                self.user = None
                side.fail(now_ns, error)
        else:
            side.delivered(data, cut)

    def _observe(self, channel: OwnedChannel, now_ns: int) -> bool:
        region, tasks = channel.region, []
        for index, claim in enumerate(region.words(READER_LINES_OFFSET, READER_LINES, _LINE_WORDS)):
            if claim:
                _, beat, beat_ms, taken = region.words(reader_line(index), 4)
                if self._peers[index].observe(beat, taken, beat_ms, now_ns):
                    tasks.append(task_name(region.words(reader_line(index) + READER_LINE["task"], 4)))
        self._tasks = tuple(tasks)
        return bool(tasks)

    def tell(self, matched: int) -> None:
        """Show the PLC the number of publishers."""
        if (writer := self.user) is not None:
            writer.set_sources(matched)

    def loss(self, count: int) -> str:
        """Describe why messages were lost, and the remedy."""
        return f"{count} messages from ROS were lost; raise qos: {{depth: …}} if messages arrive in bursts"


class PortToRos(ChannelPort[Reader]):
    """A channel that the bridge reads."""

    def __init__(self, side: Stream, context: Context) -> None:
        super().__init__(side, context)
        self._lost_before = 0  # by readers that are no more
        self._retained = False
        self._missed = 0  # while no bridge was running
        self._down_ns = 0
        self._lived = 0  # the claim of the writer that was seen alive

    def _claim(self, channel: OwnedChannel) -> Reader:
        reader = channel.reader(self._context.beat_ms)
        head = channel.region.word(WRITER_LINE["head"])
        ahead = distance(reader.last, head, channel.identity.slot_count) if head and reader.last else 0
        self._retained = channel.adopted and bool(head) and not ahead
        self._missed = max(0, ahead - (channel.identity.slot_count - 1)) if channel.adopted else 0
        self._down_ns = channel.unowned_ns
        return reader

    def close(self) -> None:
        """Close the object, which keeps its last state."""
        self._lost_before += 0 if self.user is None else self.user.lost
        super().close()

    def owned(self) -> bool:
        """Return whether this reader still holds its line: another bridge's claim is detected immediately."""
        reader = self.user
        return reader is not None and reader.line is not None

    def retained(self) -> tuple[bytes, int, int] | None:
        """Return the message in the object if an earlier bridge has taken it."""
        if not self._retained or self.user is None:
            return None
        found = self.user.peek_wire(self.side.codec.plan)
        if found is None or found[1].sequence != self.user.last:
            return None  # a newer one has come since, and will be taken
        return found[0], found[1].stamp_ns, found[1].stamp_clock

    def _observe(self, channel: OwnedChannel, now_ns: int) -> bool:
        head, epoch, beat, beat_ms = channel.region.words(WRITER_LINE["head"], 4)
        # A program that writes now and then promises no beat: its silence tells nothing, its process does.
        quiet = bool(epoch) and not beat_ms
        runs = channel.process.runs(epoch, channel.region.word(WRITER_LINE["writer_pid"])) if quiet else None
        if self._peers[0].observe(beat, head, beat_ms, now_ns):
            self._lived = epoch
            return bool(epoch)
        return quiet and (epoch == self._lived if runs is None else runs)

    def tell(self, matched: int) -> None:
        """Show the PLC the number of subscribers."""
        if (reader := self.user) is not None:
            reader.set_sinks(matched)

    def status(self, now_ns: int) -> PortStatus:
        """Return the known state of the PLC."""
        reader = self.user
        lost = self._lost_before + (0 if reader is None else reader.lost)
        every = self.side.plan.every
        return self._status(now_ns, lost if every else 0, 0 if every else lost)

    def loss(self, count: int) -> str:
        """Describe why messages were lost; losses while no bridge was running are listed separately, once."""
        missed, self._missed = min(self._missed, count), 0
        slots = self.side.plan.slots
        lost = f"{count - missed} messages from the PLC were lost; raise slots: (now {slots})"
        if not missed:
            return lost
        down = f"no bridge was running for {self._down_ns / 1e9:.3g} s: {missed} messages were not carried"
        return down if missed == count else f"{down}; {lost}"


class ChannelsToPlc(Waiting[PortToPlc]):
    """The channels that the bridge writes: messages are written immediately, and nothing is polled."""

    def make(self, side: Stream) -> PortToPlc:
        """Return the port of a stream."""
        return PortToPlc(side, self._context)


class Grouped(Ports[_P]):
    """Ports that are polled for messages with one native call per tick."""

    def __init__(self, context: Context, tick_ns: int) -> None:
        self._context = context
        self._now = context.clock.monotonic_ns
        self._tick_ns = tick_ns
        self._group = Group(predict=True)
        self._ports: dict[int, _P] = {}  # by the numbers of their readers in the group

    def remove(self, port: _P) -> None:
        """Stop polling a port."""
        for index in [index for index, known in self._ports.items() if known is port]:
            self._group.remove(index)
            del self._ports[index]

    def wake(self) -> None:
        """End the sleep."""
        self._group.wake()

    def _wait(self, tick_ns: int, longest_ns: int, due_ns: int | None, scan_ns: int = 0) -> int:
        left = longest_ns if due_ns is None else max(0, min(longest_ns, due_ns - self._now()))
        return self._group.wait(tick_ns, left, scan_ns)


class ChannelsToRos(Grouped[PortToRos]):
    """The channels that the bridge reads."""

    _alert_until_ns = 0

    def make(self, side: Stream) -> PortToRos:
        """Return the port of a stream."""
        return PortToRos(side, self._context)

    def add(self, port: PortToRos) -> None:
        """Poll an open port for messages."""
        if port.user is not None:
            plan = port.side.plan
            mode = _IN_ORDER if plan.every else 0
            index = self._group.add_reader(port.user, port.side.codec.plan, mode, plan.slots)
            self._ports[index] = port
            if port.sink is not None:
                self._group.divert(index, port.sink.capsule)

    def poll(self, due_ns: int | None) -> None:
        """Sleep until a poll finds something new: one per tick, or after a quiet time one per PLC scan."""
        now = self._now()
        if self._wait(self.tick(now), _LONGEST_WAIT_NS, due_ns, (now > self._alert_until_ns) * LAZY_TICK_NS):
            self._alert_until_ns = self._now() + _ALERT_NS

    def tick(self, now_ns: int) -> int:
        """Return the time between two polls: longer while no PLC writes."""
        if now_ns < self._alert_until_ns or any(port.peer_alive for port in self._ports.values()):
            return self._tick_ns
        return max(self._tick_ns, LAZY_TICK_NS if self._ports else _LONGEST_WAIT_NS)

    def take(self, now_ns: int) -> tuple[int | None, list[PortToRos]]:
        """Take all new messages from all channels in one call, and forward them."""
        messages, faults = self._group.take()
        ports = self._ports
        for index, data, _sequence, flags, stamp_ns, stamp_clock in messages:
            try:
                ports[index].side.receive(data, flags, stamp_ns, stamp_clock)
            except Exception:  # what was taken for the other streams must still be sent
                log.exception("%s: forwarding a message failed", ports[index].side.plan.topic)
        again = []
        for index, fault in faults:
            port = ports[index]
            if isinstance(fault, Fault):
                port.side.counters.received += 1
                port.side.refuse(fault, now_ns)
            else:
                port.side.fail(now_ns, fault)
                again.append(port)
        return None, again
