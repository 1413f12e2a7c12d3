"""A virtual PLC: some tasks that start and stop together."""

from __future__ import annotations

import time

from rosplc.virtual_plc.task import Task, TaskState

__all__ = ["VirtualPlc"]


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

    def task(
        self,
        name: str,
        interval: float,
        *,
        priority: int = 15,
        watchdog: float | None = None,
        watchdog_sensitivity: int = 1,
        realtime: bool = False,
    ) -> Task:
        """Add a cyclic task and return it; the arguments are those of :class:`Task`."""
        if any(task.name == name for task in self.tasks):
            raise ValueError(f"a task named {name} exists already")
        task = Task(
            name,
            interval,
            priority=priority,
            watchdog=watchdog,
            watchdog_sensitivity=watchdog_sensitivity,
            realtime=realtime,
        )
        self.tasks.append(task)
        return task

    def start(self) -> None:
        """Start all tasks, the highest priority first."""
        for task in sorted(self.tasks, key=lambda task: task.priority):
            task.start()

    def stop(self) -> None:
        """Stop all tasks, each after the scan in progress."""
        for task in self.tasks:
            task.stop()

    def check(self) -> None:
        """Raise what halted a task, if one has halted.

        Raises:
            BaseException: What a program raised; TimeoutError from the watchdog.
        """
        for task in self.tasks:
            if task.state is TaskState.EXCEPTION and task.error is not None:
                raise task.error
            if task.overdue:
                raise TimeoutError(f"task {task.name}: the scan in progress exceeds the watchdog")

    def run(self, duration: float | None = None) -> None:
        """Start, run for ``duration`` seconds (None: until Ctrl-C, or a task halts), and stop.

        Raises:
            BaseException: What halted a task; with a duration KeyboardInterrupt, too.
        """
        end = None if duration is None else time.monotonic() + duration
        self.start()
        try:
            while end is None or time.monotonic() < end:
                self.check()
                rest = 0.05 if end is None else min(0.05, end - time.monotonic())
                time.sleep(max(0.0, rest))
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
