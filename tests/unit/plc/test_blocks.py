"""The blocks of a type: what they declare, and that a faulty record cannot leave its arrays."""

from __future__ import annotations

import re

import pytest

from rosplc.layout import Limits
from rosplc.plc import blocks
from rosplc.plc.base import base_objects, classic_objects
from rosplc.plc.names import is_reserved
from rosplc.plc.types import DutBuilder
from tests.unit.plc.projects import JOINTS, STORE, custom, layout, named


def block(each, store=STORE, kind="Read", **options):
    builder = DutBuilder(store)
    name = builder.add(each)
    return blocks.block(kind, each, builder, f"{name}_Block", "ROS/Blocks", **options), builder


def mend(pou):
    return next(method for method in pou.methods if method.name == "Mend")


class Mender:
    """Runs a Mend method, which is assignments, IF and FOR alone, on a record in Python."""

    def __init__(self, text):
        self.lines = [line.strip() for line in text.splitlines()]
        self.clamped, self.ended = set(), set()
        self.run(0, len(self.lines), {})

    def run(self, at, end, loops):
        while at < end:
            line = self.lines[at]
            if match := re.fullmatch(r"FOR (\w+) := 0 TO (\d+) DO", line):
                close = self.close(at, "FOR ", "END_FOR;")
                assert match[1] not in loops, "a loop's variable is in use"
                for value in range(int(match[2]) + 1):
                    self.run(at + 1, close, {**loops, match[1]: value})
                at = close
            elif match := re.fullmatch(r"IF (.+) > (\d+) THEN", line):
                assert self.lines[at + 1] == f"{match[1]} := {match[2]};"
                assert self.lines[at + 2] == "END_IF;"
                self.clamped.add((self.place(match[1], loops), int(match[2])))
                at += 2
            elif match := re.fullmatch(r"pbEnd := ADR\((.+)\);", line):
                step = re.fullmatch(r"pbEnd := pbEnd \+ (\d+);", self.lines[at + 1])
                assert self.lines[at + 2] == "pbEnd^ := 0;"
                self.ended.add((self.place(match[1], loops), int(step[1])))
                at += 2
            else:
                assert line == "Mend := TRUE;"
            at += 1

    def close(self, at, opening, closing):
        depth = 0
        for index in range(at, len(self.lines)):
            depth += self.lines[index].startswith(opening) - (self.lines[index] == closing)
            if depth == 0:
                return index
        raise AssertionError("a loop is not closed")

    @staticmethod
    def place(path, loops):
        return re.sub(r"\[(\w+)\]", lambda match: f"[{loops[match[1]]}]", path)


def expected(builder, dut_name, path="stShadow"):
    """Return every count with its capacity and every string with its length, from the DUTs alone."""
    counts, strings = set(), set()

    def walk(type_text, place):
        if match := re.fullmatch(r"ARRAY\[0\.\.(\d+)\] OF (.+)", type_text):
            for index in range(int(match[1]) + 1):
                walk(match[2], f"{place}[{index}]")
        elif match := re.fullmatch(r"STRING\((\d+)\)", type_text):
            strings.add((place, int(match[1])))
        elif "_" in type_text:
            dut = named(tuple(builder.duts), type_text)
            for index, member in enumerate(dut.members):
                walk(member.type, f"{place}.{member.name}")
                if member.comment.startswith("elements of"):
                    following = (m for m in dut.members[index + 1 :] if not m.name.startswith("abPad"))
                    capacity = re.match(r"ARRAY\[0\.\.(\d+)\]", next(following).type)
                    counts.add((f"{place}.{member.name}", int(capacity[1]) + 1))

    walk(dut_name, path)
    return counts, strings


DEEP = {
    "Leaf": "string[<=2] words\nstring<=5 label\nuint8[<=3] data\n",
    "Branch": "Leaf[2] pair\nLeaf[<=2] more\nstring title\n",
    "Tree": "Branch[<=2] branches\nBranch one\nfloat64[<=4] values\n",
}


@pytest.mark.parametrize("name", ["Leaf", "Branch", "Tree"])
def test_every_count_is_clamped_and_every_string_ended(tmp_path, name):
    """In arrays and sequences of structs too, and nothing else of the record is touched."""
    store = custom(tmp_path, **DEEP)
    each = layout(f"cell_msgs/msg/{name}", store=store)
    pou, builder = block(each, store)
    mender = Mender(mend(pou).implementation)
    assert (mender.clamped, mender.ended) == expected(builder, builder.add(each))


@pytest.mark.parametrize("type_name", ["std_msgs/msg/Empty", "geometry_msgs/msg/Twist", "std_msgs/msg/Int32"])
def test_a_type_without_counts_and_strings_needs_no_mending(type_name):
    """The method is there and does nothing, without variables."""
    pou, _ = block(layout(type_name))
    assert mend(pou).implementation == "Mend := TRUE;"
    assert mend(pou).blocks == ()


