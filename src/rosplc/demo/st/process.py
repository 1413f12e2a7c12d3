"""The PLC's process with ``--plc st``: runs the compiled Structured Text scan by scan.

All that a PLC would do, the Structured Text does: open, check, take, steer, send. This host calls
its programs in the task's order, works the operator's switch, and looks at memory after the
scan, to count and check what came, with the very code that the Python program is counted with.
"""

from __future__ import annotations

import sys
import threading
import time
from pathlib import Path
from typing import Any

from rosplc.config.resolve import load_project
from rosplc.demo.messages import COMMAND, robot_topics
from rosplc.demo.plan import Plan
from rosplc.demo.processes import Commands, report
from rosplc.demo.st.checkout import find_translator
from rosplc.demo.st.sources import CONFIGURATION, INBOX, MAIN, READ, RECORDER, WRITE, read_texts
from rosplc.demo.task import Arrivals, serve_demo
from rosplc.errors import CODES, RosplcError, SetupError
from rosplc.layout import Layout
from rosplc.plc.names import instance_names


class Word:
    """A BOOL or UINT or UDINT of the PLC's memory, by its path."""

    def __init__(self, machine: Any, path: str) -> None:
        self._machine = machine
        self._address, type_ = machine.find(path)
        self._size = machine.size(type_)

    def get(self) -> int:
        """Return its value."""
        return int.from_bytes(self._machine.peek(self._address, self._size), "little")

    def set(self, value: int) -> None:
        """Change it."""
        self._machine.poke(self._address, value.to_bytes(self._size, "little"))


class Inbox:
    """The messages of a topic that the recorder kept in this scan."""

    def __init__(self, machine: Any, instance: str, layout: Layout) -> None:
        self._machine = machine
        self._layout = layout
        self._count = Word(machine, f"{INBOX}.udi_{instance}")
        self._address, dut = machine.find(f"{INBOX}.ast_{instance}[0]")
        if machine.size(dut) != layout.size:
            raise SetupError(
                "SYS002",
                f"{layout.type_name} takes {machine.size(dut)} bytes in C, {layout.size} in its layout",
            )

    def messages(self) -> list[Any]:
        """Return views of copies."""
        size = self._layout.size
        return [
            self._layout.view(self._machine.peek(self._address + number * size, size))
            for number in range(self._count.get())
        ]


def _reason(block: dict[str, Word]) -> str:
    """Return why a block waits; empty if it does not."""
    if error := block["udiError"].get():
        return CODES[f"SHM{error}"].title
    return "" if block["xPeerAlive"].get() else "the bridge does not beat"


class Program:
    """The Structured Text as a program of the virtual PLC's task."""

    def __init__(self, plan: Plan, commands: Commands, folder: Path) -> None:
        translator = find_translator()
        self._machine = machine = translator.machine(translator.build(read_texts(folder)))
        machine.start()
        self._commands = commands
        self._kinds = robot_topics(plan.topics)
        layouts = {topic.topic: topic.layout for topic in load_project(folder / CONFIGURATION).topics}
        names = instance_names(list(self._kinds))
        self._inboxes = {topic: Inbox(machine, names[topic], layouts[topic]) for topic in self._kinds}

        def outputs(path: str, *more: str) -> dict[str, Word]:
            return {name: Word(machine, f"{path}.{name}") for name in ("xPeerAlive", "udiError", *more)}

        self._reads = {
            topic: outputs(f"ROS_Read.{names[topic]}", "udiSequence", "udiLost") for topic in self._kinds
        }
        write = instance_names([COMMAND[0]])[COMMAND[0]]
        self._write = outputs(f"ROS_Write.{write}", "xReady", "udiPublished")
        self._drive = Word(machine, f"{MAIN}.xDrive")
        self.arrivals = Arrivals(self._kinds)
        self.lock = threading.Lock()
        self.state: dict[str, Any] = {}
        self._scans = 0
        self._sum_ns = 0
        self._longest_ns = 0

    def __call__(self) -> None:
        """Run one scan, then count what it took."""
        self._drive.set(self._commands.go.is_set() and not self._commands.drain.is_set())
        began = time.perf_counter_ns()
        self._run(READ)
        self._run(RECORDER)
        taken_ns = time.time_ns()
        self._run(MAIN)
        self._run(WRITE)
        self._note(time.perf_counter_ns() - began)
        for topic, inbox in self._inboxes.items():
            for message in inbox.messages():
                self.arrivals.add(topic, self._kinds[topic].open(message), taken_ns)
        with self.lock:
            self.state = self._state()

    def _run(self, program: str) -> None:
        try:
            self._machine.scan(program)
        except AssertionError as error:
            raise SetupError("SYS002", f"the Structured Text went wrong: {error}") from error

    def _note(self, duration_ns: int) -> None:
        self._scans += 1
        self._sum_ns += duration_ns
        self._longest_ns = max(self._longest_ns, duration_ns)

    def _state(self) -> dict[str, Any]:
        blocks = {**self._reads, COMMAND[0]: self._write}
        waiting = {topic: reason for topic, block in blocks.items() if (reason := _reason(block))}
        keys = {"sequence": "udiSequence", "lost": "udiLost", "error": "udiError"}
        return {
            "ready": not waiting and bool(self._write["xReady"].get()),
            "waiting": waiting,
            "sent": {COMMAND[0]: self._write["udiPublished"].get()},
            "received": {topic: tally.to_dict() for topic, tally in self.arrivals.tallies.items()},
            "counters": {
                topic: {key: read[output].get() for key, output in keys.items()}
                for topic, read in self._reads.items()
            },
            "program": {
                "mean_us": self._sum_ns / max(1, self._scans) / 1000,
                "max_us": self._longest_ns / 1000,
            },
        }

    def stop(self) -> None:
        """End the program as a PLC's stop does; its claims are given back."""
        self._machine.stop()


def main() -> None:
    """Run the PLC until told to stop."""
    commands = Commands()
    plan = Plan.from_json(sys.argv[1])
    try:
        program = Program(plan, commands, Path(sys.argv[2]))
        serve_demo(program, plan.interval, commands)
    except RosplcError as error:
        report("error", **error.to_dict())
        sys.exit(1)
    program.stop()


if __name__ == "__main__":
    main()
