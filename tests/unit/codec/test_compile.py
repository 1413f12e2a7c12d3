"""What a layout compiles to."""

from __future__ import annotations

import pytest

from rosplc._core import Plan
from rosplc.codec import Wire, compile_plan
from rosplc.codec.compile import MAX_LOOPS, Op, OpCode
from rosplc.errors import MessageTypeError
from rosplc.layout import Limits, compute_layout
from rosplc.layout.nodes import Member, PaddingNode, ScalarNode, SequenceNode, StructNode
from tests.codec_types import hard_store

STORE = hard_store("jazzy")


def ops_of(name: str, wire: Wire, *, swapped: bool = False) -> list[Op]:
    plan = compile_plan(compute_layout(STORE, name, Limits(7, 2)).root, wire)
    return list(plan.ops[plan.native_count :] if swapped else plan.ops[: plan.native_count])


def shape(ops: list[Op]) -> list[tuple[str, str, int, int]]:
    return [(op.code.name, op.path, op.at, op.n) for op in ops]


def test_neighbouring_numbers_become_one_copy() -> None:
    """An Imu is three ops: its stamp, its frame, and all 37 doubles in one piece."""
    assert shape(ops_of("sensor_msgs/Imu", Wire.CDR)) == [
        ("COPY", "header.stamp.sec", 0, 8),
        ("STRING", "header.frame_id", 8, 7),
        ("COPY", "orientation.x", 16, 296),
    ]


def test_big_endian_input_is_swapped_by_width() -> None:
    """The list for big-endian input counts numbers, not bytes."""
    assert shape(ops_of("sensor_msgs/Imu", Wire.CDR, swapped=True)) == [
        ("SWAP", "header.stamp.sec", 0, 2),
        ("STRING", "header.frame_id", 8, 7),
        ("SWAP", "orientation.x", 16, 37),
    ]


def test_a_gap_ends_a_copy() -> None:
    """Padding in the record is zeroed and never copied, for its wire bytes may be anything."""
    assert shape(ops_of("hard_msgs/Wide", Wire.CDR))[:5] == [
        ("COPY", "a", 0, 1),
        ("ZERO", "", 1, 7),
        ("COPY", "b", 8, 9),
        ("ZERO", "", 17, 3),
        ("COPY", "d", 20, 6),
    ]


def test_bools_are_checked_after_the_copy_they_are_part_of() -> None:
    """A copy holds bools too; each bool field then has its bytes looked at, counted from the copy's end."""
    ops = ops_of("hard_msgs/Switch", Wire.CDR)
    assert [(op.code.name, op.path, op.n, op.body) for op in ops] == [
        ("COPY", "on", 5, 0),
        ("BOOLS", "on", 1, 5),
        ("BOOLS", "off", 1, 4),
        ("BOOLS", "last", 1, 1),
        ("ZERO", "", 1, 0),
    ]


def test_rows_of_flat_structs_are_one_piece() -> None:
    """Points are copied as a whole, Pairs are not: CDR has no padding behind a Pair's last byte."""
    points = ops_of("geometry_msgs/Polygon", Wire.CDR)
    assert [(op.code, op.stride, op.align) for op in points] == [(OpCode.SEQ, 12, 4)]
    pairs = ops_of("hard_msgs/Pairs", Wire.CDR)
    assert [op.code for op in pairs[:4]] == [OpCode.ZERO, OpCode.LOOP, OpCode.COPY, OpCode.ZERO]


def test_alignment_decides_whether_rows_are_one_piece() -> None:
    """A struct that starts with a narrow number is one piece only where its wide one is surely aligned."""
    by_path = {op.path: op.code for op in reversed(ops_of("hard_msgs/ShiftedMany", Wire.CDR))}
    assert by_path["sequence"] is OpCode.LOOP  # 4 bytes of count may stand before it, or 8
    assert by_path["array"] is OpCode.ARRAY  # behind a sequence nothing is known
    ros1 = ops_of("hard_msgs/ShiftedMany", Wire.ROS1)
    assert [op.code for op in ros1] == [OpCode.COPY, OpCode.ZERO, OpCode.SEQ, OpCode.COPY]


def test_an_empty_message_has_a_byte_in_cdr_only() -> None:
    """The dummy byte of ROS 2 is passed over; ROS 1 sends nothing; the record's byte is zero."""
    root = compute_layout(STORE, "std_msgs/Empty").root
    assert [op.code for op in compile_plan(root, Wire.CDR).ops] == [OpCode.SKIP, OpCode.ZERO] * 2
    assert [op.code for op in compile_plan(root, Wire.ROS1).ops] == [OpCode.ZERO]


def test_paths_name_fields_and_elements() -> None:
    """A fault's op leads to the field's path as limits use it."""
    paths = {op.path for op in compile_plan(compute_layout(STORE, "hard_msgs/Tree").root, Wire.CDR).ops}
    assert {
        "id",
        "branches",
        "branches[].leaves[].name",
        "branches[].marks",
        "pair[].leaves",
        "words[]",
    } <= paths


def nested(depth: int) -> StructNode:
    node = StructNode("test_msgs/msg/Leaf", (Member("x", 0, ScalarNode("uint8", 1)),), 1, 1)
    for _ in range(depth):
        size = 4 + node.size + -node.size % 4
        members = [Member("s", 0, ScalarNode("uint32", 4), "s"), Member("s", 4, SequenceNode(node, 1))]
        if gap := size - 4 - node.size:
            members.append(Member("", 4 + node.size, PaddingNode(gap)))
        node = StructNode("test_msgs/msg/Level", tuple(members), size, 4)
    return node


def test_nesting_has_a_limit() -> None:
    """Sequences in sequences are compiled as deep as the executor goes, and refused beyond."""
    # The innermost sequence holds flat structs, which need no loop.
    Plan(compile_plan(nested(MAX_LOOPS + 1), Wire.CDR).blob)
    with pytest.raises(MessageTypeError) as error:
        compile_plan(nested(MAX_LOOPS + 2), Wire.CDR)
    assert error.value.code == "TYP007"
