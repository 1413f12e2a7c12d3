"""The Read block: one ROS topic, as a program in a PLC sees it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, Literal

from rosplc.errors import ChannelError
from rosplc.layout import Layout, RecordView
from rosplc.shm import Attached, Direction, Namespace, Peer, Reader, ReaderClaim, SlotInfo
from rosplc.shm.constants import UNKNOWN, WRITER_LINE
from rosplc.virtual_plc.block import Block
from rosplc.virtual_plc.task import Scan

OnStale = Literal["hold", "zero", "value"]


class ReadBlock(Block):
    """Reads a topic once per scan; the stand-in for a generated ``<Type>_Read``.

    Call the instance in every scan, then use its outputs, which carry the names that they
    have in the PLC. A call waits for nothing and raises nothing about the other side: what
    is wrong is in ``udiError``.

    Args:
        topic: The topic as ROS writes it.
        layout: The compiled-in layout, as a PLC has it: an object with another one is
            refused with error 112. None takes the object's own description.
        prefix: The bridge's ``prefix:``.
        directory: Where the objects stand.
        stale_after: Seconds without a new message after which ``xStale`` is set; None: never.
        on_stale: What ``msg`` is then: ``hold`` the last message, ``zero`` every byte zero, ``value``
            what ``stale_value`` gives.
        stale_value: Field values for ``on_stale="value"``; fields left out are initial.
        mode: ``latest`` skips to the newest message and counts the skipped ones as lost;
            ``every`` takes them in order: one per call, :meth:`next` for more.
        max_per_cycle: With ``every``: at most so many messages in one scan.
        latched: Take the message that is there at the first attach as new.
        beat_ms: The longest time between two calls that this block promises; tools take the
            PLC for gone after three of them.

    Attributes:
        xAttached: The object is open and fits.
        xValid: ``msg`` holds a message (or, once stale, what ``on_stale`` asks for).
        xNew: This call brought a new message.
        xStale: No new message for longer than ``stale_after``, or none yet.
        xPeerAlive: The bridge beats.
        xFirst: The message is marked as the first after its writer started, or after its source was silent.
        xRecovered: With ``xNew``: the first message after a start, after ``xStale``, or of another writer.
        xTruncated: Something was cut off to make the message fit.
        xSubstituted: ``msg`` is no message of the source: a configured value takes its place.
        udiSequence: The sequence number of the message in ``msg``.
        udiLost: Messages missed since the first one that this block took.
        udiError: 0, or a number of spec/shm-format.md, section 9.
        uiTaken: Messages taken in this scan.
        udiSources: ROS publishers of the topic; None if unknown (16#FFFFFFFF in the PLC), as without a
            bridge that lives.
        xSourcePresent: The bridge lives and knows a ROS publisher of the topic.
        age: Seconds since the last new message (before the first: since the first call), by
            this block's own clock; ``tAge`` in the PLC.
        msg: The message as a typed view, or None before the type is known.
        info: Slot header of the message in ``msg`` (stamp, flags), or None.
        reason: ``udiError`` in words.
    """

    def __init__(
        self,
        topic: str,
        *,
        layout: Layout | None = None,
        prefix: str = "rosplc",
        directory: str = "/dev/shm",
        stale_after: float | None = 1.0,
        on_stale: OnStale = "hold",
        stale_value: Mapping[str, Any] | None = None,
        mode: Literal["latest", "every"] = "latest",
        max_per_cycle: int = 8,
        latched: bool = False,
        beat_ms: int = 1000,
    ) -> None:
        if stale_after is not None and not stale_after > 0:
            raise ValueError(f"{topic}: stale_after must be above 0 s, or None, not {stale_after}")
        if max_per_cycle < 1:
            raise ValueError(f"{topic}: max_per_cycle must be at least 1")
        if (on_stale == "value") != (stale_value is not None):
            raise ValueError(f'{topic}: on_stale="value" and stale_value go together')
        super().__init__(topic, Namespace(prefix, directory), Direction.TO_PLC, layout, beat_ms)
        self.xValid = self.xNew = False
        self.xFirst = self.xTruncated = self.xSubstituted = self.xRecovered = False
        self.xSourcePresent = False
        self.xStale = stale_after is not None
        self.udiLost = self.uiTaken = 0
        self.udiSources: int | None = None
        self.age = 0.0
        self.msg: RecordView | None = None
        self.info: SlotInfo | None = None
        self._stale_after_ns = None if stale_after is None else round(stale_after * 1e9)
        self._on_stale = on_stale
        self._stale_value = stale_value
        self._stale_record = b""
        self._every = mode == "every"
        self._max_per_cycle = max_per_cycle
        self._latched = latched
        self._claim: ReaderClaim | None = None
        self._reader: Reader | None = None
        self._shadow = bytearray()
        self._record = bytearray()
        self._ever_new = False
        self._writer = 0  # claim of the writer whose message was taken last
        self._since_ns: int | None = None
        if layout is not None:
            self._use_layout(layout)

    def next(self) -> bool:
        """With ``mode="every"``: take one more message in this scan and return whether there was one.

        ``msg`` then shows it; ``xNew`` stays set, as in the PLC.
        """
        if not self._every:
            return False
        with self._entered() as scan:
            # A link that found another object in this scan has closed the one of this reader.
            if scan is None or self._reader is None or self._opened_times != self._opened:
                return False
            try:
                return self._take(self._reader, scan)
            except ChannelError as error:
                self._drop(error)
                self._reader = self._claim = None
                return False

    def each(self) -> Iterator[RecordView]:
        """Run the block and yield ``msg`` for each message that this scan may take.

        The view shows the next message after each step, so copy what must outlive it.
        """
        more = self()
        while more and self.msg is not None:
            yield self.msg
            more = self.next()

    def close(self) -> None:
        """Let go of the object; the next call opens it again."""
        self._detach()
        self._reader = self._claim = None
        self.xAttached = self.xPeerAlive = False

    def _run(self, scan: Scan) -> bool:
        self.xNew = self.xRecovered = self.xSourcePresent = False
        self.udiSources = None
        self.uiTaken = 0
        if self._since_ns is None:
            self._since_ns = scan.now_ns
        try:
            attached = self._follow(scan)
            if attached is not None and self._opened_times != self._opened:
                self._adopt(attached, scan)
            if attached is not None and self._reader is not None:
                if self._claim is not None and self._claim.attempt(scan.now_ns):
                    self._claim = None
                self._take(self._reader, scan)
                self._reader.beat()
                self._watch(attached, scan)
        except ChannelError as error:  # retired between the check and the copy, or not readable
            self._drop(error)
        self.xAttached = self._attached is not None
        if not self.xAttached:
            self.xPeerAlive = False
            self._reader = self._claim = None
        self.udiError, self.reason = self._failure
        self._report_silence()
        self._judge_age(scan)
        return self.xNew

    def _adopt(self, attached: Attached, scan: Scan) -> None:
        layout = self.layout
        assert layout is not None  # an open link has one
        latched = self._latched and self._opened == 0
        self._reader = attached.reader(latched=latched)
        # The line is for people who ask who reads; reading itself does not depend on it.
        self._claim = None
        if attached.region.writable:
            self._claim = ReaderClaim(attached.region, self._reader, self._beat_ms, scan.task, range(4))
        self._opened = self._opened_times
        self._peer = Peer()
        if self.msg is None or len(self._record) != layout.size:
            self._use_layout(layout)
        if not latched:
            # Rule M14: what was published before is in msg, valid but never new.
            info = self._reader.peek(self._shadow)
            if info is not None:
                self._show(info)

    def _use_layout(self, layout: Layout) -> None:
        self._shadow = bytearray(layout.size)
        self._record = bytearray(layout.initial())
        self.msg = layout.view(self._record)
        self.xValid = False
        # Packed once: a wrong stale_value then shows at the first opening, not when data stops.
        value = self._stale_value
        self._stale_record = bytes(layout.size) if value is None else bytes(layout.pack(value))

    def _take(self, reader: Reader, scan: Scan) -> bool:
        if self._every and self.uiTaken >= self._max_per_cycle:
            return False
        info = reader.next(self._shadow) if self._every else reader.latest(self._shadow)
        if info is None:
            return False
        self.uiTaken += 1
        self.udiLost += info.lost
        self._show(info)
        # The mark may be on a skipped message; a change of the claim and the silence are still seen.
        assert self._attached is not None
        epoch = self._attached.region.words(WRITER_LINE["writer_epoch"], 1)[0]
        another = epoch not in (0, self._writer)
        self.xRecovered = self.xFirst or self.xStale or another or not self._ever_new
        self._writer = epoch or self._writer
        self.xNew = self._ever_new = True
        self._since_ns = scan.now_ns
        return True

    def _show(self, info: SlotInfo) -> None:
        # Only a copy that passed the re-check reaches msg (shadow, spec M12).
        self._record[:] = self._shadow
        self.info, self.udiSequence, self.xValid = info, info.sequence, True
        self.xFirst, self.xTruncated, self.xSubstituted = (bool(info.flags & bit) for bit in (1, 2, 4))

    def _watch(self, attached: Attached, scan: Scan) -> None:
        state = attached.snapshot().writer
        peer = self._peer
        peer.observe(state.beat, state.head, state.beat_ms, scan.now_ns)
        self.xPeerAlive = peer.alive
        if peer.alive and state.sources != UNKNOWN:  # what a dead bridge knew last says nothing about now
            self.udiSources = state.sources
            self.xSourcePresent = state.sources > 0
        if peer.silent:
            self._look_for_another(scan)

    def _judge_age(self, scan: Scan) -> None:
        age_ns = max(0, scan.now_ns - (scan.now_ns if self._since_ns is None else self._since_ns))
        self.age = age_ns / 1e9
        limit = self._stale_after_ns
        self.xStale = limit is not None and (age_ns > limit or not self._ever_new)
        if self.xStale and self._on_stale != "hold" and self.msg is not None:
            # At every scan, so that a state found at the start does not show either.
            self._record[:] = self._stale_record
            self.xSubstituted = True
