"""Classic blocks, as generated, against a C program of an existing project: both directions, every rule."""

from __future__ import annotations

import os
import struct
from collections.abc import Iterator

import pytest

from rosplc.config.plans import ClassicPlan
from rosplc.layout import Limits
from rosplc.plc.build import build_project
from rosplc.plc.plan import PlcTask, PlcTopic
from rosplc.plc.project import project_texts
from rosplc_st.build import build
from tests.verification.classic_cell import JOINTS, TOPICS, ClassicCell, Peer, classic_target
from tests.verification.plc_cell import WRITE, layout_of, pattern, store, targets

pytestmark = pytest.mark.verifies("classic", own="translated Structured Text")


@pytest.fixture
def cell() -> Iterator[ClassicCell]:
    with ClassicCell() as made:
        yield made


@pytest.mark.parametrize("target", targets())
@pytest.mark.parametrize(("way", "first"), [("make", "peer"), ("find", "peer"), ("find", "plc")])
def test_messages_cross_both_ways(target: str, way: str, first: str) -> None:
    """Whichever side starts first and makes the names, values cross as they are, for every target."""
    with ClassicCell(classic_target(target), start=False) as cell:
        if first == "plc":
            cell.start()
            cell.scan()
        reader, writer = cell.peer("/in", way), cell.peer("/out", way)
        if first == "peer":
            cell.start()
        cell.scan(2)
        assert cell.get("/in", "xAttached", "xValid", "xNew", "udiError") == (True, False, False, 0)
        for number in (1.5, -2.25, 3e300):
            reader.write(pattern(number))
            cell.put("/out", pattern(2 * number))
            cell.scan()
            assert cell.record("/in") == pattern(number)
            assert cell.get("/in", "xValid", "xNew", "xError") == (True, True, False)
            assert cell.get("/out", "xPublished", "xReady") == (True, True)
            assert writer.read() == pattern(2 * number)
            cell.scan()
            assert cell.get("/in", "xValid", "xNew") == (True, False)
        assert cell.get("/in", "udiChanges", "udiTimeouts") == (3, 0)
        counters = cell.machine.counters()
        assert counters.sem_enters - counters.sem_timeouts == counters.sem_leaves


def test_without_a_semaphore(cell: ClassicCell) -> None:
    """With '' as semaphore nothing is entered and none is made."""
    reader, writer = cell.peer("/bare"), cell.peer("/bare_out")
    cell.scan()
    reader.write(pattern(4))
    cell.put("/bare_out", pattern(5))
    cell.scan()
    assert (cell.record("/bare"), cell.get("/bare", "xNew"), writer.read()) == (pattern(4), True, pattern(5))
    cell.scan(1000)
    assert not cell.semaphore("/bare").exists()
    assert cell.get("/bare", "udiReopened", "udiTimeouts", "udiError") == (0, 0, 0)


def test_write_only_when_enabled(cell: ClassicCell) -> None:
    """A Write block writes nothing before a program says so."""
    peer = cell.peer("/out")
    peer.write(pattern(7))
    cell.scan(5)
    assert peer.read() == pattern(7)
    assert cell.get("/out", "xReady", "xPublished", "udiPublished") == (True, False, 0)


def test_what_stands_there_at_the_start_is_shown_and_not_new() -> None:
    """A record found when opening is in msg, valid, and no new message, unless the topic is latched."""
    with ClassicCell(start=False) as cell:
        for topic in ("/in", "/latched"):
            cell.peer(topic).write(pattern(9))
        cell.start()
        cell.scan()
        assert (cell.record("/in"), cell.record("/latched")) == (pattern(9), pattern(9))
        assert cell.get("/in", "xValid", "xNew", "xStale") == (True, False, True)
        assert cell.get("/latched", "xValid", "xNew") == (True, True)


