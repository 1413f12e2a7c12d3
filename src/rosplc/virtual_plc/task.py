"""A cyclic task: it calls its programs at absolute times, as a PLC's scheduler does."""

from __future__ import annotations

import enum
import os
import threading
import time
from collections.abc import Callable, Iterable
from typing import TypeAlias

from rosplc.virtual_plc.scan import Scan, enter_scan, leave_scan
from rosplc.virtual_plc.stats import CycleStats

__all__ = ["Program", "Task", "TaskState"]

Program: TypeAlias = Callable[[], object]
"""A program takes nothing: like a PROGRAM in a PLC it keeps its state in its own objects."""

_FIFO_OF_PRIORITY_0 = 67  # CODESYS on Linux runs IEC priorities 0 … 15 as SCHED_FIFO 67 … 52


class TaskState(enum.Enum):
    """Where a task stands."""

    STOPPED = "stopped"
    RUNNING = "running"
    EXCEPTION = "exception"
    """A program raised, or a scan exceeded the watchdog; the task runs no further scan."""


class Task:
    """A cyclic task of a virtual PLC.

    Scans begin at ``start + n × interval`` of the monotonic clock, so that a late scan does
    not move the ones after it. A scan whose whole interval has passed is counted as missed
    and left out, as PLC runtimes do; it is never made up for.

    Args:
        name: The task's name; readers show it in the channel's lines.
        interval: Seconds from one scan to the next, above 0.
        priority: 0 (highest) … 31, as in IEC 61131-3. It takes effect where ``realtime`` is
            set and the system permits SCHED_FIFO; otherwise all tasks share the processor
            as ordinary threads do (:attr:`scheduling` says which it is).
        watchdog: Seconds that a scan may take; None for no watchdog.
        watchdog_sensitivity: How many scans in a row may exceed it before the task halts.
        programs: Called in order, once per scan.
        realtime: Ask for SCHED_FIFO.

    Raises:
        ValueError: A time is not above 0, or the priority is outside 0 … 31.
    """

    def __init__(
        self,
        name: str,
        interval: float,
        *,
        priority: int = 15,
        watchdog: float | None = None,
        watchdog_sensitivity: int = 1,
        programs: Iterable[Program] = (),
        realtime: bool = False,
    ) -> None:
        if not interval > 0:
            raise ValueError(f"task {name}: interval must be above 0 s, not {interval}")
        if not 0 <= priority <= 31:
            raise ValueError(f"task {name}: priority must be 0 to 31, not {priority}")
        if watchdog is not None and not watchdog > 0:
            raise ValueError(f"task {name}: watchdog must be above 0 s, not {watchdog}")
        if watchdog_sensitivity < 1:
            raise ValueError(f"task {name}: watchdog_sensitivity must be at least 1")
        self.name = name
        self.priority = priority
        self.interval_ns = max(1, round(interval * 1e9))
        self.watchdog_ns = None if watchdog is None else round(watchdog * 1e9)
        self.watchdog_sensitivity = watchdog_sensitivity
        self.stats = CycleStats()
        self.state = TaskState.STOPPED
        self.error: BaseException | None = None
        self.scheduling = "not started"
        self._programs: list[Program] = list(programs)
        self._realtime = realtime
        self._excesses_in_a_row = 0
        self._scan_began_ns: int | None = None
        self._thread: threading.Thread | None = None
        self._stop = threading.Event()

    def program(self, program: Program) -> Program:
        """Add ``program``; usable as a decorator. Programs run in the order of adding."""
        self._programs.append(program)
        return program

    @property
    def overdue(self) -> bool:
        """Whether the scan that runs now already exceeds the watchdog.

        A thread cannot be halted from outside, so a program that never returns is
        reported here rather than stopped.
        """
        began = self._scan_began_ns
        return (
            began is not None
            and self.watchdog_ns is not None
            and time.monotonic_ns() - began > self.watchdog_ns
        )

    def scan(self, due_ns: int | None = None) -> None:
        """Run one scan now, in the calling thread.

        Args:
            due_ns: The monotonic time at which it should have begun; now if None.

        Raises:
            BaseException: Whatever a program raises; the task is then in state EXCEPTION.
        """
        began = time.monotonic_ns()
        self._scan_began_ns = began
        enter_scan(Scan(self.name, self.stats.scans + 1, began))
        try:
            for program in self._programs:
                program()
        except BaseException as error:
            self.error, self.state = error, TaskState.EXCEPTION
            raise
        finally:
            leave_scan()
            self._scan_began_ns = None
            duration = time.monotonic_ns() - began
            self.stats.add(max(0, began - (began if due_ns is None else due_ns)), duration)
            self._watch(duration)

    def _watch(self, duration: int) -> None:
        if self.watchdog_ns is None or duration <= self.watchdog_ns:
            self._excesses_in_a_row = 0
            return
        self.stats.watchdog_excesses += 1
        self._excesses_in_a_row += 1
        if self._excesses_in_a_row >= self.watchdog_sensitivity and self.error is None:
            self.error = TimeoutError(
                f"task {self.name}: a scan took {duration / 1e6:.3f} ms, "
                f"its watchdog allows {self.watchdog_ns / 1e6:.3f} ms"
            )
            self.state = TaskState.EXCEPTION

    def start(self) -> None:
        """Start the task's thread; nothing happens if it runs already.

        Raises:
            RuntimeError: The task halted with an exception; make a new one.
        """
        if self.state is TaskState.EXCEPTION:
            raise RuntimeError(f"task {self.name} halted: {self.error}")
        if self._thread is not None:
            return
        self._stop.clear()
        self.state = TaskState.RUNNING
        self._thread = threading.Thread(target=self._run, name=f"plc-{self.name}", daemon=True)
        self._thread.start()

    def stop(self, timeout: float | None = 5.0) -> bool:
        """End the task after the scan in progress.

        Args:
            timeout: Seconds to wait for that scan; None waits for ever.

        Returns:
            Whether the task has ended.
        """
        self._stop.set()
        thread = self._thread
        if thread is None or thread is threading.current_thread():
            return thread is None
        thread.join(timeout)
        if thread.is_alive():
            return False
        self._thread = None
        if self.state is TaskState.RUNNING:
            self.state = TaskState.STOPPED
        return True

    def _run(self) -> None:
        self.scheduling = self._schedule()
        due = time.monotonic_ns()
        while not self._stop.is_set():
            try:
                self.scan(due)
            except BaseException:  # kept in self.error, which the owner reads
                return
            if self.state is TaskState.EXCEPTION:
                return
            due += self.interval_ns
            late = time.monotonic_ns() - due
            if late >= self.interval_ns:
                skipped = late // self.interval_ns
                self.stats.missed += skipped
                due += skipped * self.interval_ns
            self._stop.wait(max(0, due - time.monotonic_ns()) / 1e9)

    def _schedule(self) -> str:
        if not self._realtime:
            return "SCHED_OTHER"
        fifo = max(1, _FIFO_OF_PRIORITY_0 - self.priority)
        try:
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(fifo))
        except PermissionError:
            return "SCHED_OTHER (SCHED_FIFO is not permitted to this user)"
        return f"SCHED_FIFO {fifo}"
