"""Classic blocks and the death of either side, inside the lock too; and names that lead elsewhere by now."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Iterator

import pytest

from rosplc_st.machine import LibraryMachine, ProcessMachine
from tests.verification.classic_cell import TOPICS, ClassicCell
from tests.verification.plc_cell import READ, WRITE, pattern

pytestmark = pytest.mark.verifies("classic", own="killed processes")


@pytest.fixture
def cell() -> Iterator[ClassicCell]:
    with ClassicCell() as made:
        yield made


def stopped(machine: ProcessMachine) -> bool:
    with open(f"/proc/{machine.process.pid}/stat") as file:
        return file.read().rpartition(")")[2].split()[0] == "T"


def stop_inside(machine: ProcessMachine) -> None:
    """Stop a PLC inside the next lock that it gets."""
    machine.option("stop_inside")
    machine.send(f"scan {READ.upper()} 1 10")
    deadline = time.monotonic() + 30
    while not stopped(machine):
        assert time.monotonic() < deadline, "the PLC never got a lock"
        time.sleep(0.002)


def test_peer_killed_inside_and_started_again(cell: ClassicCell) -> None:
    """While a dead peer holds the lock the last message stays; the new semaphore of the next one is found."""
    cell.scan()
    peer = cell.peer("/in", "make")
    peer.write(pattern(1))
    cell.set("/in", "xReopen", True)  # the peer made its own semaphore after the PLC's
    cell.scan(20)
    assert (cell.record("/in"), cell.get("/in", "udiError")) == (pattern(1), 0)
    peer.ask("half 255")
    peer.kill()
    cell.scan(150)
    assert (cell.record("/in"), cell.get("/in", "xValid", "udiError")) == (pattern(1), (True, 127))
    again = cell.peer("/in", "make")
    again.write(pattern(2))
    cell.scan(400)
    assert (cell.record("/in"), cell.get("/in", "udiError", "xNew")) == (pattern(2), (0, False))
    assert cell.get("/in", "udiChanges") == 2
    again.write(pattern(3))
    cell.scan()
    assert cell.record("/in") == pattern(3)


def test_a_lock_that_stays_taken_is_looked_for_rarely(cell: ClassicCell) -> None:
    """In ten minutes without the lock names are opened a dozen times, since a handle cannot be closed."""
    peer = cell.peer("/in")
    peer.ask("enter")
    before = cell.machine.counters().sem_creates
    cell.scan(6000, step=100)
    assert 8 <= cell.get("/in", "udiReopened") <= 20
    assert cell.machine.counters().sem_creates - before == cell.get("/in", "udiReopened")
    assert cell.get("/in", "udiTimeouts") <= 6000
    peer.ask("leave")
    cell.scan(2)
    assert cell.get("/in", "udiError", "xAttached") == (0, True)


@pytest.mark.parametrize("options", [{"sem_failed": 1}, {"sem_cache": 1}, {"cache_names": 1}])
def test_runtimes_that_differ(options: dict[str, int]) -> None:
    """Another result for a wait that fails, or handles kept by name, change nothing about bounded waits."""
    with ClassicCell(**options) as cell:
        peer = cell.peer("/in")
        peer.write(pattern(1))
        cell.scan()
        peer.ask("enter")
        cell.scan(500)
        assert (cell.record("/in"), cell.get("/in", "udiError", "xValid")) == (pattern(1), (127, True))
        peer.ask("leave")
        peer.write(pattern(2))
        cell.scan(3)
        assert (cell.record("/in"), cell.get("/in", "udiError")) == (pattern(2), 0)


@pytest.mark.parametrize("option", ["sem_cache", "cache_names", "no_duplicate"])
def test_handles_do_not_pile_up(option: str) -> None:
    """Whatever a runtime makes of a name that it knows, an hour of silence costs next to no handles."""
    with ClassicCell(**{option: 1}) as cell:
        peer = cell.peer("/in")
        peer.write(pattern(1))
        cell.scan(50)
        before = cell.machine.counters()
        cell.scan(3600, step=1000)
        after = cell.machine.counters()
        assert after.sem_creates == before.sem_creates
        assert after.open_handles <= before.open_handles + len(TOPICS)
        assert peer.ask("count") == "1"
        peer.write(pattern(2))
        cell.scan()
        assert cell.record("/in") == pattern(2)


def test_a_memory_made_anew_is_found(cell: ClassicCell) -> None:
    """A peer that ended in order, and took both names away, is found again by what the new memory holds."""
    reader, writer = cell.peer("/in", "make"), cell.peer("/out", "make")
    reader.write(pattern(1))
    cell.put("/out", pattern(-1))
    cell.scan(3)
    for topic, peer in (("/in", reader), ("/out", writer)):
        peer.kill()
        cell.memory(topic).unlink()
        cell.semaphore(topic).unlink()
    cell.scan(5)
    reader, writer = cell.peer("/in", "make"), cell.peer("/out", "make")
    reader.write(pattern(2))
    cell.scan(700)
    assert (cell.record("/in"), cell.get("/in", "udiChanges", "udiError")) == (pattern(2), (2, 0))
    assert (writer.read(), cell.get("/out", "xPublished")) == (pattern(-1), True)
    for topic, peer in (("/in", reader), ("/out", writer)):
        peer.ask("enter")  # and both hold the new lock
        cell.scan()
        assert cell.get(topic, "udiError") == 127
        peer.ask("leave")
    assert cell.machine.counters().open_handles == len(TOPICS)


def test_a_memory_whose_name_was_removed_is_made_again(cell: ClassicCell) -> None:
    """If nobody has created the names again, the PLC does, and the peer that comes later finds it."""
    cell.scan()
    cell.memory("/out").unlink()
    cell.put("/out", pattern(1))
    cell.scan(700)
    assert cell.peer("/out").read() == pattern(1)


def test_a_semaphore_made_anew_is_found_when_its_maker_speaks(cell: ClassicCell) -> None:
    """A peer that makes a new semaphore for the old memory is noticed by its first message after silence."""
    cell.scan()
    for number in (1, 2):
        peer = cell.peer("/in", "make")  # as the original class does on each start
        peer.write(pattern(number))
        cell.scan(3)
        assert cell.record("/in") == pattern(number)
        peer.ask("enter")
        cell.scan()
        assert cell.get("/in", "udiError") == 127
        peer.kill()  # while it is inside
        cell.semaphore("/in").unlink()
        cell.scan(6200, step=100)
    assert cell.get("/in", "xStale") is True


def test_a_semaphore_made_anew_within_minutes_needs_a_person(cell: ClassicCell) -> None:
    """Two restarts within ten minutes are followed once, since handles cannot be closed; xReopen works."""
    cell.scan()
    for _ in range(2):
        peer = cell.peer("/in", "make")
        peer.write(pattern(time.monotonic()))
        cell.scan(60)
    peer.ask("enter")
    cell.scan()
    assert cell.get("/in", "udiError") == 0  # it holds the lock before
    peer.ask("leave")
    cell.set("/in", "xReopen", True)
    cell.scan(2)
    peer.ask("enter")
    cell.scan()
    assert cell.get("/in", "udiError") == 127


def test_handles_are_lost_rarely() -> None:
    """In an hour of silence and speech by turns, a block opens its semaphore seven times at most."""
    with ClassicCell() as cell:
        peer = cell.peer("/in")
        before = cell.machine.counters().sem_creates
        for number in range(3600):
            peer.write(pattern(number + 1))
            cell.scan(1, step=1000)
        assert cell.get("/in", "udiChanges") == 3600
        assert cell.get("/in", "udiReopened") <= 7
        assert cell.machine.counters().sem_creates - before <= 7 * len(TOPICS)
        assert cell.machine.counters().open_handles <= 2 * len(TOPICS)


def test_a_new_memory_of_zeros_is_no_message(cell: ClassicCell) -> None:
    """Opened again, a memory that nobody has written leaves msg as it was, and says that it is not valid."""
    peer = cell.peer("/in")
    peer.write(pattern(1))
    cell.scan()
    peer.kill()
    cell.memory("/in").unlink()
    peer = cell.peer("/in")
    cell.set("/in", "xReopen", True)
    cell.scan(3)
    assert (cell.record("/in"), cell.get("/in", "xValid", "xNew")) == (pattern(1), (False, False))
    peer.write(pattern(2))
    cell.scan()
    assert (cell.record("/in"), cell.get("/in", "xValid", "xNew")) == (pattern(2), (True, True))


def test_plc_killed_inside() -> None:
    """The PLC's successor finds the lock taken, waits briefly at each start and never breaks in by itself."""
    with ClassicCell(start=False) as cell:
        peer = cell.peer("/in")
        peer.write(pattern(1))
        first = cell.start(process=True)
        assert isinstance(first, ProcessMachine)
        stop_inside(first)
        first.kill()
        assert peer.ask("count") == "0"
        cell.start()
        cell.scan(150)
        assert cell.get("/in", "udiError", "udiMended", "xValid") == (127, 0, False)
        assert peer.ask("count") == "0"
        cell.set("/in", "xUnlock", True)  # a person, who knows that nobody is inside
        cell.scan(60)
        assert (peer.ask("count"), cell.get("/in", "udiError")) == ("1", 0)
        assert cell.record("/in") == pattern(1)
        cell.set("/in", "xUnlock", False)
        cell.scan()
        cell.set("/in", "xUnlock", True)  # the lock is free: nothing to do
        cell.scan()
        assert (peer.ask("count"), cell.get("/in", "udiSurplus")) == ("1", 0)


