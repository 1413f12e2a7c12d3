"""Run a generated project as a PLC: its tasks by the machine's clock, against real shared memory.

    python -m rosplc_st.run_project plc/ --task 10ms SharedMemory_Read MAIN SharedMemory_Write

The folder holds ``.st`` files, at any depth. Without ``--task`` every program of the folder runs every
10 ms, those that read first and those that write last. No CODESYS is involved: this is the translated
text in a process of its own, for demonstrations and tests.
"""

from __future__ import annotations

import argparse
import re
import signal
import sys
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from rosplc_st.build import build
from rosplc_st.machine import LibraryMachine, Machine
from rosplc_st.translator import Options, TranslationError

__all__ = ["CyclicTask", "default_task", "load_texts", "main", "run_tasks"]


@dataclass
class CyclicTask:
    """Programs that run in order, every ``interval`` seconds; counts scans, and those that came late."""

    interval: float
    programs: tuple[str, ...]
    scans: int = 0
    late: int = 0
    longest: float = 0.0
    _error: BaseException | None = field(default=None, repr=False)

    def run(self, machine: Machine, stop: threading.Event) -> None:
        """Scan on an absolute-time grid until ``stop`` is set; what goes wrong ends the task."""
        due = time.monotonic()
        while not stop.is_set():
            began = time.monotonic()
            try:
                for program in self.programs:
                    machine.scan(program, step=0)
            except BaseException as error:
                self._error = error
                stop.set()
                return
            self.scans += 1
            now = time.monotonic()
            self.longest = max(self.longest, now - began)
            due += self.interval
            if due < now:
                self.late += 1
                due = now
            stop.wait(due - now)

    def check(self) -> None:
        """Raise what has ended the task, if anything has."""
        if self._error is not None:
            raise self._error


def load_texts(folder: Path) -> dict[str, str]:
    """Return the objects of a folder by name; a ``.st`` file holds one, named as the file."""
    paths = sorted(folder.rglob("*.st"))
    if not paths:
        raise FileNotFoundError(f"{folder} holds no .st files")
    return {path.stem: path.read_text(encoding="utf-8") for path in paths}


def default_task(programs: Sequence[str], interval: float = 0.01) -> CyclicTask:
    """Return one task with all programs: what reads from ROS first, what writes to ROS last."""

    def order(name: str) -> tuple[int, str]:
        upper = name.upper()
        place = 0 if "SHAREDMEMORY_READ" in upper else 2 if "SHAREDMEMORY_WRITE" in upper else 1
        return place, upper

    return CyclicTask(interval, tuple(sorted(programs, key=order)))


def run_tasks(
    machine: Machine, tasks: Sequence[CyclicTask], seconds: float | None, stop: threading.Event
) -> None:
    """Start a machine, run its tasks until ``stop`` is set or time is up, and end its program.

    Raises:
        BaseException: What ended a task.
    """
    machine.option("real_clock")
    machine.start()
    threads = [threading.Thread(target=task.run, args=(machine, stop), daemon=True) for task in tasks]
    for thread in threads:
        thread.start()
    stop.wait(seconds)
    stop.set()
    for thread in threads:
        thread.join()
    machine.stop()
    for task in tasks:
        task.check()


def _seconds(text: str) -> float:
    match = re.fullmatch(r"(\d+(?:\.\d+)?)(us|ms|s)", text)
    if not match:
        raise argparse.ArgumentTypeError(f"{text!r} is no time such as 10ms")
    return float(match[1]) * {"us": 1e-6, "ms": 1e-3, "s": 1.0}[match[2]]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a project from the command line; return the exit status."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("project", type=Path, help="folder with .st files")
    parser.add_argument("--task", nargs="+", action="append", metavar=("INTERVAL", "PROGRAM"))
    parser.add_argument("--seconds", type=float, help="stop after this time")
    parser.add_argument("--directory", default="/dev/shm", help="where shared memory lies")
    given = parser.parse_args(arguments)
    try:
        texts = load_texts(given.project)
        built = build(texts, Options())
    except (TranslationError, FileNotFoundError, RuntimeError) as error:
        print(f"run_project: {error}", file=sys.stderr)
        return 1
    known = [block.name for block in built.translation.program.blocks.values() if block.is_program]
    tasks = [CyclicTask(_seconds(item[0]), tuple(item[1:])) for item in given.task or ()]
    unknown = [p for task in tasks for p in task.programs if p.upper() not in known]
    if unknown or not known:
        print(f"run_project: no program {', '.join(unknown) or 'at all'}", file=sys.stderr)
        return 1
    tasks = tasks or [default_task(known)]
    machine = LibraryMachine(built, given.directory)
    machine.may_create = "RosPlc_Classic" in texts
    stop = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.set())
    print("running", *known, flush=True)
    run_tasks(machine, tasks, given.seconds, stop)
    for task in tasks:
        print(
            f"{' '.join(task.programs)}: {task.scans} scans, {task.late} late,"
            f" longest {task.longest * 1e6:.0f} us"
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
