"""Types that cross: bridge → Read block → assignment → Write block → bridge, through real shared memory."""

from __future__ import annotations

import random
import re
import shutil
import string
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from rosplc.codec import Codec, Wire
from rosplc.described import description_of
from rosplc.layout import Layout
from rosplc.layout.nodes import ArrayNode, Node, PaddingNode, ScalarNode, SequenceNode, StringNode, StructNode
from rosplc.plc.build import build_type_library
from rosplc.plc.plan import ProjectOptions
from rosplc.plc.project import Dut, PlcProject, project_texts
from rosplc.shm import Direction, Namespace, OwnedChannel
from rosplc_st.build import Toolchain, build
from rosplc_st.machine import LibraryMachine, Machine, ProcessMachine
from rosplc_st.translator import Options
from tests.verification.plc_cell import store

__all__ = ["Crossing", "check_layout", "random_record"]


@dataclass
class Crossing:
    """A program with both blocks of some types."""

    project: PlcProject
    layouts: Sequence[Layout]
    texts: dict[str, str]

    @classmethod
    def of(cls, layouts: Sequence[Layout], distro: str, options: ProjectOptions | None = None) -> Crossing:
        """Generate both blocks of each layout, an instance of each, and a program that joins them."""
        project = build_type_library(store(distro), layouts, options)
        instances, calls = [], ["RosPlc_State.axMayOpen[0] := TRUE;"]
        for index, layout in enumerate(layouts):
            read, write = cls._block(project, layout, "Reads"), cls._block(project, layout, "Writes")
            instances += [f"    r{index} : {read}('/r{index}');", f"    w{index} : {write}('/w{index}');"]
            calls += [
                f"Cross.r{index}();",
                f"Cross.w{index}.xEnable := Cross.r{index}.xNew;",
                f"Cross.w{index}.msg := Cross.r{index}.msg;",
                f"Cross.w{index}();",
            ]
        texts = project_texts(project)
        head = "{attribute 'qualified_only'}\nVAR_GLOBAL\n"
        texts["Cross"] = head + "\n".join(instances) + "\nEND_VAR\n"
        texts["Pass"] = "PROGRAM Pass\n" + "\n".join(calls) + "\nEND_PROGRAM\n"
        return cls(project, layouts, texts)

    @staticmethod
    def _block(project: PlcProject, layout: Layout, verb: str) -> str:
        found = [
            p.name for p in project.pous if re.match(rf"{verb} {re.escape(layout.type_name)} ", p.comment)
        ]
        assert len(found) == 1, (layout.type_name, found)
        return found[0]

    def run(
        self, seed: int, rounds: int = 3, toolchain: Toolchain | None = None, options: Options | None = None
    ) -> None:
        """Send random messages through; assert that each comes out equal, as record and as wire bytes."""
        toolchain = toolchain or Toolchain(flags=("-O0",))
        program = bool(toolchain.runner)
        built = build(self.texts, options, toolchain, program=program)
        folder = Path(tempfile.mkdtemp(prefix="T", dir="/dev/shm"))
        machine: Machine = (ProcessMachine if program else LibraryMachine)(built, str(folder))
        try:
            machine.start()
            self._check(machine)
            self._cross(machine, Namespace("rosplc", str(folder)), random.Random(seed), rounds)
        finally:
            shutil.rmtree(folder)
            if isinstance(machine, ProcessMachine):
                machine.kill()

    def _check(self, machine: Machine) -> None:
        duts = {dut.name: dut for dut in self.project.duts}
        for layout in self.layouts:
            read = next(p for p in self.project.pous if p.name == self._block(self.project, layout, "Reads"))
            name = next(v.type for b in read.blocks for v in b.variables if v.name == "msg")
            check_layout(machine, duts, layout.root, name)

    def _cross(self, machine: Machine, namespace: Namespace, draw: random.Random, rounds: int) -> None:
        owned, ends = [], []
        for index, layout in enumerate(self.layouts):
            for topic, direction in ((f"/r{index}", Direction.TO_PLC), (f"/w{index}", Direction.TO_ROS)):
                about = description_of(layout, topic, direction, bridge="test")
                owned.append(OwnedChannel.open(namespace, about, record_size=layout.size))
            ends.append((owned[-2].writer(), owned[-1].reader()))
        try:
            for _ in range(6 * len(self.layouts) + 20):
                machine.scan("Pass")
            for index, layout in enumerate(self.layouts):
                assert machine.get(f"Cross.r{index}.udiError") == 0, layout.type_name
                assert machine.get(f"Cross.w{index}.xReady"), layout.type_name
            for _ in range(rounds):
                self._round(machine, ends, draw)
        finally:
            for channel in owned:
                channel.close()

    def _round(self, machine: Machine, ends: list, draw: random.Random) -> None:  # type: ignore[type-arg]
        sent = []
        for layout, (writer, _) in zip(self.layouts, ends, strict=True):
            record = random_record(layout, draw)
            # The record as the codec writes it: what lies behind a sequence's end is zero there.
            codec = Codec(layout, Wire.CDR)
            wire = codec.encode(record)
            writer.publish_wire(codec.plan, wire)
            sent.append((codec, wire, codec.decode(wire)))
        machine.scan("Pass")
        for index, (layout, (_, reader)) in enumerate(zip(self.layouts, ends, strict=True)):
            codec, wire, record = sent[index]
            assert machine.read(f"Cross.r{index}.msg") == record, f"{layout.type_name} towards the PLC"
            got = bytearray(layout.size)
            assert reader.peek(got) is not None
            assert bytes(got) == record, f"{layout.type_name} towards ROS"
            taken = reader.latest_wire(codec.plan)
            assert taken is not None
            assert taken[0] == wire, f"{layout.type_name} as wire bytes"


