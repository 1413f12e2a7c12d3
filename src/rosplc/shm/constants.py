"""The numbers of spec/shm-format.md; generated from spec/format.toml by tools/generate_format.py.

Offsets are in bytes: of IDENTITY and WRITER_LINE from the object's start, else from the line's.
"""

from __future__ import annotations

import enum
from typing import Final

from rosplc.reasons import Reason as Reason

FORMAT: Final = "rosplc 1.0"
MAGIC: Final = 0x434C5052  # the bytes RPLC
VERSION: Final = 0x00010000  # major * 65536 + minor
LINE_SIZE: Final = 64  # bytes of a cache line
HEADER_SIZE: Final = 512  # bytes before the self-description
SLOT_HEADER_SIZE: Final = 64  # bytes before each record
READER_LINES: Final = 4  # reader lines of an object
FEATURES_KNOWN: Final = 0  # bits of features_required that this version knows
STATE_LIVE: Final = 1  # state: in use
STATE_RETIRED: Final = 2  # state: replaced or removed; open the name again
KIND_TOPIC: Final = 1  # kind: a topic's channel
KIND_REQUEST: Final = 0x0102  # kind: a service's requests
KIND_RESPONSE: Final = 0x0202  # kind: a service's responses
KIND_GOAL: Final = 0x0103  # kind: an action's goals
KIND_RESULT: Final = 0x0203  # kind: an action's results
KIND_FEEDBACK: Final = 0x0303  # kind: an action's feedback
MIN_SLOTS: Final = 4  # smallest slot_count
MAX_SLOTS: Final = 65536  # largest slot_count
MAX_RECORD_SIZE: Final = 0x40000000  # largest record_size in bytes
MAX_DESCRIPTION_SIZE: Final = 0x00100000  # largest description_size in bytes
MAX_OBJECT_SIZE: Final = 0x7FFFFFFF  # largest object_size in bytes
RULE_FENCES: Final = 1  # writer_rule: the fences of section 7.2 are in force
RULE_DELAYED: Final = 2  # writer_rule: the delayed rule of section 7.4
WINDOW_FENCES: Final = 2  # M12: the largest distance behind head is slot_count minus this
WINDOW_DELAYED: Final = 3  # M23: the same under the delayed rule
FLAG_FIRST: Final = 1  # flags: first message after the writer started or its source was silent
FLAG_TRUNCATED: Final = 2  # flags: contents were truncated
FLAG_SUBSTITUTED: Final = 4  # flags: not a message from the source
ASK_CALL: Final = 1  # status of a request or goal: always set
ASK_CANCEL: Final = 2  # status of a goal: the caller asks for it to be canceled
ASK_PREEMPT: Final = 4  # status of a goal: another goal waits for this one to end
ASK_WITHDRAWN: Final = 8  # status of a request or goal: the caller no longer waits for an answer
ASK_ACCEPTED: Final = 16  # status of a goal: the goal was accepted, and no request is pending
ANSWER_MASK: Final = 0x000000FF  # status of an answer: the bits that contain one of the next eight values
ANSWER_DONE: Final = 1  # status of an answer: the record is the response
ANSWER_NOT_EXECUTED: Final = 2  # status of an answer: the call did not begin, and it is safe to call again
ANSWER_FATE_UNKNOWN: Final = 3  # status of an answer: the call may have been executed; no answer will come
ANSWER_UNREADABLE: Final = 4  # status of an answer: executed, but the answer does not fit the record
ANSWER_ACCEPTED: Final = 5  # status of an answer: the goal is being executed
ANSWER_SUCCEEDED: Final = 6  # status of an answer: the record is the result
ANSWER_CANCELED: Final = 7  # status of an answer: the record is the result of a canceled goal
ANSWER_ABORTED: Final = 8  # status of an answer: the record is the result of an aborted goal
ANSWER_CANCEL_ACCEPTED: Final = 256  # status of an answer, added: the goal will be canceled
ANSWER_CANCEL_REJECTED: Final = 512  # status of an answer, added: the goal will not be canceled
ANSWER_NO_RESULT: Final = 1024  # status of an answer, added: the result does not fit the record
GOAL_ID_END: Final = 0x504C5052  # the last word of the UUID of a goal that a PLC sends
GOAL_NOTES: Final = 2  # entries of the table after the slots of a goal object that the bridge writes
GOAL_NOTE_BYTES: Final = 1024  # maximum bytes of a note in this table
GOAL_NOTES_SIZE: Final = 2112  # bytes of this table
STAMP_NONE: Final = 0  # stamp_clock: no time stamp
STAMP_SYSTEM: Final = 1  # stamp_clock: system clock (UTC)
STAMP_ROS: Final = 2  # stamp_clock: ROS time
STAMP_PLC: Final = 3  # stamp_clock: the PLC's clock
UNKNOWN: Final = 0xFFFFFFFF  # sources, sinks: not counted
DISCONTINUITY: Final = 0x80000000  # two sequences this far apart or more do not belong to the same stream
MAX_RETRIES: Final = 3  # M12: maximum repeated attempts per call
MAX_BEAT_MS: Final = 10000  # a longer promised beat counts as this many ms
SILENT_BEATS: Final = 3  # M6, M21: promised beat times after which a peer is silent
MIN_SILENT_MS: Final = 100  # M6: shortest silence that frees a claim, in ms
SILENT_MS: Final = 1000  # M6: the same if no beat is promised, in ms
MAX_NAME: Final = 80  # characters of an object's name
NAME_KEPT: Final = 71  # characters kept of a longer name, before ~ and its hash
FNV_OFFSET: Final = 0x811C9DC5  # FNV-1a, 32 bits: start
FNV_PRIME: Final = 0x01000193  # FNV-1a, 32 bits: factor
CRC_POLYNOMIAL: Final = 0xEDB88320  # CRC-32 (ISO-HDLC), reflected
IDENTITY_SIZE: Final = 2 * LINE_SIZE
READER_LINES_OFFSET: Final = IDENTITY_SIZE + LINE_SIZE
CHANGING_WORDS: Final = (HEADER_SIZE - IDENTITY_SIZE) // 4
"""Control words from the writer's line to the end of the header."""


