"""Channels of a made-up type, records that show tearing, and child processes; quick to import for a child."""

from __future__ import annotations

import struct
import subprocess
import sys
import threading
import time
from collections import deque
from dataclasses import replace
from pathlib import Path
from typing import Literal

from rosplc.errors import ChannelError
from rosplc.shm import (
    SERVICE,
    Attached,
    Description,
    Direction,
    Namespace,
    OwnedChannel,
    Part,
    Reader,
    ReaderClaim,
)
from tests.lib.waiting import WATCHDOG_S

__all__ = [
    "LAYOUT",
    "acting_reader",
    "describe",
    "is_torn",
    "open_channel",
    "open_service",
    "pattern",
    "start_child",
    "until",
]

LAYOUT = "0123456789abcdef"
_ROOT = Path(__file__).resolve().parents[2]


def acting_reader(attached: Attached, task: str = "", *, beat_ms: int = 1000) -> Reader:
    """Return the PLC's reader of a service's or action's object; SHM114 if another one lives on."""
    reader = attached.reader()
    answer = Part(attached.identity.kind).asks
    claim = ReaderClaim(attached.region, reader, beat_ms, task, range(1), answer=answer)
    began = now = time.monotonic_ns()
    while not claim.attempt(now):
        if now - began > claim.patience_ns() + 10_000_000:
            raise ChannelError("SHM114", "another program has the line", where=str(attached.path))
        time.sleep(0.005)
        now = time.monotonic_ns()
    return reader


def describe(
    topic: str = "/robot1/cmd_vel", direction: Direction = Direction.TO_PLC, layout_id: str = LAYOUT
) -> Description:
    """Return a self-description of a made-up type."""
    return Description(
        topic=topic,
        type="test_msgs/msg/Bytes",
        distro="jazzy",
        direction=direction,
        limits={"string": 80, "sequence": 16, "fields": {}},
        layout_id=layout_id,
        bridge="test",
        definition="uint64[] data\n",
    )


def open_channel(
    namespace: Namespace,
    direction: Direction = Direction.TO_PLC,
    *,
    topic: str = "/robot1/cmd_vel",
    record_size: int = 64,
    slots: int = 4,
    layout_id: str = LAYOUT,
) -> OwnedChannel:
    """Own a channel of a made-up type."""
    return OwnedChannel.open(
        namespace, describe(topic, direction, layout_id), record_size=record_size, slots=slots
    )


def open_service(
    namespace: Namespace, server: Literal["plc", "ros"] = "plc", *, client: str = "", layout_id: str = LAYOUT
) -> tuple[OwnedChannel, OwnedChannel]:
    """Own request and response of a made-up service /add, with records of 64 and 32 bytes."""
    request, response = (
        replace(describe("/add", part.direction(server)), part=part, client=client) for part in SERVICE
    )
    asks, answers = OwnedChannel.open_together(
        namespace, [(request, 64), (replace(response, layout_id=layout_id), 32)]
    )
    return asks, answers


def pattern(number: int, size: int) -> bytes:
    """Return a record of ``size`` bytes (a multiple of eight) whose every eight bytes are ``number``."""
    return struct.pack("<Q", number) * (size // 8)


def is_torn(record: bytes | bytearray) -> bool:
    """Return whether a pattern holds parts of two messages."""
    return bytes(record[8:]) != bytes(record[:-8])


def start_child(script: str, *arguments: object) -> subprocess.Popen[str]:
    """Start a Python process on a script that sees this checkout; its stdin and stdout are pipes."""
    return subprocess.Popen(
        [sys.executable, "-c", script, *map(str, arguments)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        cwd=_ROOT,
    )


def until(child: subprocess.Popen[str], word: str) -> str:
    """Read a child's lines up to one that begins with ``word``, and return it; kill a child that hangs."""
    assert child.stdout is not None
    last = deque[str](maxlen=10)
    watchdog = threading.Timer(WATCHDOG_S, child.kill)
    watchdog.start()
    try:
        for line in child.stdout:
            if line.startswith(word):
                return line.strip()
            last.append(line)
    finally:
        watchdog.cancel()
    raise AssertionError(f"the child ended, or hung, before it wrote {word!r}; it wrote last: {list(last)}")