def random_record(layout: Layout, draw: random.Random) -> bytes:
    """Return a valid record with random values."""
    record = bytearray(layout.size)
    _fill(layout.root, record, 0, draw)
    return bytes(record)


def _fill(node: Node, record: bytearray, at: int, draw: random.Random) -> None:
    if isinstance(node, ScalarNode):
        data = bytes([draw.randrange(2)]) if node.kind == "bool" else draw.randbytes(node.size)
        record[at : at + node.size] = data
    elif isinstance(node, StringNode):
        text = "".join(draw.choices(string.printable, k=draw.randint(0, node.capacity))).encode()
        record[at : at + len(text)] = text
    elif isinstance(node, StructNode):
        for member in node.members:
            if member.count_of:
                sequence = next(m.node for m in node.members if m.name == member.count_of and not m.count_of)
                assert isinstance(sequence, SequenceNode)
                count = draw.randint(0, sequence.capacity)
                record[at + member.offset : at + member.offset + 4] = count.to_bytes(4, "little")
            elif not isinstance(member.node, PaddingNode):
                _fill(member.node, record, at + member.offset, draw)
    elif isinstance(node, (ArrayNode, SequenceNode)):
        for index in range(node.capacity):
            _fill(node.element, record, at + index * node.element.size, draw)


def check_layout(machine: Machine, duts: dict[str, Dut], node: StructNode, name: str) -> None:
    """Assert that gcc's sizes and offsets of a DUT, and of all DUTs in it, are the layout's."""
    assert machine.offset(name, "")[1] == node.size, name
    for variable, member in zip(duts[name].members, node.members, strict=True):
        assert machine.offset(name, variable.name) == (member.offset, member.node.size), (
            f"{name}.{variable.name}"
        )
        inner = member.node.element if isinstance(member.node, (ArrayNode, SequenceNode)) else member.node
        if isinstance(inner, StructNode):
            check_layout(machine, duts, inner, variable.type.rpartition(" OF ")[2].strip())
