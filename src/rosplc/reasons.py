"""Why a call ended; generated from spec/format.toml by tools/generate_format.py."""

from __future__ import annotations

import enum


class Reason(enum.IntEnum):
    """Why a call ended; spec/shm-format.md, section 11.2."""

    NONE = 0
    NO_SERVER = 1
    TIME_OUT = 2
    REJECTED = 3
    QUEUE_FULL = 4
    EXPIRED = 5
    CALLER_GONE = 6
    PLC_DOWN = 7
    BRIDGE_RESTARTED = 8
    TOO_LARGE = 9
    SERVER_GONE = 10
    SERVER_FAILED = 11