def test_plc_that_stood_still_inside() -> None:
    """A PLC that goes on after its lock was freed for it (a breakpoint, say) does not leave two locks."""
    with ClassicCell(start=False) as cell:
        peer = cell.peer("/in")
        machine = cell.start(process=True)
        assert isinstance(machine, ProcessMachine)
        cell.scan(3)
        stop_inside(machine)
        peer.ask("leave")  # as the bridge frees it
        os.kill(machine.process.pid, signal.SIGCONT)
        machine._line()
        assert peer.ask("count") == "2"
        cell.scan(300)
        assert (peer.ask("count"), cell.get("/in", "udiSurplus")) == ("1", 1)


@pytest.mark.parametrize("seconds", [0.7, pytest.param(20.0, marks=pytest.mark.verify(minutes=1))])
def test_no_torn_message(cell: ClassicCell, seconds: float) -> None:
    """Both sides read and write as fast as they can, and every message is whole."""
    reader, writer = cell.peer("/large", size=344), cell.peer("/large_out", size=344)
    machine = cell.machine
    assert isinstance(machine, LibraryMachine)
    cell.set("/large_out", "xEnable", True)
    reader.send(f"writing {seconds}")
    writer.send(f"reading {seconds}")
    until, number = time.monotonic() + seconds, 0
    while time.monotonic() < until:
        number += 1
        machine.write("ROS_Write.large_out.msg", pattern(number)[:8] * 43)
        machine.scan(READ, WRITE)
        message = cell.record("/large")
        assert message == message[:8] * 43 or not cell.get("/large", "xValid")
    assert int(reader.answer()) > 0
    looks, broken = map(int, writer.answer().split())
    assert looks > 0
    assert broken == 0
    assert cell.get("/large", "udiChanges") > 0
    assert cell.get("/large_out", "udiPublished") > 0
    assert reader.ask("count") == writer.ask("count") == "1"
    # Whoever was turned away was counted, and nothing else was lost.
    counters = machine.counters()
    assert counters.sem_enters - counters.sem_timeouts == counters.sem_leaves
