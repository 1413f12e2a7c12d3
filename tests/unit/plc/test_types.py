"""DUTs: the members of each equal the layout's, byte by byte, whatever the names are."""

from __future__ import annotations

import re

import pytest

from rosplc.errors import LayoutError
from rosplc.layout import Limits
from rosplc.model import DISTROS, TypeStore
from rosplc.plc.build import build_type_library
from rosplc.plc.delivery import project_files
from rosplc.plc.names import is_reserved
from rosplc.plc.types import DutBuilder
from tests.unit.plc.projects import JOINTS, STORE, custom, layout, members, named, project, read

pytestmark = pytest.mark.verifies("names", own="rosplc alone")

SIZES = {
    "BOOL": 1, "BYTE": 1, "USINT": 1, "SINT": 1, "UINT": 2, "INT": 2, "UDINT": 4, "DINT": 4, "REAL": 4,
    "ULINT": 8, "LINT": 8, "LREAL": 8,
}  # fmt: skip


def packed(duts, type_text):
    """Return (size, alignment) of a type that is written as Structured Text, packed without any padding."""
    if match := re.fullmatch(r"ARRAY\[0\.\.(\d+)\] OF (.+)", type_text):
        size, align = packed(duts, match[2])
        return (int(match[1]) + 1) * size, align
    if match := re.fullmatch(r"STRING\((\d+)\)", type_text):
        return int(match[1]) + 1, 1
    if type_text in SIZES:
        return SIZES[type_text], SIZES[type_text]
    offset, largest = 0, 1
    for member in duts[type_text].members:
        size, align = packed(duts, member.type)
        assert offset % align == 0, f"{type_text}.{member.name} is not where every compiler puts it"
        offset += size
        largest = max(largest, align)
    assert offset % largest == 0, f"{type_text} has a tail that is not written down"
    return offset, largest


@pytest.mark.parametrize("distro", DISTROS)
def test_every_type_of_a_distribution_is_the_layout_without_hidden_padding(distro):
    """Packed or aligned, each DUT has the layout's size: no compiler adds a byte of its own."""
    store = TypeStore.bundled(distro)
    builder = DutBuilder(store)
    layouts = [layout(name, store=store) for name in store.names()]
    names = [builder.add(each) for each in layouts]
    duts = {dut.name: dut for dut in builder.duts}
    assert len(duts) == len(builder.duts) == len(layouts)
    for name, each in zip(names, layouts, strict=True):
        assert packed(duts, name) == (each.size, each.align), name


@pytest.mark.parametrize("distro", DISTROS)
def test_names_of_every_bundled_type_are_apart_and_no_keywords(distro):
    """No two objects of a project share a name, nor two members of a DUT, and none is a keyword."""
    store = TypeStore.bundled(distro)
    made = build_type_library(store, [layout(name, store=store) for name in store.names()])
    objects = [item.name for item in (*made.duts, *made.gvls, *made.pous)]
    assert len({name.upper() for name in objects}) == len(objects)
    scopes = [objects, *([member.name for member in getattr(dut, "members", ())] for dut in made.duts)]
    scopes += [[v.name for block in gvl.blocks for v in block.variables] for gvl in made.gvls]
    for scope in scopes:
        assert len({name.upper() for name in scope}) == len(scope), scope
        assert not [name for name in scope if is_reserved(name) or "__" in name or name.endswith("_")]


def test_padding_is_a_member():
    """A gap before a wide member, and the tail, are arrays of bytes."""
    builder = DutBuilder(STORE)
    builder.add(layout(JOINTS))
    header = named(tuple(builder.duts), "std_msgs_Header")
    assert list(members(header).items())[-1] == ("abPad89", "ARRAY[0..2] OF BYTE")


