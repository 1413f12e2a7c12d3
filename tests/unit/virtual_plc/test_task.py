"""A task's scans: when they begin, what is counted, how they end."""

from __future__ import annotations

import threading
import time

import pytest

from rosplc.virtual_plc.task import Task, TaskState, VirtualPlc, current_scan
from tests.lib.waiting import wait_for


def test_programs_run_in_order_once_per_scan():
    """Each scan calls every program once, in the order in which they were added."""
    calls = []
    task = Task("T", 0.001, programs=[lambda: calls.append("a")])
    task.program(lambda: calls.append("b"))
    task.scan()
    task.scan()
    assert calls == ["a", "b", "a", "b"]
    assert task.stats.scans == 2


def test_scans_keep_to_the_grid():
    """Scans begin at start + n × interval, never earlier."""
    begins = []
    task = Task("T", 0.005, programs=[lambda: begins.append(time.monotonic_ns())])
    task.start()
    wait_for(lambda: task.stats.scans >= 20)
    assert task.stop()
    count = len(begins) - 1 + task.stats.missed
    assert begins[-1] - begins[0] >= (count - 1) * 5_000_000


def test_a_long_scan_counts_the_ones_it_displaced():
    """A scan that takes 3.5 intervals lets the next three go, and counts them."""
    task = Task("T", 0.02)
    done = threading.Event()

    @task.program
    def slow():
        if task.stats.scans == 0:
            time.sleep(0.07)
        else:
            done.set()

    task.start()
    assert done.wait(30)
    assert task.stop()
    assert task.stats.missed >= 2
    assert task.stats.cycle_max >= 70_000_000


def test_an_exception_halts_the_task_and_is_kept():
    """A program that raises ends its task; the owner gets the exception, and cannot start it again."""
    plc = VirtualPlc()
    task = plc.task("T", 0.001)

    @task.program
    def broken():
        raise ZeroDivisionError("speed / 0")

    with pytest.raises(ZeroDivisionError, match="speed / 0"):
        plc.run(duration=30)
    assert task.state is TaskState.EXCEPTION
    assert task.stats.scans == 1
    with pytest.raises(RuntimeError, match="halted"):
        task.start()


def test_a_program_may_stop_its_plc():
    """The PLC's run ends then, after this scan, although it was to run until Ctrl-C."""
    plc = VirtualPlc()
    task = plc.task("T", 0.001, priority=1)
    task.program(lambda: plc.stop())
    plc.run()
    assert task.state is TaskState.STOPPED
    assert task.stats.scans == 1
    plc.run()
    assert task.stats.scans == 2


def test_the_watchdog_halts_after_its_sensitivity():
    """Only as many long scans in a row as the sensitivity allows halt the task."""
    task = Task("T", 0.001, watchdog=0.005, watchdog_sensitivity=2)
    task.program(lambda: time.sleep(0.01))
    task.scan()
    assert task.error is None
    task.scan()
    assert task.state is TaskState.EXCEPTION
    assert isinstance(task.error, TimeoutError)
    assert task.stats.watchdog_excesses == 2


def test_a_scan_in_progress_that_exceeds_the_watchdog_is_overdue():
    """A program that does not return shows as overdue while it runs."""
    task = Task("T", 0.001, watchdog=0.01)
    release = threading.Event()
    task.program(lambda: release.wait(30))
    task.start()
    try:
        wait_for(lambda: task.overdue)
    finally:
        release.set()
        assert task.stop()


def test_blocks_see_the_scan_of_their_own_task():
    """A program finds its task's scan; outside a task every call is a scan of its own."""
    seen = []
    task = Task("Fast", 0.001, programs=[lambda: seen.append(current_scan())])
    task.scan()
    task.scan()
    assert [(scan.task, scan.number) for scan in seen] == [("Fast", 1), ("Fast", 2)]
    assert current_scan().task == ""
    assert current_scan().claim_open()
    assert current_scan().claim_open()


def test_one_scan_has_one_attempt_to_open():
    """The second block that wants to open in a scan has to wait for the next."""
    answers = []
    task = Task("T", 0.001)
    task.program(lambda: answers.append(current_scan().claim_open()))
    task.program(lambda: answers.append(current_scan().claim_open()))
    task.scan()
    task.scan()
    assert answers == [True, False, True, False]


def test_scheduling_says_what_is_in_force():
    """A task that asks for SCHED_FIFO says whether it got it."""
    task = Task("T", 0.001, priority=4, realtime=True)
    task.start()
    wait_for(lambda: task.stats.scans >= 1)
    assert task.stop()
    assert task.scheduling == "SCHED_FIFO 63" or "not allowed to use" in task.scheduling


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        ({"interval": 0.0}, "interval"),
        ({"interval": float("nan")}, "interval"),
        ({"interval": 0.01, "priority": 32}, "priority"),
        ({"interval": 0.01, "watchdog": 0.0}, "watchdog"),
        ({"interval": 0.01, "watchdog_sensitivity": 0}, "sensitivity"),
    ],
)
def test_values_that_make_no_sense_are_refused(arguments, word):
    """A task names the setting that is wrong."""
    with pytest.raises(ValueError, match=word):
        Task("T", **arguments)


def test_two_tasks_of_one_name_are_refused():
    """Task names are unique in a virtual PLC."""
    plc = VirtualPlc()
    plc.task("T", 0.01)
    with pytest.raises(ValueError, match="already exists"):
        plc.task("T", 0.01)


def test_stop_ends_all_tasks():
    """After the with block no task runs a further scan."""
    plc, before = VirtualPlc(), threading.active_count()
    tasks = [plc.task(name, 0.001) for name in ("A", "B")]
    with plc:
        wait_for(lambda: all(task.stats.scans for task in tasks))
    assert threading.active_count() == before
    assert all(task.state is TaskState.STOPPED for task in tasks)
