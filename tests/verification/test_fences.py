"""The order of stores and loads around the fences, seen from inside: rules M10, M11, M12 and M22."""

from __future__ import annotations

import struct
from collections.abc import Iterator

import pytest

from rosplc.shm import OwnedChannel
from rosplc.shm.constants import WRITER_LINE
from rosplc_st.machine import LibraryMachine
from tests.verification.plc_cell import READ, WRITE, Cell, pattern, target


@pytest.fixture
def cell() -> Iterator[Cell]:
    with Cell(target("32-bit-with-barrier")) as made:
        yield made


def machine(cell: Cell) -> LibraryMachine:
    """Return the cell's PLC, which calls MemoryBarrier as its fence."""
    assert isinstance(cell.machine, LibraryMachine)
    return cell.machine


def slot(channel: OwnedChannel, sequence: int) -> tuple[int, bytes]:
    """Return the sequence that a slot shows now, and its record."""
    identity = channel.identity
    at = identity.slots_offset + sequence % identity.slot_count * identity.slot_stride
    data = channel.path.read_bytes()[at : at + 64 + identity.record_size]
    return struct.unpack_from("<I", data)[0], data[64:]


def test_writer_seals_fills_and_publishes_in_order(cell: Cell) -> None:
    """The slot is sealed at F5, complete at F6, has its sequence at F2, and only then does head move."""
    channel = cell.channel("/out")
    plc = machine(cell)
    cell.until("/out", "udiPublished", 6)
    seen: list[tuple[int, int, bool]] = []
    following = channel.region.word(WRITER_LINE["head"]) + 1
    plc.write("ROS_Write.out.msg", pattern(77))

    def look() -> None:
        sequence, record = slot(channel, following)
        seen.append((channel.region.word(WRITER_LINE["head"]), sequence, record == pattern(77)))

    plc.on_barrier(look)
    plc.scan(WRITE)
    plc.on_barrier(None)
    old = following - 1
    assert [item[0] for item in seen] == [old] * 4
    assert [item[1] for item in seen] == [following - 4, 0, 0, following]
    assert [item[2] for item in seen] == [False, False, True, True]
    assert channel.region.word(WRITER_LINE["head"]) == following


def test_reader_throws_away_what_is_overwritten_during_the_copy(cell: Cell) -> None:
    """Messages published between the fences of a reader make it try again; it takes the newest, whole."""
    writer = cell.channel("/plain").writer()
    plc = machine(cell)
    cell.until("/plain", "xAttached", True)
    writer.publish(pattern(1))
    calls = 0

    def overtake() -> None:
        nonlocal calls
        calls += 1
        if calls == 1:
            for number in range(2, 6):
                writer.publish(pattern(number))

    plc.on_barrier(overtake)
    plc.scan(READ)
    plc.on_barrier(None)
    assert cell.get("/plain", "xNew", "udiSequence", "udiRetries") == (True, 5, 1)
    assert cell.record("/plain") == pattern(5)
    assert calls == 4


def test_reader_gives_up_after_a_fixed_number_of_attempts(cell: Cell) -> None:
    """A writer that overtakes every copy keeps the last good message in msg, and the scan ends (M12, M17)."""
    writer = cell.channel("/plain").writer()
    plc = machine(cell)
    cell.until("/plain", "xAttached", True)
    writer.publish(pattern(1))
    cell.scan()
    writer.publish(pattern(2))
    calls = 0

    def overtake() -> None:
        nonlocal calls
        calls += 1
        for number in range(4):
            writer.publish(pattern(100 + number))

    plc.on_barrier(overtake)
    plc.scan(READ)
    plc.on_barrier(None)
    assert cell.get("/plain", "xNew") is False
    assert cell.record("/plain") == pattern(1)
    assert calls <= 8
    plc.scan(READ)
    assert cell.get("/plain", "xNew") is True
    assert cell.record("/plain") == pattern(103)


@pytest.mark.parametrize(
    ("ahead", "rule", "accepted"), [(3, 1, False), (2, 1, True), (2, 2, False), (1, 2, True)]
)
def test_reader_checks_the_distance_too(cell: Cell, ahead: int, rule: int, accepted: bool) -> None:
    """A head that has gone too far by the second fence refuses the copy (M12, M23)."""
    channel = cell.channel("/plain")
    writer = channel.writer()
    plc = machine(cell)
    cell.until("/plain", "xAttached", True)
    writer.publish(pattern(1))
    head = channel.region.word(WRITER_LINE["head"])
    calls = 0

    def run_ahead() -> None:
        nonlocal calls
        calls += 1
        # The writer of the delayed rule leaves the seal out: only head tells.
        channel.region.store(WRITER_LINE["head"], head + (ahead if calls % 2 == 0 else 0))
        channel.region.store(WRITER_LINE["writer_rule"], rule if calls % 2 == 0 else 1)

    plc.on_barrier(run_ahead)
    plc.scan(READ)
    plc.on_barrier(None)
    assert cell.get("/plain", "xNew") is accepted
    assert cell.record("/plain") == (pattern(1) if accepted else bytes(48))


def test_reader_checks_the_sequence_again(cell: Cell) -> None:
    """A slot that is sealed by the second fence is refused, though head stands where it stood (M12, M22)."""
    channel = cell.channel("/plain")
    writer = channel.writer()
    plc = machine(cell)
    cell.until("/plain", "xAttached", True)
    sequence = writer.publish(pattern(1))
    identity = channel.identity
    at = identity.slots_offset + sequence % identity.slot_count * identity.slot_stride
    calls = 0

    def seal() -> None:
        nonlocal calls
        calls += 1
        if calls == 2:
            with channel.path.open("r+b") as file:
                file.seek(at)
                file.write(bytes(4))

    plc.on_barrier(seal)
    plc.scan(READ)
    plc.on_barrier(None)
    assert cell.get("/plain", "xNew", "udiRetries") == (False, 4)
    assert cell.record("/plain") == bytes(48)
