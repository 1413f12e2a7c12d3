"""The two sides of a call: spec/shm-format.md, section 11 (M25 to M30).

Neither side waits or interprets records. Messages are sent by a function that is called with
``correlation``, ``status`` and ``client``: ``partial(writer.publish, record)``, or
``partial(writer.publish_wire, plan, data)``.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Iterator
from typing import Final, Literal

from rosplc._core import Reader, SlotInfo, Writer
from rosplc.errors import ChannelError
from rosplc.reasons import Reason
from rosplc.shm import constants as spec
from rosplc.shm.attach import Mapped
from rosplc.shm.constants import READER_LINE

Send = Callable[..., object]
ENDS: Final = frozenset(range(spec.ANSWER_DONE, spec.ANSWER_ABORTED + 1)) - {spec.ANSWER_ACCEPTED}
"""The answers that end a call."""
WORDS: Final = {
    Reason.NONE: "the reason is unknown",
    Reason.NO_SERVER: "no server was ready",
    Reason.TIME_OUT: "no answer arrived within the time limit",
    Reason.REJECTED: "the request was refused",
    Reason.QUEUE_FULL: "too many calls are waiting",
    Reason.EXPIRED: "the request was in the queue for too long",
    Reason.CALLER_GONE: "the caller is no longer waiting",
    Reason.PLC_DOWN: "the PLC program stopped, restarted or is silent",
    Reason.BRIDGE_RESTARTED: "the bridge was restarted",
    Reason.TOO_LARGE: "the message does not fit into the record",
    Reason.SERVER_GONE: "the server went offline before it answered",
    Reason.SERVER_FAILED: "the server reported a failure",
}
"""The reasons why a call ended, as text."""
_LINE_0 = spec.reader_line(0)


class Caller:
    """The caller's side of one request or goal object, mapped writable: one call at a time (M25).

    With ``follows_claim``, a call ends when the answerer's claim changes. This is for a bridge that calls the
    PLC, but not for a PLC, whose call is answered by the restarted bridge (M27).
    """

    def __init__(self, asks: Mapped, writer: Writer, *, follows_claim: bool) -> None:
        self.correlation = 0  # the open call's number; 0 while none is open
        self.late = 0  # answers dropped because they were not the open call's (M28)
        self._asks = asks
        self._writer = writer
        self._follows_claim = follows_claim
        self._counter = 0
        self._client = b""
        self.claimed = 0
        self._first = 0
        self._begun = False  # what was taken stays so, whatever the line says later

    def claim(self) -> int:
        """Return the answerer's claim of line 0; 0: there is no answerer, and no call may be handed out."""
        return self._asks.region.word(_LINE_0)

    def call(self, send: Send, *, client: bytes = b"") -> int:
        """Hand out a call, and return its number. RuntimeError while a call is open; else as ``send``."""
        if self.correlation:
            raise RuntimeError("a call is open")
        counter = self._counter + 1 & 0xFFFFFFFF or 1
        correlation = self._writer.epoch << 32 | counter
        self.claimed = self.claim()
        send(correlation=correlation, status=spec.ASK_CALL, client=client)
        self.correlation, self._counter = correlation, counter
        self._client = client
        self._first, self._begun = self._writer.head, False
        return correlation

    def again(self, send: Send, status: int) -> None:
        """Publish the open call again with ``status`` added, for example ``ASK_CANCEL``."""
        send(correlation=self.correlation, status=spec.ASK_CALL | status, client=self._client)

    def withdraw(self, send: Send) -> bool:
        """Withdraw the open call (M26), and return whether it may have begun.

        If not, it has ended without execution. Otherwise, it remains open: an answer may still arrive.
        """
        self.again(send, spec.ASK_WITHDRAWN)
        if self.begun():
            return True
        self.correlation = 0
        return False

    def begun(self) -> bool:
        """Return whether the answerer may have begun the open call; definite after the call is withdrawn."""
        self._begun = self._begun or self._writer.begun(self._first)
        return self._begun

    def lost(self, send: Send) -> int:
        """Return how the open call ended because the answerer's claim changed (M27); 0 if it did not end."""
        if not (self.correlation and self._follows_claim) or self.claim() == self.claimed:
            return 0
        try:
            begun = self.withdraw(send)
        except ChannelError:  # not withdrawn: who knows
            begun = True
        return self._end(begun)

    def retired(self) -> int:
        """Return how the open call ended because the objects were retired or replaced; for a PLC."""
        return self._end(self.begun()) if self.correlation else 0

    def answer(self, info: SlotInfo) -> int:
        """Return a message's answer to the open call, ``info.status & ANSWER_MASK``; 0 if it is none."""
        if info.correlation != self.correlation or not self.correlation:
            self.late += 1
            return 0
        outcome = info.status & spec.ANSWER_MASK
        if outcome == spec.ANSWER_NOT_EXECUTED and self._follows_claim and self.claim() != self.claimed:
            return 0  # said by one who cannot know; lost() does
        if outcome in ENDS:
            self.correlation = 0
        return outcome

    def resume(self, info: SlotInfo) -> None:
        """Take over the previous writer's unanswered call in its newest message."""
        taken = self._asks.region.word(_LINE_0 + READER_LINE["taken"])
        last = self._asks.slot(taken)
        of_this_call = last is None or last.correlation == info.correlation
        self.correlation, self._client = info.correlation, info.client
        self._first = taken if taken and of_this_call else info.sequence
        self.claimed, self._begun = info.reason or self.claim(), False

    def _end(self, begun: bool) -> int:
        self.correlation = 0
        return spec.ANSWER_FATE_UNKNOWN if begun else spec.ANSWER_NOT_EXECUTED