def test_stale_by_the_plcs_own_clock(cell: ClassicCell) -> None:
    """A record that does not change gets old, the next change makes it fresh, and zero means zero."""
    peers = [cell.peer(topic) for topic in ("/in", "/zero")]
    for peer in peers:
        peer.write(pattern(1))
    cell.scan()
    assert cell.get("/in", "xStale", "xNew") == (False, True)
    cell.scan(20)
    assert cell.get("/in", "xStale") is False
    cell.scan()
    assert (cell.get("/in", "xStale", "tAge"), cell.record("/in")) == ((True, 210), pattern(1))
    assert (cell.record("/zero"), cell.get("/zero", "xSubstituted")) == (bytes(48), True)
    assert cell.get("/in", "xSubstituted") is False, "held, and still the source's"
    for peer in peers:
        peer.write(pattern(2))
    cell.scan()
    assert (cell.get("/in", "xStale"), cell.record("/zero")) == (False, pattern(2))
    assert cell.get("/zero", "xSubstituted") is False


def test_faulty_records_become_harmless(cell: ClassicCell) -> None:
    """Counts stay within their arrays and strings have an end, whatever the other side wrote."""
    layout = layout_of(JOINTS, "jazzy", Limits(8, 16, {"name": 3, "position": 3, "velocity": 3, "effort": 3}))
    peer = cell.peer("/joints", size=layout.size)
    peer.write(b"\xff" * layout.size)
    cell.scan()
    assert cell.get("/joints", "xNew") is True
    for name in ("name", "position", "velocity", "effort"):
        assert cell.get("/joints", f"msg.{name}_count") == 3
    for index in range(3):
        assert len(cell.get("/joints", f"msg.name[{index}]")) == 8
    cell.scan()
    assert cell.get("/joints", "xNew") is False


@pytest.mark.parametrize("born_locked", [0, 1])
@pytest.mark.parametrize("target", targets())
def test_a_semaphore_made_by_the_plc_works(target: str, born_locked: int) -> None:
    """Made with the count 0 or 1, which is not documented, the semaphore ends up with 1."""
    with ClassicCell(classic_target(target), sem_born_locked=born_locked) as cell:
        peer = cell.peer("/in")
        assert peer.ask("count") == str(1 - born_locked)
        cell.scan(40)
        assert cell.get("/in", "udiMended", "udiError") == (born_locked, 0)
        assert peer.ask("count") == "1"
        peer.write(pattern(3))
        cell.scan()
        assert cell.record("/in") == pattern(3)
        assert cell.get("/in", "udiSurplus") == 0


def test_a_locked_semaphore_that_was_found_is_left_to_the_bridge() -> None:
    """Who did not make it cannot know whether somebody is inside: waits stay short, and are counted."""
    with ClassicCell(start=False) as cell:
        peer = cell.peer("/in", "make")
        peer.write(pattern(1))
        peer.ask("enter")
        cell.start()
        cell.scan(100)
        assert cell.get("/in", "udiMended", "udiTimeouts", "udiError", "xError") == (0, 100, 127, True)
        assert cell.get("/in", "udiResult", "xValid") == (5, False)
        assert peer.ask("count") == "0"
        peer.ask("leave")  # the bridge, or whoever held it
        cell.scan()
        assert (cell.get("/in", "udiError", "xError"), cell.record("/in")) == ((0, False), pattern(1))


def test_a_holder_during_the_birth_is_not_overtaken() -> None:
    """A peer that got in right after the PLC made the semaphore keeps it: nothing is freed below 200 ms."""
    with ClassicCell(start=False, sem_born_locked=1) as cell:
        cell.start()
        peer = cell.peer("/in")
        peer.ask("leave")  # it was born open
        peer.ask("enter")
        cell.scan(19)
        assert (peer.ask("count"), cell.get("/in", "udiMended")) == ("0", 0)
        peer.ask("leave")
        cell.scan(50)
        assert (peer.ask("count"), cell.get("/in", "udiMended")) == ("1", 0)


def test_freed_by_both_sides(cell: ClassicCell) -> None:
    """A lock that would let two in, because two freed it, is found and mended by the next accesses."""
    peer = cell.peer("/in")
    peer.ask("enter")
    cell.scan(3)
    peer.ask("leave")
    peer.ask("leave")
    assert peer.ask("count") == "2"
    cell.scan(2)
    assert (peer.ask("count"), cell.get("/in", "udiSurplus", "udiError")) == ("1", (1, 0))


def test_a_surplus_is_found_without_a_sign(cell: ClassicCell) -> None:
    """Every 256th access looks twice, since a holder that was stopped may come back at any time."""
    peer = cell.peer("/in")
    peer.ask("leave")
    cell.scan(256)
    assert (peer.ask("count"), cell.get("/in", "udiSurplus")) == ("1", 1)