def _offsets(start: int, names: str) -> dict[str, int]:
    """Return where each word begins; NAME*N has N words of 4 bytes."""
    found = {}
    for name in names.split():
        name, _, count = name.partition("*")
        found[name] = start
        start += 4 * int(count or "1")
    return found


IDENTITY: Final = _offsets(
    0,
    "magic version header_size state features_required features_optional kind direction slot_count "
    "slot_stride slot_header_size record_size slots_offset object_size description_offset "
    "description_size layout_id_lo layout_id_hi generation bridge_id*4 creator_pid created_lo "
    "created_hi reader_lines identity_crc reserved*4",
)
WRITER_LINE: Final = _offsets(
    128,
    "head writer_epoch writer_beat writer_beat_ms refused truncated writer_rule sources writer_pid "
    "writer_error reserved*6",
)
READER_LINE: Final = _offsets(
    0,
    "claim beat beat_ms taken layout_lo layout_hi lost retries generation error sinks pid task*4",
)
SLOT_HEADER: Final = _offsets(
    0,
    "sequence length flags status stamp_lo stamp_hi stamp_clock checksum correlation_lo "
    "correlation_hi client*4 reason reserved",
)
GOAL_NOTE: Final = _offsets(
    0,
    "number size crc reserved uuid*4",
)


class Direction(enum.IntEnum):
    """Which way a channel carries messages."""

    TO_PLC = 1
    TO_ROS = 2

    @property
    def word(self) -> str:
        """The word that self-descriptions use: ``"to_plc"`` or ``"to_ros"``."""
        return self.name.lower()


class ErrorNumber(enum.IntEnum):
    """The numbers of section 9; number 101 is the error code SHM101."""

    NO_OBJECT = 101
    NO_PERMISSION = 102
    TOO_SMALL = 103
    NOT_ROSPLC = 104
    VERSION = 105
    FEATURES = 106
    IDENTITY = 107
    GEOMETRY = 108
    TRUNCATED = 109
    DIRECTION = 110
    RETIRED = 111
    LAYOUT = 112
    DESCRIPTION = 113
    CLAIMED = 114
    CLAIM_LOST = 115
    OTHER_BRIDGE = 116
    NO_ROOM = 117
    NAME = 118
    OTHER_USER = 119
    REPLACED = 120
    NOT_PLAIN_FILE = 121
    READ_ONLY = 122
    DIRECTORY = 123
    REENTERED = 124
    PEER_SILENT = 125
    HANDSHAKE_TIMEOUT = 126
    LOCK_TIMEOUT = 127
    SEMAPHORE = 128
    MEMORY_TOO_SMALL = 129
    MEMORY_SIZE = 130
    LOCK_FREED = 131
    SEMAPHORE_COUNT = 132
    SEMAPHORE_WORD_SIZE = 133
    NOT_EXECUTED = 140
    FATE_UNKNOWN = 141
    UNREADABLE = 142
    GOAL_ABORTED = 143
    GOAL_CANCELED = 144
    ILLEGAL_STEP = 145


def reader_line(index: int) -> int:
    """Return the offset of reader line ``index``, 0 to 3."""
    if not 0 <= index < READER_LINES:
        raise IndexError(f"there is no reader line {index}")
    return READER_LINES_OFFSET + index * LINE_SIZE
