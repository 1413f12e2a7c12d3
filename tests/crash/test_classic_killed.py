"""Processes that die inside the lock of a classic topic: spec/classic-mode.md, section 3."""

from __future__ import annotations

import random
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.classic_cell import ClassicCell, build_plc
from tests.lib.channels import until
from tests.lib.waiting import wait_for

pytestmark = pytest.mark.verifies("classic", own="killed processes")

# A holder that a busy machine keeps waiting for longer is taken for a dead one, and its message may be torn.
RECOVER = "recover_after: 1s, wait: 2ms"
RECOVER_SOON = "recover_after: 150ms, wait: 2ms"


def test_a_writer_killed_inside_the_lock_costs_one_message_and_no_more(tmp_path: Path) -> None:
    """The lock is freed once, what it left half written is not passed on, and the next change is."""
    with ClassicCell(tmp_path, "ros", RECOVER) as cell:
        with cell.plc("write", HOLD=20) as plc:
            plc.wait_line("inside")
        wait_for(lambda: cell.classic.recovered == 1, "the lock to be freed")
        before = len(cell.got)
        image = cell.image
        assert image[:4] != image[-4:]  # it did die half-way
        with cell.plc("write", FIRST=1000):
            wait_for(lambda: any(number and number >= 1000 for number in cell.got), "its successor")
        assert None not in cell.got
        assert all(number is not None and number < 20 for number in cell.got[:before])
        assert cell.classic.recovered == 1
        assert cell.status.lost >= 1


