"""A PLC's half in C, as SysShm and SysSemProcess make it: who starts first, how the semaphore was born."""

from __future__ import annotations

import time
from pathlib import Path

import posix_ipc
import pytest

from tests.classic_cell import SIZE, ClassicCell, Program, build_plc, remove, unique_name
from tests.lib.waiting import wait_for

FAST = "recover_after: 150ms, wait: 2ms"


def plc_first(name: str, way: str, **environment: object) -> Program:
    """Start the PLC's half before any bridge."""
    return Program([build_plc(), way, name, name, SIZE, 1000], environment)


@pytest.mark.parametrize("initial", [0, 1, 2])
def test_a_plc_that_made_everything_first_is_read(tmp_path: Path, initial: int) -> None:
    """A semaphore born locked, as met in the field, or born with two, works once the bridge has mended it."""
    name = unique_name()
    try:
        with plc_first(name, "write", INITIAL=initial), ClassicCell(tmp_path, "ros", FAST, name=name) as cell:
            wait_for(lambda: len(cell.got) > 5)
            assert None not in cell.got[3:]
            assert cell.classic.recovered == (1 if initial == 0 else 0)
            wait_for(lambda: cell.classic.mended == (1 if initial == 2 else 0))
    finally:
        remove(name)


@pytest.mark.parametrize("initial", [0, 1])
def test_a_plc_that_made_everything_first_is_written_to(tmp_path: Path, initial: int) -> None:
    """Towards the PLC too."""
    name = unique_name()
    try:
        with plc_first(name, "read", INITIAL=initial) as plc:
            with ClassicCell(tmp_path, "plc", FAST, name=name) as cell:
                cell.publish(41)
                plc.wait_line("value 41")
                assert cell.classic.recovered == 1 - initial
                plc.end()
            assert "torn" not in plc.said()
    finally:
        remove(name)


def test_both_sides_under_load_never_tear_and_never_stop(tmp_path: Path) -> None:
    """A reader that takes its time inside the lock sees whole records alone, and the newest at the end."""
    with ClassicCell(tmp_path, "plc", "wait: 1ms") as cell:
        with cell.plc("read", period_us=100, SPREAD_US=300) as plc:
            for number in range(1, 301):
                cell.publish(number)
                time.sleep(0.003)
            plc.wait_line("value 300")
            assert "torn" not in plc.said()
            plc.end()
        assert cell.classic.recovered == 0
        assert posix_ipc.Semaphore(f"/{cell.name}").value == 1
