"""Reader lines of PLCs that died: a line is claimed when free, or when its holder was silent for long."""

from __future__ import annotations

import pytest

from rosplc.shm import OwnedChannel
from rosplc.shm.constants import READER_LINE, READER_LINES, WRITER_LINE, reader_line
from tests.verification.plc_cell import Cell


def claim_all(channel: OwnedChannel, beat_ms: int = 1000) -> None:
    """Fill the lines with claims of readers that are no more."""
    for index in range(READER_LINES):
        channel.region.store(reader_line(index) + READER_LINE["claim"], 100 + index)
        channel.region.store(reader_line(index) + READER_LINE["beat_ms"], beat_ms)


def claims(channel: OwnedChannel) -> list[int]:
    return [channel.region.word(reader_line(index) + READER_LINE["claim"]) for index in range(READER_LINES)]


@pytest.mark.parametrize(("beat_ms", "limit"), [(1000, 3000), (0, 1000), (10, 100), (4_000_000_000, 30_000)])
def test_a_silent_line_is_replaced(beat_ms: int, limit: int) -> None:
    """With every line held by the dead, one is taken after three of its promised beats, not before."""
    with Cell() as cell:
        channel = cell.channel("/plain")
        writer = channel.writer()
        claim_all(channel, beat_ms)
        cell.until("/plain", "xAttached", True, beats=[writer])
        spent = 0
        while claims(channel) == [100, 101, 102, 103]:
            cell.scan(beats=[writer])
            spent += 10
            assert spent < limit + 200, "no line was taken"
        assert spent > limit
        cell.scan(3, beats=[writer])
        (mine,) = (index for index, claim in enumerate(claims(channel)) if claim != 100 + index)
        beat = channel.region.word(reader_line(mine) + READER_LINE["beat"])
        cell.scan(2, beats=[writer])
        assert channel.region.word(reader_line(mine) + READER_LINE["beat"]) == beat + 2


def test_a_living_line_is_left_alone() -> None:
    """The silent line among living ones is found; the others keep their holders."""
    with Cell() as cell:
        channel = cell.channel("/plain")
        writer = channel.writer()
        claim_all(channel)
        cell.until("/plain", "xAttached", True, beats=[writer])
        for beat in range(1, 800):
            for index in (0, 1, 3):
                channel.region.store(reader_line(index) + READER_LINE["beat"], beat)
            cell.scan(beats=[writer])
        assert claims(channel)[:2] == [100, 101] and claims(channel)[3] == 103
        assert claims(channel)[2] != 102


def test_a_line_that_gets_free_is_taken() -> None:
    """A reader that found every line held takes the first that is given back."""
    with Cell() as cell:
        channel = cell.channel("/plain")
        writer = channel.writer()
        claim_all(channel)
        cell.until("/plain", "xAttached", True, beats=[writer])
        cell.scan(10, beats=[writer])
        channel.region.store(reader_line(3) + READER_LINE["claim"], 0)
        for beat in range(1, 20):
            for index in (0, 1, 2):
                channel.region.store(reader_line(index) + READER_LINE["beat"], beat)
            cell.scan(beats=[writer])
        assert claims(channel)[:3] == [100, 101, 102]
        assert claims(channel)[3] not in (0, 103)


@pytest.mark.parametrize(("beat_ms", "limit"), [(1000, 3000), (4_000_000_000, 30_000)])
def test_a_silent_writer_is_replaced(beat_ms: int, limit: int) -> None:
    """A writer's claim falls after three promised beats; a damaged promise counts as ten seconds."""
    with Cell() as cell:
        channel = cell.channel("/out")
        reader = channel.reader()
        channel.region.store(WRITER_LINE["writer_epoch"], 77)
        channel.region.store(WRITER_LINE["writer_beat_ms"], beat_ms)
        cell.until("/out", "xAttached", True, beats=[reader])
        scans = cell.until("/out", "xReady", True, scans=limit // 10 + 20, beats=[reader])
        assert scans * 10 > limit
