"""Reading the library's trace output."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

pytest.importorskip("cyclonedds", reason="no wheel of cyclonedds for this machine")

from rosplc.ros.dds.native import LibraryLog

LINE = "1.2 [0] recv: data(application): 1:2:3:4 #5: deserialization {}/a::msg::dds_::B_ failed (invalid)\n"


def test_dropped_messages_are_counted_by_topic() -> None:
    """Lines about messages that do not fit are counted, whole ones only; others are passed over."""
    log = LibraryLog()
    with Path(log.path).open("a") as library:
        library.write(LINE.format("rt/a") + "something else\n" + LINE.format("rt/b") + LINE.format("rt/a"))
        library.write(LINE.format("rt/c")[:-5])
        library.flush()
        log.drain()
        assert [log.dropped(topic) for topic in ("rt/a", "rt/b", "rt/c", "rt/d")] == [2, 1, 0, 0]
        library.write(LINE.format("rt/c")[-5:])
        library.flush()
        log.drain()
        assert log.dropped("rt/c") == 1


def test_memory_is_given_back() -> None:
    """What was read takes no more memory than a page, however much the library writes."""
    log = LibraryLog()
    with Path(log.path).open("a") as library:
        for _ in range(20):
            library.write(LINE.format("rt/a") * 1000)
            library.flush()
            log.drain()
    assert log.dropped("rt/a") == 20_000
    assert os.stat(log.path).st_size > 1_000_000
    assert os.stat(log.path).st_blocks * 512 <= 4096