def test_a_sequence_is_a_count_and_an_array():
    """The capacity is the array's length, and the count stands before it."""
    builder = DutBuilder(STORE)
    builder.add(layout(JOINTS, Limits(fields={"name": 6, "name[]": 20})))
    dut = members(named(tuple(builder.duts), "sensor_msgs_JointState"))
    assert dut["name_count"] == "UDINT"
    assert dut["name"] == "ARRAY[0..5] OF STRING(20)"
    assert dut["position"] == "ARRAY[0..15] OF LREAL"


def test_a_message_without_fields_has_its_one_byte():
    """A struct must have a member; the layout's byte of padding is it."""
    builder = DutBuilder(STORE)
    builder.add(layout("std_msgs/msg/Empty"))
    assert members(builder.duts[0]) == {"abPad0": "ARRAY[0..0] OF BYTE"}


def test_default_values_of_a_definition_are_initial_values(tmp_path):
    """A variable of the DUT starts as a message in ROS does, a sequence with its count."""
    store = custom(
        tmp_path,
        Defaults="""
int64 small -9223372036854775808
uint64 large 18446744073709551615
float32 share 0.25
bool on true
string text "it's 5 $"
int32[3] fixed [1, -2, 3]
int32[] many [7, 8]
string[<=3] names ["a", "b,c"]
float64 endless inf
""",
    )
    builder = DutBuilder(store)
    builder.add(layout("cell_msgs/msg/Defaults", store=store))
    initial = {member.name: member.initial for member in builder.duts[0].members}
    assert initial["small"] == "-9223372036854775807 - 1"
    assert initial["large"] == "ULINT#18446744073709551615"
    assert initial["share"] == "0.25"
    assert initial["_on"] == "TRUE"
    assert initial["text"] == "'it$'s 5 $$'"
    assert initial["fixed"] == "[1, -2, 3]"
    assert (initial["many_count"], initial["many"]) == ("2", "[7, 8, 14(0)]")
    assert (initial["names_count"], initial["names"]) == ("2", "['a', 'b,c', 1('')]")
    assert initial["endless"] is None
    assert any("endless" in note and "inf" in note for note in builder.omitted)


@pytest.mark.parametrize(
    ("text", "limits"),
    [('string text "0123456789"\n', Limits(string=4)), ("int8[] many [1, 2, 3]\n", Limits(sequence=2))],
)
def test_a_default_value_larger_than_its_capacity_is_refused(tmp_path, text, limits):
    """No DUT comes about whose initial value would not fit."""
    store = custom(tmp_path, Long=text)
    with pytest.raises(LayoutError, match="LAY006"):
        layout("cell_msgs/msg/Long", limits, store=store)


def test_constants_become_a_qualified_list():
    """Constants keep type and value; keywords among them are renamed and on record."""
    builder = DutBuilder(STORE)
    builder.add(layout("visualization_msgs/msg/Marker"))
    gvl = next(gvl for gvl in builder.constants if gvl.name == "visualization_msgs_Marker_Const")
    assert gvl.attributes == (("qualified_only", ""),)
    values = {v.name: (v.type, v.initial) for v in gvl.blocks[0].variables}
    assert gvl.blocks[0].constant
    assert values["POINTS"] == ("DINT", "8")
    assert values["_ADD"] == ("DINT", "0")
    assert f"{gvl.name}: ADD was renamed to _ADD" in builder.renamings


def test_a_constant_and_a_field_may_differ_by_case_only():
    """Marker has the constant POINTS and the field points: they live in scopes of their own."""
    builder = DutBuilder(STORE)
    builder.add(layout("visualization_msgs/msg/Marker"))
    marker = members(named(tuple(builder.duts), "visualization_msgs_Marker"))
    assert {"points", "points_count", "mesh_resource", "_type", "_action"} <= set(marker)


