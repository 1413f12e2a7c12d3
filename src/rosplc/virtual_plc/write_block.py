"""The Write block: one topic towards ROS, as a program in a PLC fills it."""

from __future__ import annotations

import time
from typing import Any

from rosplc.errors import ChannelError
from rosplc.layout import Layout
from rosplc.shm import Attached, Direction, Namespace, Writer, WriterClaim
from rosplc.shm.constants import STAMP_PLC, UNKNOWN, ErrorNumber
from rosplc.virtual_plc.block import Block, Peer
from rosplc.virtual_plc.link import error_number
from rosplc.virtual_plc.message import Message
from rosplc.virtual_plc.scan import Scan

__all__ = ["WriteBlock"]


class WriteBlock(Block):
    """Publishes ``msg`` on a topic; the stand-in for a generated ``<Type>_Write``.

    Set ``msg`` and ``xEnable``, then call the instance once per scan: each call with
    ``xEnable`` publishes one message. A call waits for nothing and raises nothing about
    the other side: what is wrong stands in ``udiError``.

    Args:
        topic: The topic as ROS writes it.
        layout: The compiled-in layout, as a PLC has it; None takes the object's own
            description, and ``msg`` is then None until the object is open.
        prefix: The bridge's ``prefix:``.
        directory: Where the objects stand.
        beat_ms: The longest time between two calls that this block promises; the bridge
            takes the PLC for gone after three of them.

    Attributes:
        msg: The message to send; every field can be set. None before the type is known.
        xEnable: Whether a call publishes; False, as it is at first, sends nothing but the beat.
        xAttached: The object is open and fits.
        xReady: The object is open and the claim is this block's: a call will publish.
        xPeerAlive: The bridge beats.
        xPublished: This call published.
        udiSequence: The sequence number of the last published message.
        udiPublished: Messages published since the start.
        udiTaken: The sequence number that the bridge has taken.
        udiSinks: ROS subscribers behind the bridge; None if unknown, as without a bridge that lives.
        udiError: 0, or a number of spec/shm-format.md, section 9.
        reason: ``udiError`` in words.
    """

    def __init__(
        self,
        topic: str,
        *,
        layout: Layout | None = None,
        prefix: str = "rosplc",
        directory: str = "/dev/shm",
        beat_ms: int = 1000,
    ) -> None:
        super().__init__(topic, Namespace(prefix, directory), Direction.TO_ROS, layout, beat_ms)
        self.msg: Any = None if layout is None else Message.initial(layout)
        self.xEnable = False
        self.xReady = self.xPublished = False
        self.udiPublished = self.udiTaken = 0
        self.udiSinks: int | None = None
        self._claim: WriterClaim | None = None
        self._writer: Writer | None = None
        self._record = bytearray(0 if layout is None else layout.size)
        self._unfilled = False  # msg was made in this call: what the program filled was another

    def __call__(self) -> bool:
        """Run the block once and return ``xPublished``.

        Raises:
            LayoutError: LAY006, if a value in ``msg`` does not fit its field.
        """
        with self._entered() as scan:
            if scan is None:
                return self._refuse()
            self._run(scan)
            return self.xPublished

    def close(self) -> None:
        """Release the claim and let go of the object; the next call opens it again."""
        if self._writer is not None:
            self._writer.release()
        self._link.close()
        self._writer = self._claim = None
        self._peer = Peer()
        self.xReady = False

    def _run(self, scan: Scan) -> None:
        self.xPublished = self._unfilled = False
        attached = self._link.follow(scan)
        if attached is not None and self._link.opened != self._opened:
            self._adopt(attached)
        if attached is not None:
            if self._writer is None:
                self._claim_line(attached, scan)
            if self._writer is not None:
                self._publish(self._writer)
        if self._link.attached is not None:
            self._watch(self._link.attached, scan)
        else:
            self.xReady = self.xPeerAlive = False
            self.udiSinks = None
            self._writer = self._claim = None
            self.udiError, self.reason = self._link.error, self._link.reason
        self.xAttached = self._link.attached is not None

    def _adopt(self, attached: Attached) -> None:
        layout = self._link.layout
        assert layout is not None  # an open link has one
        self._opened = self._link.opened
        self._writer = self._claim = None
        self._peer = Peer()
        self.xReady = False
        if self.msg is None or len(self._record) != layout.size:
            self._record = bytearray(layout.size)
            self.msg = Message.initial(layout)
            self._unfilled = True

    def _claim_line(self, attached: Attached, scan: Scan) -> None:
        self.xReady = False
        try:
            if self._claim is None:
                self._claim = attached.writer_claim(self._beat_ms)
            self._writer = self._claim.attempt(scan.now_ns)
        except ChannelError as error:
            self._link.drop(error)
            return
        if self._writer is None:
            # It may stop, so the next scans look again.
            self.udiError, self.reason = ErrorNumber.CLAIMED.value, "another writer holds the claim"
        else:
            self._claim = None
            self.udiError, self.reason = 0, ""

    def _publish(self, writer: Writer) -> None:
        layout = self._link.layout
        assert layout is not None
        try:
            if self.xEnable and not self._unfilled:
                layout.pack_into(self.msg, self._record)
                self.udiSequence = writer.publish(
                    self._record, stamp_ns=time.monotonic_ns(), stamp_clock=STAMP_PLC
                )
                self.udiPublished += 1
                self.xPublished = True
            else:
                writer.check()
                writer.beat()
        except ChannelError as error:
            self._writer, self.xReady = None, False
            if error.code == "SHM115":
                # Whoever has it now keeps it: a new claim waits for that one's silence.
                self.udiError, self.reason = error_number(error), str(error)
            else:
                self._link.drop(error)
            return
        self.xReady = True
        self.udiError, self.reason = 0, ""

    def _watch(self, attached: Attached, scan: Scan) -> None:
        state = attached.snapshot()
        line = state.readers[0]
        peer = self._peer
        peer.observe(line.beat, line.taken, line.beat_ms, scan.now_ns)
        self.xPeerAlive = peer.alive
        self.udiTaken = line.taken
        self.udiSinks = line.sinks if peer.alive and line.sinks != UNKNOWN else None
        if peer.silent:
            self._report_silence()
            self._link.look_for_another(scan)
