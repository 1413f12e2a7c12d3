"""A virtual PLC: cyclic tasks that call their programs at absolute times, as a PLC's scheduler does."""

from __future__ import annotations

import enum
import os
import threading
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, TypeAlias


@dataclass(slots=True)
class Scan:
    """A scan of a task; outside a task (a notebook, a test), every call counts as a separate scan.

    A PLC makes at most one attempt to open an object per scan over all blocks (spec/shm-format.md, 8.6).
    """

    task: str  # the task's name, empty outside a task
    number: int  # counts the task's scans from 1; 0 outside a task
    now_ns: int  # the monotonic clock at the scan's start, nanoseconds
    may_open: bool = True  # whether this scan still has its one attempt to open an object

    def claim_open(self) -> bool:
        """Use the scan's one attempt to open an object; False if it is already used."""
        had, self.may_open = self.may_open, False
        return had


_local = threading.local()


def current_scan() -> Scan:
    """Return the calling thread's scan, or a new one outside a task."""
    scan: Scan | None = getattr(_local, "scan", None)
    return Scan("", 0, time.monotonic_ns()) if scan is None else scan


def enter_scan(scan: Scan | None) -> None:
    """Make ``scan`` the calling thread's scan; None ends it."""
    _local.scan = scan


@dataclass(slots=True)
class CycleStats:
    """The counters of a task; all times are in nanoseconds."""

    scans: int = 0  # those that ran
    missed: int = 0  # left out: the one before took too long, or the machine was late by an interval
    jitter_max: int = 0  # the most by which a scan began after its time
    cycle_last: int = 0  # duration of the last scan
    cycle_min: int = 0  # shortest scan; 0 before the first
    cycle_max: int = 0  # longest scan
    cycle_sum: int = 0  # sum over all scans, for the mean
    watchdog_excesses: int = 0  # scans that took longer than the watchdog time

    @property
    def cycle_mean(self) -> float:
        """Mean duration of a scan in nanoseconds; 0 before the first."""
        return self.cycle_sum / self.scans if self.scans else 0.0

    def add(self, lateness: int, duration: int) -> None:
        """Count a scan that began ``lateness`` ns late and took ``duration`` ns."""
        self.scans += 1
        self.jitter_max = max(self.jitter_max, lateness)
        self.cycle_last = duration
        self.cycle_min = duration if self.scans == 1 else min(self.cycle_min, duration)
        self.cycle_max = max(self.cycle_max, duration)
        self.cycle_sum += duration

    def to_dict(self) -> dict[str, int | float]:
        """Return the counters as plain data, times in microseconds."""
        times = ("jitter_max", "cycle_last", "cycle_min", "cycle_mean", "cycle_max")
        counts = ("scans", "missed", "watchdog_excesses")
        return {name: getattr(self, name) for name in counts} | {
            f"{name}_us": getattr(self, name) / 1000 for name in times
        }


Program: TypeAlias = Callable[[], object]
"""A program has no arguments: like a PROGRAM in a PLC, it keeps its state in its own objects."""

_FIFO_OF_PRIORITY_0 = 67  # CODESYS on Linux runs IEC priorities 0 … 15 as SCHED_FIFO 67 … 52


class TaskState(enum.Enum):
    """The state of a task."""

    STOPPED = "stopped"
    RUNNING = "running"
    EXCEPTION = "exception"
    """A program raised an exception, or a scan exceeded the watchdog; the task runs no further scans."""


