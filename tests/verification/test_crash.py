"""Either side killed with -9, claims between writers, and faulty writers: Structured Text on one side."""

from __future__ import annotations

import random
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from rosplc.shm import attach
from rosplc.shm.constants import WRITER_LINE
from rosplc_st.machine import LibraryMachine, ProcessMachine
from tests.verification.plc_cell import READ, WRITE, Cell, cell_build, pattern

_ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def cell() -> Iterator[Cell]:
    with Cell() as made:
        yield made


def plc_process(cell: Cell) -> ProcessMachine:
    """Start a PLC as a process of its own on a cell's folder."""
    machine = ProcessMachine(cell_build(program=True), str(cell.folder))
    machine.start()
    machine.set("ROS_Write.out.xEnable", True)
    return machine


def whole(record: bytes | bytearray) -> bool:
    """Return whether a record's six numbers are equal."""
    return bytes(record[8:]) == bytes(record[:-8])


def test_plc_killed_while_writing(cell: Cell) -> None:
    """A PLC killed at any instruction leaves whole messages only; the next PLC takes over and goes on."""
    channel = cell.channel("/out")
    reader = channel.reader()
    out = bytearray(48)
    draw = random.Random(1)
    last = 0
    for life in range(8):
        with plc_process(cell) as plc:
            # A dead writer's claim is silent for three of its beats, by the PLC's clock.
            for _ in range(3000):
                plc.scan(READ, WRITE)
                reader.beat()
                if plc.get("ROS_Write.out.xReady"):
                    break
            assert plc.get("ROS_Write.out.xReady"), f"life {life}"
            plc.write("ROS_Write.out.msg", pattern(life + 1))
            plc.send(f"scan {WRITE.upper()} 100000000 0")
            taken, enough = 0, draw.randrange(20, 2000)
            while taken < enough:
                if (info := reader.next(out)) is not None:
                    assert whole(out)
                    assert info.sequence > last
                    last = info.sequence
                    taken += 1
            plc.kill()
        while (info := reader.next(out)) is not None:
            assert whole(out)
            last = info.sequence
        assert channel.region.word(WRITER_LINE["writer_epoch"]) != 0, "killed, not stopped"
    assert last > 8


def test_bridge_killed_while_writing(cell: Cell) -> None:
    """A bridge killed mid-copy leaves the last whole message; the next adopts, and the PLC goes on."""
    script = (
        "import sys, struct\n"
        "from rosplc.described import description_of\n"
        "from tests.verification.plc_cell import Cell, layout_of, TWIST\n"
        "from rosplc.shm import Direction, Namespace, OwnedChannel\n"
        "layout = layout_of(TWIST)\n"
        "channel = OwnedChannel.open(Namespace('rosplc', sys.argv[1]),\n"
        "    description_of(layout, '/plain', Direction.TO_PLC, bridge='test'), record_size=layout.size)\n"
        "writer, number = channel.writer(), int(sys.argv[2])\n"
        "print('ready', channel.adopted, flush=True)\n"
        "while True:\n"
        "    number += 1\n"
        "    writer.publish(struct.pack('<6d', *[float(number)] * 6))\n"
    )
    draw = random.Random(2)
    for life in range(4):
        child = subprocess.Popen(
            [sys.executable, "-c", script, str(cell.folder), str(life * 10**9)],
            stdout=subprocess.PIPE, text=True, cwd=_ROOT,
        )  # fmt: skip
        assert child.stdout is not None
        assert child.stdout.readline().split() == ["ready", str(life > 0)]
        cell.until("/plain", "xNew", True)
        seen, enough = 0, draw.randrange(20, 500)
        while seen < enough:
            cell.machine.scan(READ)
            if cell.get("/plain", "xNew"):
                assert whole(cell.record("/plain"))
                seen += 1
        child.send_signal(signal.SIGKILL)
        child.wait()
        child.stdout.close()
        cell.scan(20)
        assert cell.get("/plain", "xNew") is False
        assert cell.get("/plain", "udiError") in (0, 125)


def test_one_writer_is_refused_while_another_lives(cell: Cell) -> None:
    """A PLC that finds another's living claim stops with 114 and publishes nothing (M6)."""
    channel = cell.channel("/out")
    other = attach(cell.namespace, "/out", write=True)
    writer = other.writer(beat_ms=100)
    for number in range(100):
        writer.publish(pattern(number))
        cell.scan()
        assert cell.get("/out", "xReady", "udiPublished") == (False, 0)
    assert cell.get("/out", "udiError") == 114
    assert channel.region.word(WRITER_LINE["writer_epoch"]) == writer.epoch
    writer.release()
    cell.until("/out", "xReady", True)
    assert cell.get("/out", "udiError") == 0
    other.close()


def test_silent_writer_is_replaced(cell: Cell) -> None:
    """A claim whose owner is silent for three of its beats is taken over; the old owner stops (115)."""
    cell.channel("/out")
    other = attach(cell.namespace, "/out", write=True)
    writer = other.writer(beat_ms=100)
    writer.publish(pattern(1))
    scans = cell.until("/out", "xReady", True)
    assert scans >= 30, "three times 100 ms of this PLC's scans of 10 ms"
    with pytest.raises(Exception, match="SHM115"):
        writer.publish(pattern(2))
    other.close()


def test_plc_loses_its_claim(cell: Cell) -> None:
    """A PLC that finds another claim in place of its own stops with 115, and publishes nothing more."""
    channel = cell.channel("/out")
    reader = channel.reader()
    cell.until("/out", "udiPublished", 3, beats=[reader])
    channel.region.store(WRITER_LINE["writer_epoch"], 12345)
    head = channel.region.word(WRITER_LINE["head"])
    cell.scan()
    assert cell.get("/out", "udiError", "xReady") == (115, False)
    assert channel.region.word(WRITER_LINE["head"]) == head


def test_claim_waits_for_a_scan(cell: Cell) -> None:
    """Without compare-and-swap a claim counts only when it is found in place one scan later (M6)."""
    channel = cell.channel("/out")
    for _ in range(100):
        cell.scan()
        if channel.region.word(WRITER_LINE["writer_epoch"]):
            break
    assert cell.get("/out", "xReady", "udiPublished") == (False, 0)
    channel.region.store(WRITER_LINE["writer_epoch"], 777)  # another stored at the same time, and later
    cell.scan()
    assert cell.get("/out", "xReady", "udiPublished") == (False, 0)
    assert channel.region.word(WRITER_LINE["writer_epoch"]) == 777


def test_two_plcs_on_one_topic(cell: Cell) -> None:
    """Of two PLC programs that write one topic, exactly one publishes."""
    cell.channel("/out")
    second = LibraryMachine(cell_build(), str(cell.folder))
    second.start()
    second.set("ROS_Write.out.xEnable", True)
    both = 0
    for _ in range(300):
        cell.scan()
        second.scan(READ, WRITE)
        both += cell.get("/out", "xPublished") and second.get("ROS_Write.out.xPublished")
    assert both == 0
    ready = [cell.get("/out", "xReady"), second.get("ROS_Write.out.xReady")]
    assert sorted(ready) == [False, True]
