"""The PLC's process with its program as generated Structured Text, translated to C and executed.

What a PLC would do, the Structured Text does: open, check, take, copy, lock. This host calls its
programs in the task's order, fills ``msg``, and reads from memory what arrived.
"""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import Any

from rosplc.config.resolve import Project, load_project
from rosplc.demo.st.process import find_translator
from rosplc.layout import Layout
from rosplc.plc.build import plc_project
from rosplc.plc.names import instance_names
from rosplc.plc.plan import ProjectOptions
from rosplc.plc.project import project_texts
from tests.soak.messages import ALL, CLASSIC, IN, Counters, fill, towards_plc

_READ, _RECORD, _WRITE = "SharedMemory_Read", "Soak_Record", "SharedMemory_Write"
_PER_SCAN = 64
_BEAT_MS = 100


def build_program(config: Path, built: Path) -> None:
    """Generate the PLC's half of a configuration, compile it, and note in a file what came of it.

    Done once for a cell: translating takes longer than a PLC may take to start again.

    Args:
        config: The configuration.
        built: The file.
    """
    built.write_bytes(pickle.dumps(find_translator().build(_texts(load_project(config)))))


def _texts(project: Project) -> dict[str, str]:
    made = plc_project(project, ProjectOptions(beat_ms=_BEAT_MS))
    texts = project_texts(made)
    # The one topic that counts every message: what came in a scan is kept, to be judged after it.
    name = instance_names([plan.topic for plan in project.topics])[IN[0]]
    block = next(v.type for gvl in made.gvls for b in gvl.blocks for v in b.variables if v.name == name)
    dut = next(
        variable.type
        for pou in made.pous
        if pou.name == block
        for part in pou.blocks
        for variable in part.variables
        if variable.name == "msg"
    )
    texts["Soak_Inbox"] = f"""{{attribute 'qualified_only'}}
VAR_GLOBAL
    udiCount : UDINT; // messages of this scan
    astMessage : ARRAY[0..{_PER_SCAN - 1}] OF {dut};
END_VAR
"""
    texts[_RECORD] = f"""PROGRAM {_RECORD}
VAR
    xMore : BOOL;
END_VAR
ROS_Read.{name}.uiMaxPerScan := {_PER_SCAN};
Soak_Inbox.udiCount := 0;
xMore := ROS_Read.{name}.xNew;
WHILE xMore DO
    Soak_Inbox.astMessage[Soak_Inbox.udiCount] := ROS_Read.{name}.msg;
    Soak_Inbox.udiCount := Soak_Inbox.udiCount + 1;
    xMore := ROS_Read.{name}.Next();
END_WHILE;
END_PROGRAM
"""
    return texts


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


class _Reading:
    """One Read block, and what it took in this scan."""

    def __init__(self, machine: Any, topic: str, block: str, layout: Layout) -> None:
        self.index = ALL.index(topic)
        self._machine, self._topic, self._block, self._layout = machine, topic, block, layout
        self._every = topic == IN[0]
        self._lost_before = 0

    def find(self) -> None:
        """Look up where everything is."""
        machine, block = self._machine, self._block
        self._new = Word(machine, f"{block}.xNew")
        self._address, _ = machine.find("Soak_Inbox.astMessage[0]" if self._every else f"{block}.msg")
        self._count = Word(machine, "Soak_Inbox.udiCount")
        self._lost = None if self._topic in CLASSIC else Word(machine, f"{block}.udiLost")

    def judge(self, counters: Counters) -> None:
        """Hand over to the counters what came in this scan."""
        size = self._layout.size
        for number in range(self._count.get() if self._every else self._new.get()):
            record = self._machine.peek(self._address + number * size, size)
            counters.take(self.index, self._layout.view(record).data)
        if self._lost is not None:
            lost = self._lost.get()
            counters.counters[self.index]["block_lost"] += (lost - self._lost_before) % 2**32
            self._lost_before = lost


class _Writing:
    """One Write block."""

    def __init__(self, machine: Any, topic: str, block: str, layout: Layout) -> None:
        self.index = ALL.index(topic)
        self._machine, self._block, self._layout = machine, block, layout
        self._number = 1

    def find(self) -> None:
        """Look up where everything is."""
        self._enable = Word(self._machine, f"{self._block}.xEnable")
        self._published = Word(self._machine, f"{self._block}.xPublished")
        self._address, _ = self._machine.find(f"{self._block}.msg")

    def fill(self, counters: Counters, generation: int) -> None:
        """Put the next message into ``msg``."""
        record = self._layout.pack({"data": fill(self.index, generation, self._number)})
        self._machine.poke(self._address, bytes(record))
        self._enable.set(1)
        counters.announce(self.index, generation, self._number)

    def sent(self) -> None:
        """Go on to the next number if the block has published this one."""
        self._number += self._published.get()


class Program:
    """The Structured Text as a program of the virtual PLC's task.

    Args:
        counters: Takes what arrived.
        generation: This process' number.
        config: The configuration that was generated from.
        built: What :func:`build_program` wrote.
    """

    def __init__(self, counters: Counters, generation: int, config: Path, built: Path) -> None:
        self._counters = counters
        self._generation = generation
        self._seen = {name: int(counters.control[name]) for name in ("online_change", "reopen")}
        project = load_project(config)
        classic = any(plan.classic for plan in project.topics)
        self._machine = machine = find_translator().machine(pickle.loads(built.read_bytes()))
        machine.may_create = classic
        machine.start()
        names = instance_names([plan.topic for plan in project.topics])
        self._reads: list[_Reading] = []
        self._writes: list[_Writing] = []
        self._classic: list[str] = []
        for plan in project.topics:
            if towards_plc(plan.topic):
                block = f"ROS_Read.{names[plan.topic]}"
                self._reads.append(_Reading(machine, plan.topic, block, plan.layout))
            else:
                block = f"ROS_Write.{names[plan.topic]}"
                self._writes.append(_Writing(machine, plan.topic, block, plan.layout))
            if plan.classic:
                self._classic.append(block)
        self._find()

    def _find(self) -> None:
        """Look up where everything is: at the start, and after an online change has moved every instance."""
        self._reopen = [Word(self._machine, f"{block}.xReopen") for block in self._classic]
        for reading in self._reads:
            reading.find()
        for writing in self._writes:
            writing.find()

    def __call__(self) -> None:
        """Run one scan."""
        counters, machine = self._counters, self._machine
        self._obey()
        machine.scan(_READ, step=0)
        machine.scan(_RECORD, step=0)
        for reading in self._reads:
            reading.judge(counters)
        for _ in range(max(1, int(counters.control["flood"]))):
            for writing in self._writes:
                writing.fill(counters, self._generation)
            machine.scan(_WRITE, step=0)
            for writing in self._writes:
                writing.sent()
        counters.control["plc_scans"] += 1

    def _obey(self) -> None:
        """Do what the campaign orders: stop inside a lock, move all instances, open names again."""
        control = self._counters.control
        if control["stop_inside"]:
            control["stop_inside"] = 0
            self._machine.option("stop_inside")
        for word in self._reopen:
            word.set(int(control["reopen"]) != self._seen["reopen"])
        self._seen["reopen"] = int(control["reopen"])
        if int(control["online_change"]) != self._seen["online_change"]:
            self._seen["online_change"] = int(control["online_change"])
            self._machine.online_change()
            self._find()

    def close(self) -> None:
        """End the program as a PLC's stop does; its claims are given back."""
        self._machine.stop()