class Task:
    """A cyclic task of a virtual PLC.

    Scans begin at ``start + n × interval`` of the monotonic clock, so a late scan does not delay
    later ones. A scan whose whole interval has passed is counted as missed and skipped, as in
    PLC runtimes; it is not made up for.

    Args:
        name: The task's name, which readers store in the channel's lines.
        interval: Seconds from one scan to the next, above 0.
        priority: 0 (highest) … 31, as in IEC 61131-3. It takes effect if ``realtime`` is set
            and the system permits SCHED_FIFO; otherwise, all tasks share the processor as
            ordinary threads (:attr:`scheduling` shows which applies).
        watchdog: Maximum duration of a scan in seconds; None for no watchdog.
        watchdog_sensitivity: The number of consecutive scans that exceed it after which the task halts.
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
        for sound, what in (
            (interval > 0, f"interval must be above 0 s, not {interval}"),
            (0 <= priority <= 31, f"priority must be 0 to 31, not {priority}"),
            (watchdog is None or watchdog > 0, f"watchdog must be above 0 s, not {watchdog}"),
            (watchdog_sensitivity >= 1, "watchdog_sensitivity must be at least 1"),
        ):
            if not sound:
                raise ValueError(f"task {name}: {what}")
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
        """Add ``program``; usable as a decorator. Programs run in the order in which they were added."""
        self._programs.append(program)
        return program

    @property
    def overdue(self) -> bool:
        """Whether the current scan already exceeds the watchdog.

        A thread cannot be halted from outside, so a program that never returns is
        only reported here, not stopped.
        """
        began, allowed = self._scan_began_ns, self.watchdog_ns
        return began is not None and allowed is not None and time.monotonic_ns() - began > allowed

    def scan(self, due_ns: int | None = None) -> None:
        """Run one scan now in this thread; it was due at ``due_ns`` of the monotonic clock (None: now).

        Raises what a program raises; the task is then in state EXCEPTION.
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
            enter_scan(None)
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
                f"but its watchdog allows {self.watchdog_ns / 1e6:.3f} ms"
            )
            self.state = TaskState.EXCEPTION

    def start(self) -> None:
        """Start the task's thread; does nothing if it is already running.

        Raises RuntimeError if the task halted with an exception; create a new task.
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
        """End the task after the scan in progress, and wait at most ``timeout`` seconds (None: forever).

        Return whether it has ended.
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
            return "SCHED_OTHER (this user is not allowed to use SCHED_FIFO)"
        return f"SCHED_FIFO {fifo}"


class VirtualPlc:
    """A stand-in for a soft-PLC: tasks with programs, run as threads of this process.

    Use it as a context manager, or call :meth:`start` and :meth:`stop`::

        plc = VirtualPlc()
        task = plc.task("RosTask", interval=0.01)

        @task.program
        def main() -> None: ...

        plc.run(duration=10.0)
    """

    def __init__(self) -> None:
        self.tasks: list[Task] = []
        self._stopped = threading.Event()

    def task(self, name: str, interval: float, **options: Any) -> Task:
        """Add a cyclic task and return it; ``options`` are the other arguments of :class:`Task`."""
        if any(task.name == name for task in self.tasks):
            raise ValueError(f"a task named {name} already exists")
        self.tasks.append(Task(name, interval, **options))
        return self.tasks[-1]

    def start(self) -> None:
        """Start all tasks, the highest priority first."""
        self._stopped.clear()
        for task in sorted(self.tasks, key=lambda task: task.priority):
            task.start()

    def stop(self) -> None:
        """Stop all tasks, each after its scan in progress; also callable from a program; ends :meth:`run`."""
        self._stopped.set()
        for task in self.tasks:
            task.stop()

    def check(self) -> None:
        """Raise the exception that halted a task, if one has halted.

        Raises BaseException: The program's exception; TimeoutError from the watchdog.
        """
        for task in self.tasks:
            if task.state is TaskState.EXCEPTION and task.error is not None:
                raise task.error
            if task.overdue:
                raise TimeoutError(f"task {task.name}: the scan in progress exceeds the watchdog time")

    def run(self, duration: float | None = None) -> None:
        """Start, run for ``duration`` seconds (None: until Ctrl-C, or a task halts), or until :meth:`stop`.

        Raises BaseException: The exception that halted a task; with a duration, also KeyboardInterrupt.
        """
        end = None if duration is None else time.monotonic() + duration
        self.start()
        try:
            while not self._stopped.is_set() and (end is None or time.monotonic() < end):
                self.check()
                rest = 0.05 if end is None else min(0.05, end - time.monotonic())
                self._stopped.wait(max(0.0, rest))
        except KeyboardInterrupt:
            if duration is not None:
                raise
        finally:
            self.stop()
        self.check()

    def __enter__(self) -> VirtualPlc:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()
