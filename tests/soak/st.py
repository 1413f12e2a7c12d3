"""The PLC's process with its program as generated Structured Text, translated to C and executed.

What a PLC would do, the Structured Text does: open, check, take, copy, lock. This host calls its
programs in the task's order, fills ``msg``, and reads from memory what arrived.
"""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import Any

from rosplc.config.resolve import Project, load_project
from rosplc.demo.st.checkout import find_translator
from rosplc.demo.st.process import Word
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


class _Reading:
    """One Read block, and what it took in this scan."""

    def __init__(self, machine: Any, topic: str, block: str, layout: Layout) -> None:
        self.index = ALL.index(topic)
        self._machine, self._layout = machine, layout
        self._new = Word(machine, f"{block}.xNew")
        self._every = topic == IN[0]
        self._address, _ = machine.find("Soak_Inbox.astMessage[0]" if self._every else f"{block}.msg")
        self._count = Word(machine, "Soak_Inbox.udiCount")
        self._lost = None if topic in CLASSIC else Word(machine, f"{block}.udiLost")
        self._lost_before = 0

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
        self._machine, self._layout = machine, layout
        self._enable = Word(machine, f"{block}.xEnable")
        self._published = Word(machine, f"{block}.xPublished")
        self._address, _ = machine.find(f"{block}.msg")
        self._number = 1

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
        self._blocks = {
            plan.topic: f"ROS_{'Read' if towards_plc(plan.topic) else 'Write'}.{names[plan.topic]}"
            for plan in project.topics
        }
        self._reopen = [
            Word(machine, f"{block}.xReopen") for topic, block in self._blocks.items() if topic in CLASSIC
        ]
        self._find({plan.topic: plan.layout for plan in project.topics})

    def _find(self, layouts: dict[str, Layout]) -> None:
        reads = [topic for topic in self._blocks if towards_plc(topic)]
        writes = [topic for topic in self._blocks if not towards_plc(topic)]
        machine, blocks = self._machine, self._blocks
        self._layouts = layouts
        self._reads = [_Reading(machine, topic, blocks[topic], layouts[topic]) for topic in reads]
        self._writes = [_Writing(machine, topic, blocks[topic], layouts[topic]) for topic in writes]

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
        """Do what the campaign orders: stand still inside a lock, move all instances, open names again."""
        control = self._counters.control
        if control["stop_inside"]:
            control["stop_inside"] = 0
            self._machine.option("stop_inside")
        for word in self._reopen:
            word.set(int(control["reopen"]) != self._seen["reopen"])
        self._seen["reopen"] = int(control["reopen"])
        if int(control["online_change"]) != self._seen["online_change"]:
            self._seen["online_change"] = int(control["online_change"])
            self._change()

    def _change(self) -> None:
        self._machine.online_change()
        numbers = [writing._number for writing in self._writes]
        lost = [reading._lost_before for reading in self._reads]
        # Every instance has moved; so have the addresses that this host keeps.
        self._reopen = [
            Word(self._machine, f"{block}.xReopen")
            for topic, block in self._blocks.items()
            if topic in CLASSIC
        ]
        self._find(self._layouts)
        for writing, number in zip(self._writes, numbers, strict=True):
            writing._number = number
        for reading, before in zip(self._reads, lost, strict=True):
            reading._lost_before = before

    def close(self) -> None:
        """End the program as a PLC's stop does; its claims are given back."""
        self._machine.stop()