def test_a_reader_killed_inside_the_lock_stops_no_writing(tmp_path: Path) -> None:
    """Messages for the PLC wait for the lock to be freed; the newest is written then, older ones are lost."""
    with ClassicCell(tmp_path, "plc", RECOVER) as cell:
        with cell.plc("read", HOLD=5) as plc:
            plc.wait_line("inside")
        for number in range(1, 6):
            cell.publish(number)
            time.sleep(0.01)
        wait_for(lambda: cell.image == (5).to_bytes(4, "little") * (len(cell.image) // 4), "the newest")
        assert cell.classic.recovered == 1
        status = cell.status
        assert status.published + status.lost + status.skipped == status.received == 5
        assert status.lost >= 1
        with cell.plc("read") as plc:
            plc.wait_line("value 5")


def test_a_lock_that_nobody_uses_is_freed_too(tmp_path: Path) -> None:
    """A PLC that restarts after a death inside finds the lock free, though ROS has nothing to say."""
    with ClassicCell(tmp_path, "plc", RECOVER) as cell:
        cell.publish(7)
        wait_for(lambda: cell.status.published == 1)
        with cell.plc("read", HOLD=5) as plc:
            plc.wait_line("inside")
        wait_for(lambda: cell.classic.recovered == 1)
        with cell.plc("read") as plc:
            plc.wait_line("value 7")


_BRIDGE = """
import sys, threading
from rosplc.shm.classic import ClassicLock
lock = ClassicLock(sys.argv[1], 10**9)
lock.enter(0)
print("inside", flush=True)
threading.Event().wait()
"""


def test_a_bridge_killed_inside_the_lock_is_followed_by_one_that_frees_it(tmp_path: Path) -> None:
    """A bridge is a holder like any other; its successor finds the lock taken and frees it."""
    with ClassicCell(tmp_path, "plc", RECOVER) as cell:
        with subprocess.Popen(
            [sys.executable, "-c", _BRIDGE, cell.name], stdout=subprocess.PIPE, text=True
        ) as dying:
            until(dying, "inside")
            dying.kill()
        cell.publish(3)
        wait_for(lambda: cell.status.published == 1)
        assert cell.classic.recovered == 1


def test_bridges_killed_beside_a_plc_that_goes_on(tmp_path: Path) -> None:
    """A PLC's writing outlives every bridge, and the next one carries on from what comes then."""
    with ClassicCell(tmp_path, "ros", RECOVER) as cell:
        config = tmp_path / "rosplc.yaml"
        config.write_text(
            f"prefix: {cell.name}\ntypes: {{paths: [.]}}\nros: {{backend: memory}}\ntopics:\n"
            f"  /t: {{type: cell_msgs/msg/Words, to: ros, classic: {{name: {cell.name}, {RECOVER}}}}}\n"
        )
        cell.bridge.stop()
        with cell.plc("write") as plc:
            for _ in range(2):
                command = [sys.executable, "-m", "rosplc", "run", str(config)]
                with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as bridge:
                    assert bridge.stderr is not None
                    assert any("carries 1 topic" in line for line in bridge.stderr)
                    # A bridge may die inside the lock; then the PLC writes on when the next one has freed it.
                    image = cell.image
                    wait_for(lambda image=image: cell.image != image, "the PLC to write on")
                    time.sleep(0.2)
                    bridge.kill()
            cell.bridge.start()
            wait_for(lambda: len(cell.got) > 5, "messages after the kills")
            assert None not in cell.got
            assert plc.end().startswith("end")


def test_a_holder_that_only_stood_still_comes_back(tmp_path: Path) -> None:
    """One that was stopped longer than recover_after leaves the freed lock again; that is mended."""
    with ClassicCell(tmp_path, "plc", RECOVER_SOON) as cell, cell.plc("read", SPREAD_US=3000) as plc:
        cell.publish(1)
        plc.wait_line("value 1")

        def stopped_inside() -> bool:
            plc.stop()
            started = time.monotonic()
            while time.monotonic() < started + 0.3:
                if cell.classic.recovered:
                    return True
                time.sleep(0.005)
            plc.resume()
            time.sleep(0.004)
            return False

        wait_for(stopped_inside, "the reader to be stopped inside the lock")
        cell.publish(2)
        wait_for(lambda: cell.status.published == 2)
        plc.resume()
        wait_for(lambda: cell.classic.mended >= 1, "the lock to let in one alone again")
        cell.publish(3)
        plc.wait_line("value 3")
        assert cell.classic.recovered == 1


def test_a_writer_stopped_inside_costs_messages_until_the_lock_is_mended(tmp_path: Path) -> None:
    """A writer that goes on after its lock was freed may be read while it writes, not after the mending."""
    with ClassicCell(tmp_path, "ros", RECOVER_SOON) as cell, cell.plc("write", SPREAD_US=5000) as plc:
        wait_for(lambda: len(cell.got) > 3)
        for _ in range(50):
            plc.stop()
            started = time.monotonic()
            while not cell.classic.recovered and time.monotonic() < started + 0.3:
                time.sleep(0.005)
            plc.resume()
            if cell.classic.recovered:
                break
            time.sleep(random.uniform(0, 0.01))
        assert cell.classic.recovered
        wait_for(lambda: cell.classic.mended, "the lock to let in one alone again")
        seen = len(cell.got)
        wait_for(lambda: len(cell.got) > seen + 5, "messages after the pause")
        assert None not in cell.got[seen + 1 :]


def _done(cell: ClassicCell) -> int:
    status = cell.status
    return status.published + status.lost + status.skipped


def _rounds(cell: ClassicCell, way: str, seconds: float, seed: int) -> int:
    """Kill a PLC again and again at random moments; return how often."""
    delays = random.Random(seed)
    kills = 0
    until = time.monotonic() + seconds
    first = 1
    while time.monotonic() < until:
        spread = delays.choice([0, 300, 2000])
        with cell.plc(way, period_us=300, SPREAD_US=spread, FIRST=first) as plc:
            if way == "read":
                for _ in range(delays.randrange(1, 20)):
                    cell.publish(first)
                    first += 1
                    time.sleep(0.002)
                wait_for(lambda: _done(cell) >= cell.status.received)
            else:
                before = len(cell.got)
                wait_for(lambda before=before: len(cell.got) > before + 2, "messages of the new PLC")
                first += 10_000
            time.sleep(delays.uniform(0, 0.005))
            plc.kill()
            kills += 1
            assert "torn" not in plc.said()
    return kills


@pytest.mark.parametrize("way", ["read", "write"])
def test_rounds_of_kills(tmp_path: Path, way: str) -> None:
    """Whenever a PLC is killed, the next one finds a lock that works, and no message is torn."""
    build_plc()
    with ClassicCell(tmp_path, "plc" if way == "read" else "ros", RECOVER) as cell:
        assert _rounds(cell, way, 2.5, seed=1) > 1
        assert None not in cell.got


@pytest.mark.verify(minutes=4)
@pytest.mark.parametrize("way", ["read", "write"])
def test_many_rounds_of_kills(tmp_path: Path, way: str) -> None:
    """Minutes of kills at random moments: the lock always comes back, and no message is torn."""
    with ClassicCell(tmp_path, "plc" if way == "read" else "ros", RECOVER) as cell:
        assert _rounds(cell, way, 110.0, seed=2) > 20
        assert cell.classic.recovered > 0
        assert None not in cell.got