def test_a_runtime_that_knows_its_caller_again() -> None:
    """Where Enter lets its own caller in again, looking twice does not lock everybody out."""
    with ClassicCell(sem_recursive=1) as cell:
        peer = cell.peer("/in")
        cell.scan(600)
        assert (peer.ask("count"), cell.get("/in", "udiSurplus", "udiTimeouts")) == ("1", (0, 0))


def test_waits_are_bounded(cell: ClassicCell) -> None:
    """A lock that stays taken costs one wait of tWait, then only looks; and the message stays."""
    peer = cell.peer("/in")
    peer.write(pattern(5))
    cell.scan()
    peer.ask("enter")
    before = cell.machine.counters().sem_waited
    cell.scan(150)
    assert cell.machine.counters().sem_waited - before == 5
    assert cell.get("/in", "udiTimeouts", "xValid", "udiError") == (150, True, 127)
    assert cell.record("/in") == pattern(5)
    assert cell.get("/in", "xStale") is True


def test_blocks_that_share_a_lock_wait_once() -> None:
    """Ten blocks under one semaphore cost a task one wait in all, not one each."""
    layout = layout_of("std_msgs/msg/Float64")
    topics = [
        PlcTopic(f"/t{n}", layout, "read", "T", classic=ClassicPlan(f"t{n}", "shared", 5_000_000))
        for n in range(10)
    ]
    texts = project_texts(build_project(store(), topics, [PlcTask("T")]))
    with ClassicCell(build({**texts, WRITE: f"PROGRAM {WRITE}\nEND_PROGRAM\n"})) as cell:
        cell.scan()
        cell.peers.append(Peer(f"{cell.prefix}shared"))
        cell.peers[0].ask("enter")
        for _ in range(50):
            cell.scan()
        assert cell.machine.counters().sem_waited == 5
        assert cell.machine.get("ROS_Read.t7.udiTimeouts") == 50
        cell.peers[0].ask("leave")
        cell.scan(20)
        assert cell.machine.get("ROS_Read.t7.udiError") == 0
        cell.peers[0].ask("enter")  # some other time: one wait again
        cell.scan(20)
        assert cell.machine.counters().sem_waited == 10


def test_no_wait_is_endless() -> None:
    """A tWait of 49 days, which would be an endless wait in ms, waits 1 s."""
    with ClassicCell() as cell:
        peer = cell.peer("/in")
        cell.scan()
        peer.ask("enter")
        before = cell.machine.counters().sem_waited
        cell.machine.scan("Patient")
        assert cell.machine.counters().sem_waited - before == 1000
        assert cell.get("/in", "udiTimeouts") == 1


def test_the_lock_is_held_while_copying(cell: ClassicCell) -> None:
    """Inside the lock the semaphore's count is 0, and the block never touches the memory outside."""
    peer, seen = cell.peer("/in"), []
    cell.machine.on_inside(lambda: seen.append(peer.ask("count")))
    peer.write(pattern(1))
    cell.scan()
    assert "0" in seen
    cell.machine.on_inside(None)


@pytest.mark.parametrize("option", ["return_size", "check_size"])
def test_a_memory_that_is_too_small(option: str) -> None:
    """Where the runtime tells the size, a smaller memory is error 129, and nothing is read."""
    with ClassicCell(start=False, **{option: 1}) as cell:
        peer = cell.peer("/in", size=16)
        peer.write(pattern(1)[:16])
        cell.start()
        cell.scan(30)
        assert cell.get("/in", "xAttached", "udiError", "xValid") == (False, 129, False)
        cell.memory("/in").unlink()
        cell.peer("/in").write(pattern(2))
        cell.scan(400)
        assert (cell.get("/in", "udiError"), cell.record("/in")) == (0, pattern(2))


def test_sizes_that_nobody_tells() -> None:
    """Where the runtime tells nothing, what lies behind a smaller memory reads as zeros within its page."""
    with ClassicCell(start=False) as cell:
        cell.peer("/in", size=16).write(pattern(1)[:16])
        cell.start()
        cell.scan()
        assert cell.record("/in") == pattern(1)[:16] + bytes(32)