class Answerer:
    """The answerer's side of one request or goal object, whose reader has just claimed line 0."""

    def __init__(self, asks: Mapped, reader: Reader, answers: Mapped) -> None:
        self.correlation = 0  # the number of the call that is being carried out; 0 while there is none
        before = asks.slot(reader.last)
        newest = answers.slot(answers.region.word(spec.WRITER_LINE["head"]))  # response or result
        # a call that an earlier answerer may have begun and has not answered; 0 if there is none. A
        # bridge answers it at once (``BRIDGE_RESTARTED``); in a PLC the caller ends it.
        self.unanswered = before.correlation if before else 0
        self._answered = 0
        if newest and newest.status & spec.ANSWER_MASK in ENDS:
            self.answered(newest.correlation)
        self._reader = reader

    def take(self, info: SlotInfo) -> Literal["begin", "more", "withdrawn", "unknown", ""]:
        """Classify a message just taken with :meth:`Reader.latest`.

        ``begin``: a call to execute, now ``correlation``. ``more``: a newer message of that call.
        ``withdrawn``: a call that was not begun and must not be; answer ``NOT_EXECUTED``. ``unknown``: a
        call that an earlier answerer may have begun; answer ``FATE_UNKNOWN``. Empty: nothing to do.
        """
        if not self._reader.begin() or info.correlation in (0, self._answered):
            return ""
        if info.correlation == self.correlation:
            return "more"
        if info.correlation == self.unanswered:
            return "unknown"
        if info.status != spec.ASK_CALL:
            return "withdrawn"
        self.correlation = info.correlation
        return "begin"

    def answered(self, correlation: int) -> None:
        """Note that a call was ended with an answer: a second answer is not sent (M29)."""
        self._answered = correlation
        if correlation == self.correlation:
            self.correlation = 0
        if correlation == self.unanswered:
            self.unanswered = 0


class GoalNotes:
    """A bridge's notes for the next bridge about its open goal, after the slots of the goal object (M30)."""

    def __init__(self, goals: Mapped) -> None:
        identity, self._region = goals.identity, goals.region
        self._at = identity.slots_offset + identity.slot_count * identity.slot_stride
        self._number, self._found = 0, {}
        there = identity.object_size >= self._at + spec.GOAL_NOTES_SIZE
        for number, uuid, note in sorted(self._entries() if there else ()):
            self._number, self._found[uuid] = number, note

    def _entries(self) -> Iterator[tuple[int, bytes, bytes]]:
        for index in range(spec.GOAL_NOTES):
            image = self._region.read(self._at + index * _NOTE_STRIDE, _NOTE_STRIDE)
            number, size, crc, _, uuid = _NOTE.unpack_from(image)
            image = image[: _NOTE.size + size]
            if number and size <= spec.GOAL_NOTE_BYTES and crc == zlib.crc32(image[:8] + image[12:]):
                yield number, uuid, image[_NOTE.size :]

    def left(self, uuid: bytes) -> bytes:
        """Return the note that an earlier bridge left about a goal; empty if there is none."""
        return self._found.get(uuid, b"")

    def write(self, uuid: bytes, note: bytes) -> None:
        """Leave a note, at most 1024 bytes, about a goal. Raises SHM122 if the object is mapped read-only."""
        self._number = self._number + 1 & 0xFFFFFFFF or 1
        image = _NOTE.pack(self._number, len(note), 0, 0, uuid) + note
        image = image[:8] + struct.pack("<I", zlib.crc32(image[:8] + image[12:])) + image[12:]
        at = self._at + self._number % spec.GOAL_NOTES * _NOTE_STRIDE
        for offset in range(0, len(image), 4):
            self._region.store(at + offset, int.from_bytes(image[offset : offset + 4], "little"))


_NOTE = struct.Struct("<4I16s")
_NOTE_STRIDE = _NOTE.size + spec.GOAL_NOTE_BYTES