def test_mending_declares_what_it_uses(tmp_path):
    """Every loop has a variable of its own, all of them declared."""
    store = custom(tmp_path, **DEEP)
    pou, _ = block(layout("cell_msgs/msg/Tree", store=store), store)
    text = mend(pou).implementation
    declared = {v.name for b in mend(pou).blocks for v in b.variables}
    assert declared == set(re.findall(r"\b(?:udi\d+|pbEnd)\b", text))


def test_mending_follows_every_bundled_type():
    """For each type of a distribution, with small capacities so that each element is looked at."""
    for type_name in STORE.names():
        each = layout(type_name, Limits(string=3, sequence=2))
        pou, builder = block(each)
        mender = Mender(mend(pou).implementation)
        assert (mender.clamped, mender.ended) == expected(builder, builder.add(each)), type_name


def test_a_block_names_the_layout_that_it_expects():
    """Both words of the layout id and the record's size are in the body, for both directions."""
    each = layout(JOINTS)
    low, high = each.layout_id_words
    arguments = f"udiLayoutLo := 16#{low:08X}, udiLayoutHi := 16#{high:08X}, udiRecordSize := {each.size}"
    for kind in ("Read", "Write"):
        pou, _ = block(each, kind=kind)
        assert arguments in pou.implementation
        assert each.layout_id in pou.comment


def test_blocks_extend_the_base_and_take_its_arguments():
    """Neither declares an FB_Init of its own: the base's takes the topic."""
    for kind, base in (("Read", "RosPlc_Reader"), ("Write", "RosPlc_Writer")):
        pou, _ = block(layout(JOINTS), kind=kind)
        assert pou.extends == base
        assert not [method for method in pou.methods if method.name.upper() in ("FB_INIT", "FB_EXIT")]


@pytest.mark.parametrize("kind", ["Read", "Write"])
def test_pins_show_each_top_level_field(kind):
    """A pin per field with the field's type, and each is copied from or to its member."""
    pou, builder = block(layout(JOINTS), kind=kind, pins=True)
    dut = named(tuple(builder.duts), "sensor_msgs_JointState")
    fields = {m.name: m.type for m in dut.members if not m.name.startswith("abPad")}
    pins = {v.name: v.type for b in pou.blocks for v in b.variables if v.name.startswith("pin_")}
    assert pins == {f"pin_{name}": type_ for name, type_ in fields.items()}
    for name in fields:
        copied = f"pin_{name} := msg.{name};" if kind == "Read" else f"msg.{name} := pin_{name};"
        assert copied in pou.implementation


def test_pins_of_fields_with_leading_underscores(tmp_path):
    """``_type`` gives ``pin_type``, also where a field ``pin_type`` exists."""
    store = custom(tmp_path, Pins="uint8 type\nuint8 pin_type\nuint8 x\n")
    pou, _ = block(layout("cell_msgs/msg/Pins", store=store), store, pins=True)
    pins = [v.name for b in pou.blocks for v in b.variables if v.name.startswith("pin_")]
    assert pins == ["pin_type", "pin_pin_type", "pin_x"]


@pytest.mark.parametrize("kind", ["Read", "Write"])
@pytest.mark.parametrize("pins", [False, True])
def test_a_block_declares_nothing_that_its_base_has(kind, pins):
    """A second declaration of a base's name is an error in CODESYS, private ones included."""
    bases = {item.name: item for item in base_objects("ROS/Base")}
    taken = set()
    pou, _ = block(layout(JOINTS), kind=kind, pins=pins)
    base = bases[pou.extends]
    while base is not None:
        taken |= {v.name.upper() for b in base.blocks for v in b.variables}
        taken |= {m.name.upper() for m in base.methods if m.access != "PROTECTED"}
        base = bases.get(base.extends or "")
    own = [v.name for b in pou.blocks for v in b.variables] + [m.name for m in pou.methods]
    assert len({name.upper() for name in own}) == len(own)
    assert not {name.upper() for name in own} & taken
    assert not [name for name in own if is_reserved(name)]


def test_a_derived_base_declares_nothing_twice():
    """Nor does a hand-written block; only methods that are meant to be overridden recur."""
    bases = {item.name: item for item in (*base_objects("Base"), *classic_objects("Base"))}
    for derived in bases.values():
        base = bases.get(getattr(derived, "extends", None))
        own = {v.name.upper() for b in getattr(derived, "blocks", ()) for v in b.variables}
        while base is not None:
            assert not own & {v.name.upper() for b in base.blocks for v in b.variables}
            again = {m.name for m in derived.methods} & {m.name for m in base.methods}
            assert again <= {"Leave", "Reset"}, derived.name
            assert all(m.access == "PROTECTED" for m in (*derived.methods, *base.methods) if m.name in again)
            base = bases.get(base.extends)