def test_a_larger_memory_is_fine() -> None:
    """What the other side has behind the record is left alone."""
    with ClassicCell(start=False, return_size=1, check_size=1) as cell:
        peer = cell.peer("/out", size=96)
        peer.write(bytes([7]) * 96)
        cell.start()
        cell.put("/out", pattern(1))
        cell.scan()
        assert peer.read() == pattern(1) + bytes([7]) * 48


@pytest.mark.needs(when=os.geteuid() == 0, why="only root can start a PLC as another user")
def test_without_permission(cell: ClassicCell) -> None:
    """A memory or semaphore that belongs to somebody else is an error with its number, and found later."""
    cell.machine.stop()
    for path in (cell.memory("/in"), cell.semaphore("/out")):
        path.chmod(0o600)
    for topic in ("/out", "/latched", "/zero", "/joints"):
        cell.memory(topic).chmod(0o666)
        if topic != "/out":
            cell.semaphore(topic).chmod(0o666)
    cell.start(process=True, user=65534)
    cell.scan(10)
    assert cell.get("/in", "udiError", "udiResult", "xAttached", "xError") == (102, 1, False, True)
    assert cell.get("/out", "udiError", "xReady") == (128, False)
    assert cell.get("/latched", "udiError") == 0
    cell.memory("/in").chmod(0o666)
    cell.semaphore("/in").chmod(0o666)
    cell.semaphore("/out").chmod(0o666)
    cell.scan(600)
    assert cell.get("/in", "udiError") == cell.get("/out", "udiError") == 0


def test_attempts_to_open_are_few() -> None:
    """A block that cannot open tries once per scan and task at most, and later and later."""
    with ClassicCell(start=False) as cell:
        for topic in ("/in", "/zero"):
            cell.memory(topic).mkdir()
        cell.start()
        before = cell.machine.counters().creates
        cell.scan(1000)  # 10 s
        others = 2 * (len(TOPICS) - 2)  # each looks twice whether its name leads elsewhere
        assert 2 * 8 <= cell.machine.counters().creates - before - others <= 2 * 14
        assert cell.get("/in", "udiError") == cell.get("/zero", "udiError") == 102
        for topic in ("/in", "/zero"):
            cell.memory(topic).rmdir()
        cell.scan(500)
        assert cell.get("/in", "xAttached") and cell.get("/zero", "xAttached")


def test_an_online_change_keeps_everything(cell: ClassicCell) -> None:
    """Handles, message and counters move with the instance; nothing is closed, opened or invented."""
    reader, writer = cell.peer("/in"), cell.peer("/out")
    reader.write(pattern(1))
    cell.put("/out", pattern(2))
    cell.scan(5)
    before = cell.machine.counters()
    cell.machine.online_change()
    cell.scan()
    after = cell.machine.counters()
    assert all(before[name] == after[name] for name in ("closes", "creates", "sem_creates", "open_handles"))
    assert cell.get("/in", "xValid", "xNew", "udiError") == (True, False, 0)
    reader.write(pattern(3))
    cell.put("/out", pattern(4))
    cell.scan()
    assert (cell.record("/in"), writer.read()) == (pattern(3), pattern(4))


def test_the_end_of_the_program_closes_and_keeps_the_names(cell: ClassicCell) -> None:
    """A download closes every memory, and leaves memory and semaphore to the other side."""
    cell.scan()
    cell.machine.stop()
    counters = cell.machine.counters()
    assert (counters.open_handles, counters.deletes) == (0, 0)
    assert cell.memory("/in").exists() and cell.semaphore("/in").exists()


def test_a_second_caller_is_noticed(cell: ClassicCell) -> None:
    """A task that enters an instance which is at work is turned away, and says so."""
    cell.scan()
    cell.set("/in", "xInside", True)
    cell.scan()
    assert cell.get("/in", "udiError", "xError") == (124, True)
    cell.set("/in", "xInside", False)


def test_records_are_what_the_layout_says(cell: ClassicCell) -> None:
    """The memory holds the struct at offset 0, with nothing before or after it."""
    cell.put("/bare_out", struct.pack("<6d", 1, 2, 3, 4, 5, 6))
    cell.scan()
    assert cell.memory("/bare_out").read_bytes() == struct.pack("<6d", 1, 2, 3, 4, 5, 6)