def test_text_constants_have_room_for_their_bytes(tmp_path):
    """The length counts bytes of UTF-8, not characters; an empty one has room for one."""
    store = custom(tmp_path, Words='string NAME="grün"\nstring NONE=""\nfloat32 HUGE=inf\nuint8 x\n')
    builder = DutBuilder(store)
    builder.add(layout("cell_msgs/msg/Words", store=store))
    values = {v.name: (v.type, v.initial) for v in builder.constants[0].blocks[0].variables}
    assert values == {"NAME": ("STRING(5)", "'gr$C3$BCn'"), "NONE": ("STRING(1)", "''")}
    assert any("HUGE" in note for note in builder.omitted)


def test_one_type_with_two_limits_gets_two_duts_with_stable_names():
    """The second variant's suffix follows from its layout alone, whatever else is in the project."""
    large = Limits(sequence=32)
    both = project(read("/a", JOINTS), read("/b", JOINTS, limits=large))
    names = [dut.name for dut in both.duts if dut.name.startswith("sensor_msgs_JointState")]
    assert len(names) == 2
    assert names[0] == "sensor_msgs_JointState"
    assert [dut.name for dut in both.duts].count("std_msgs_Header") == 1
    more = project(read("/a", JOINTS), read("/aa", JOINTS), read("/b", JOINTS, limits=large), read("/c"))
    assert names == [dut.name for dut in more.duts if dut.name.startswith("sensor_msgs_JointState")]
    assert any(names[1] in note for note in both.notes)


def test_a_duts_parts_come_before_it():
    """An importer that reads in order knows each type when it is used."""
    made = build_type_library(STORE, [layout(name) for name in STORE.names()])
    seen = set()
    for dut in made.duts[1:]:  # the enumeration of errors comes first
        for type_text in members(dut).values():
            element = type_text.rsplit(" ", 1)[-1]
            if element not in SIZES and not element.startswith("STRING("):
                assert element in seen, f"{dut.name} needs {element}"
        seen.add(dut.name)


def test_nesting_ten_deep_and_sequences_of_strings(tmp_path):
    """Depth and arrays of arrays by way of structs are no limit."""
    definitions = {"L0": "string[<=2] words\nint16 x\n"}
    definitions |= {f"L{n}": f"L{n - 1}[<=2] inner\nbool flag\n" for n in range(1, 11)}
    store = custom(tmp_path, **definitions)
    builder = DutBuilder(store)
    each = layout("cell_msgs/msg/L10", store=store)
    builder.add(each)
    duts = {dut.name: dut for dut in builder.duts}
    assert packed(duts, "cell_msgs_L10") == (each.size, each.align)
    assert members(duts["cell_msgs_L0"])["words"] == "ARRAY[0..1] OF STRING(80)"
    files = project_files(build_type_library(store, [each]), [each], "rosplc")
    assert "st/Types/cell_msgs_L10.st" in files


def test_fields_with_hostile_names(tmp_path):
    """Keywords, case clashes, names that collide after renaming, and with counts and padding."""
    fields = ["type", "action", "abpad1", "points", "points_count", "r", "end_if", "bool_to_int", "x" * 200]
    text = "".join(f"uint8 {name}\n" for name in fields[:3]) + "float64[<=2] data\nuint8 data_count\n"
    text += "".join(f"uint8 {name}\n" for name in fields[3:])
    store = custom(tmp_path, Hostile=text)
    builder = DutBuilder(store)
    each = layout("cell_msgs/msg/Hostile", store=store)
    builder.add(each)
    names = [member.name for member in builder.duts[0].members]
    assert len({name.upper() for name in names}) == len(names) == len(each.root.members)
    assert not [name for name in names if is_reserved(name)]
    assert packed({builder.duts[0].name: builder.duts[0]}, builder.duts[0].name)[0] == each.size
    renamed = {text.removeprefix(f"{builder.duts[0].name}: ") for text in builder.renamings}
    assert {f"{name} was renamed to _{name}" for name in ("type", "end_if", "bool_to_int")} <= renamed
    assert "data_count" in names and "data_count was renamed to data_count_2" in renamed
