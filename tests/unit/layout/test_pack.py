"""Values to records and back."""

from __future__ import annotations

import array
import math
import struct
from collections.abc import Mapping
from types import MappingProxyType, SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_typestore

from rosplc.errors import LayoutError
from rosplc.layout import Layout, Limits, RecordView, compute_layout
from rosplc.layout.nodes import ArrayNode, Node, PaddingNode, ScalarNode, SequenceNode, StringNode, StructNode
from rosplc.model import TypeStore
from rosplc.model.parse import INTEGER_RANGES

JAZZY = TypeStore.bundled("jazzy")
POSES = compute_layout(JAZZY, "geometry_msgs/PoseArray", Limits(sequence=3, string=8))


def layout_of(text: str, **limits: Any) -> Layout:
    return compute_layout(TypeStore.from_definition("t/T", text), "t/T", Limits(**limits))


def values(node: Node) -> st.SearchStrategy[Any]:
    """Any value that fits a node."""
    if isinstance(node, StructNode):
        fields = {m.name: values(m.node) for m in node.members if m.name and m.count_of is None}
        return st.fixed_dictionaries(fields)
    if isinstance(node, ArrayNode):
        return st.lists(values(node.element), min_size=node.capacity, max_size=node.capacity)
    if isinstance(node, SequenceNode):
        return st.lists(values(node.element), max_size=node.capacity)
    if isinstance(node, StringNode):
        text = st.text(st.characters(blacklist_characters="\0", blacklist_categories=("Cs",)))
        return text.map(lambda t: t.encode()[: node.capacity].decode("utf-8", "surrogateescape"))
    assert isinstance(node, ScalarNode)
    if node.kind == "bool":
        return st.booleans()
    if node.kind.startswith("float"):
        return st.floats(width=int(node.kind[5:]), allow_nan=False)  # type: ignore[arg-type]
    return st.integers(*INTEGER_RANGES[node.kind])


NAMES = [name for name in JAZZY.names() if "visualization" not in name]


@settings(max_examples=150, deadline=None)
@given(st.data())
def test_whatever_fits_comes_back(data: st.DataObject) -> None:
    """Every value of every type survives packing, as mapping, view and object."""
    layout = compute_layout(JAZZY, data.draw(st.sampled_from(NAMES)), Limits(string=7, sequence=2))
    value = data.draw(values(layout.root))
    record = layout.pack(value)
    assert len(record) == layout.size
    assert layout.to_dict(record) == value
    view = layout.view(record)
    assert layout.pack(view) == record
    assert view == layout.view(bytes(record))
    assert layout.pack(as_object(value)) == record
    assert not any(unused_bytes(layout.root, memoryview(record)))


def as_object(value: Any) -> Any:
    if isinstance(value, dict):
        return SimpleNamespace(**{name: as_object(item) for name, item in value.items()})
    return [as_object(item) for item in value] if isinstance(value, list) else value


def unused_bytes(node: StructNode, data: memoryview) -> bytes:
    """The bytes of padding and of elements after the count."""
    found = b""
    for member in node.members:
        part = data[member.offset : member.offset + member.node.size]
        if isinstance(member.node, PaddingNode):
            found += part
        elif isinstance(member.node, StructNode):
            found += unused_bytes(member.node, part)
        elif isinstance(member.node, SequenceNode):
            offset = next(m.offset for m in node.members if m.count_of == member.name)
            used = struct.unpack_from("<I", data, offset)[0]
            found += part[used * member.node.stride :]
    return found


@pytest.mark.parametrize(
    ("value", "where", "what"),
    [
        ({"poses": [{}, {"position": {"x": "1"}}]}, "poses[1].position.x", "not a valid float64"),
        ({"poses": [{"position": {"x": None}}]}, "poses[0].position.x", "not a valid float64"),
        ({"poses": [5]}, "poses[0]", "not a valid geometry_msgs/msg/Pose"),
        ({"poses": [{}] * 4}, "poses", "4 elements, but the limit is 3"),
        ({"poses": {}}, "poses", "not a valid sequence"),
        ({"poses": "abc"}, "poses", "not a valid sequence"),
        ({"poses": None}, "poses", "not a valid sequence"),
        ({"pose": []}, "geometry_msgs/msg/PoseArray", "no field 'pose'"),
        ({5: 1}, "geometry_msgs/msg/PoseArray", "no field 5"),
        ({"header": {"frame_id": "ninechars"}}, "header.frame_id", "9 bytes, but its limit is 8"),
        ({"header": {"frame_id": "äöüäö"}}, "header.frame_id", "10 bytes"),
        ({"header": {"frame_id": "a\0b"}}, "header.frame_id", "NUL"),
        ({"header": {"frame_id": "\ud800"}}, "header.frame_id", "Unicode"),
        ({"header": {"frame_id": 5}}, "header.frame_id", "not a valid string"),
        ({"header": {"stamp": {"sec": 2**31}}}, "header.stamp.sec", "not a valid int32"),
        ({"header": {"stamp": {"sec": 1.0}}}, "header.stamp.sec", "not a valid int32"),
        ({"header": {"stamp": {"nanosec": -1}}}, "header.stamp.nanosec", "not a valid uint32"),
        ({"header": {"stamp": {"sec": 1.0, "nanosec": 0}}}, "header.stamp.sec", "not a valid int32"),
        ({"header": {"stamp": {"sec": 1, "nanosec": "0"}}}, "header.stamp.nanosec", "not a valid uint32"),
        ({"header": {"stamp": {"sec": 1, "nano": 0}}}, "header.stamp", "no field 'nano'"),
        ({"header": None}, "header", "not a valid std_msgs/msg/Header"),
        (None, "geometry_msgs/msg/PoseArray", "not a valid geometry_msgs/msg/PoseArray"),
        ([], "geometry_msgs/msg/PoseArray", "not a valid geometry_msgs/msg/PoseArray"),
    ],
)
def test_misfits_name_their_path(value: Any, where: str, what: str) -> None:
    """A value that does not fit is refused with the path of its field."""
    with pytest.raises(LayoutError) as caught:
        POSES.pack(value)
    assert (caught.value.code, caught.value.where) == ("LAY006", where)
    assert what in caught.value.what


@pytest.mark.parametrize(
    ("field", "good", "bad"),
    [
        ("bool x", [True, False, 0, 1, np.True_, np.int8(1)], [2, -1, "true", 0.0, None]),
        ("int8 x", [-128, 127, np.int64(5)], [-129, 128, 1.0, "1", None]),
        ("uint8 x", [0, 255], [-1, 256, b"\1"]),
        ("byte x", [0, 255, b"\xff", -128], [256, -129, b"ab"]),
        ("char x", [0, 255], [256, "a"]),
        ("uint64 x", [0, 2**64 - 1], [-1, 2**64]),
        ("int64 x", [-(2**63), 2**63 - 1], [2**63, -(2**63) - 1]),
        ("float32 x", [1, 1.5, math.inf, np.float32(2)], [1e39, "1", b"1", None, [1.0]]),
        ("float64 x", [1, 1e308, -math.inf, np.float64(2)], [10**400, "1.0", {}]),
        ("string x", ["", "a", b"b", "\udcff"], [1, None, b"\0", ["a"]]),
        ("int16[2] x", [[1, 2], (1, 2), np.array([1, 2]), range(2)], [[1], [1, 2, 3], [1, 70000], "ab", 5]),
        ("int16[] x", [[], [1], np.array([], "i2")], [[1.5], [None], 5, {"a": 1}, "a"]),
        ("bool[2] x", [[True, 0], np.array([True, False])], [[2, 0], ["a", "b"]]),
        ("float32[] x", [[1, 2.5], np.array([1.0])], [[1e39], ["1"], [None]]),
        ("string[] x", [["a", b"b"], np.array(["a", "b"])], [[1], "ab", [["a"]]]),
        ("byte[] x", [b"\0\xff", [b"\1", b"\2"], [-1, 255], bytearray(b"ab")], [[256], "ab"]),
    ],
)
def test_each_type_takes_what_it_can_hold(field: str, good: list[Any], bad: list[Any]) -> None:
    """Values in range are taken in every usual form, all others are refused with LAY006."""
    layout = layout_of(f"{field}\n")
    for value in good:
        layout.pack({"x": value})
    for value in bad:
        with pytest.raises(LayoutError) as caught:
            layout.pack({"x": value})
        assert caught.value.code == "LAY006"
        assert caught.value.where.split("[")[0] == "x"


BULK = {
    "bool": "?", "byte": "u1", "char": "u1", "uint8": "u1", "int8": "i1", "uint16": "u2", "int16": "i2",
    "uint32": "u4", "int32": "i4", "uint64": "u8", "int64": "i8", "float32": "f4", "float64": "f8",
}  # fmt: skip


@pytest.mark.parametrize(("kind", "dtype"), BULK.items())
def test_numbers_in_bulk_are_the_same_as_one_by_one(kind: str, dtype: str) -> None:
    """Arrays in memory, of either byte order or with a step, give what lists give."""
    layout = layout_of(f"{kind}[] x\n{kind}[4] y\n")
    plain = np.array([0, 1, 1, 0] if kind == "bool" else [0, 1, 100, 127], dtype)
    record = layout.pack({"x": plain.tolist(), "y": plain.tolist()})
    forms = [plain, plain.astype(plain.dtype.newbyteorder(">")), np.repeat(plain, 2)[::2], memoryview(plain)]
    if kind == "bool":  # of a mask, whose bytes are no truth values
        forms += [np.array([0, 255, 2, 0], "u1").view("?"), memoryview(b"\0\x80\1\0").cast("?")]
    else:
        forms.append(array.array({"u1": "B"}.get(dtype, plain.dtype.char), plain.tolist()))
        forms.append(plain.astype("i8") if plain.dtype.kind in "iu" else plain.astype("f8"))
    for form in forms:
        assert layout.pack({"x": form, "y": form}) == record


def test_integers_given_as_reals_in_bulk_are_refused() -> None:
    """An array of reals is not cut to integers, and the first misfit is named."""
    with pytest.raises(LayoutError) as caught:
        layout_of("int32[] x\n").pack({"x": np.array([1.0, 2.0])})
    assert caught.value.where == "x[0]"
    with pytest.raises(LayoutError) as caught:
        layout_of("uint8[] x\n").pack({"x": [1, 2, 256, 300]})
    assert caught.value.where == "x[2]"


def test_two_dimensions_do_not_fit_one() -> None:
    """A matrix is refused for a sequence of numbers instead of being flattened silently."""
    with pytest.raises(LayoutError):
        layout_of("float64[] x\n").pack({"x": np.zeros((2, 2))})


def test_missing_fields_take_initial_values() -> None:
    """What a value lacks has its default, at every level and in every element."""
    record = POSES.view(POSES.pack({"poses": [{}, {"orientation": {"z": 1.0}}]}))
    assert [pose.orientation.w for pose in record.poses] == [1.0, 1.0]
    assert record.poses[1].orientation.z == 1.0
    layout = layout_of("string s 'default'\nint8[] n [1, 2, 3]\n")
    assert layout.to_dict(layout.pack({})) == {"s": "default", "n": [1, 2, 3]}
    shorter = layout.pack({"s": "x", "n": [9]})
    assert layout.to_dict(shorter) == {"s": "x", "n": [9]}
    start = next(offset for path, offset, _ in layout.fields() if path == "n")
    assert shorter[start : start + 4] == b"\x09\0\0\0"


def test_any_mapping_will_do() -> None:
    """Read-only and user-defined mappings are mappings too."""

    class Lazy(Mapping[str, Any]):
        def __getitem__(self, key: str) -> Any:
            return {"x": 1.5}[key]

        def __iter__(self) -> Any:
            return iter(["x"])

        def __len__(self) -> int:
            return 1

    layout = compute_layout(JAZZY, "geometry_msgs/Point")
    for value in (Lazy(), MappingProxyType({"x": 1.5}), SimpleNamespace(x=1.5, other=2)):
        assert layout.to_dict(layout.pack(value)) == {"x": 1.5, "y": 0.0, "z": 0.0}


def test_rosbags_messages_are_taken() -> None:
    """Messages of rosbags, with numpy arrays inside, pack like their values."""
    types = get_typestore(Stores.ROS2_JAZZY).types
    stamp = types["builtin_interfaces/msg/Time"](sec=1, nanosec=2)
    message = types["sensor_msgs/msg/JointState"](
        header=types["std_msgs/msg/Header"](stamp=stamp, frame_id="base"),
        name=["a", "b"],
        position=np.array([1.0, 2.0]),
        velocity=np.array([], np.float64),
        effort=np.array([0.5]),
    )
    layout = compute_layout(JAZZY, "sensor_msgs/JointState")
    assert layout.to_dict(layout.pack(message)) == {
        "header": {"stamp": {"sec": 1, "nanosec": 2}, "frame_id": "base"},
        "name": ["a", "b"],
        "position": [1.0, 2.0],
        "velocity": [],
        "effort": [0.5],
    }


def test_times_of_genpy_are_taken() -> None:
    """ROS 1's own time classes name their words differently; the bits are kept."""
    layout = compute_layout(TypeStore.bundled("noetic"), "std_msgs/Header")
    stamp = SimpleNamespace(secs=0x80000001, nsecs=5)
    assert layout.view(layout.pack({"stamp": stamp})).stamp.sec == -0x7FFFFFFF
    span = compute_layout(TypeStore.bundled("noetic"), "std_msgs/Duration")
    assert span.view(span.pack({"data": SimpleNamespace(secs=-1, nsecs=-5)})).data.nanosec == 2**32 - 5


def test_pack_into_is_all_or_nothing() -> None:
    """A buffer changes only if everything fits, and then is written whole, its gaps included."""
    layout = layout_of("int8 a\nfloat64 b\nint8[] c\n")
    buffer = bytearray(b"\xaa" * (layout.size + 3))
    with pytest.raises(LayoutError):
        layout.pack_into({"a": 1, "b": "x"}, buffer)
    assert buffer == b"\xaa" * len(buffer)
    layout.pack_into({"a": 1}, buffer)
    assert buffer[: layout.size] == layout.pack({"a": 1})
    assert buffer[layout.size :] == b"\xaa" * 3
    with pytest.raises(LayoutError, match="LAY006"):
        layout.pack_into({}, bytearray(layout.size - 1))
    words = array.array("d", bytes(layout.size))
    layout.pack_into({"b": 2.5}, memoryview(words))
    assert words.tobytes() == layout.pack({"b": 2.5})


def test_keywords_of_python_are_fields_like_others() -> None:
    """A field named like a keyword is read and written with an underscore, or by its name."""
    layout = layout_of("int8 from\nint8 import\n")
    record = layout.pack(SimpleNamespace(from_=1, **{"import": 2}))
    view = layout.view(record)
    assert (view.from_, getattr(view, "import"), layout.to_dict(record)) == (1, 2, {"from": 1, "import": 2})
    assert layout.pack(view) == record


SCRAPS = st.recursive(
    st.one_of(
        st.none(), st.booleans(), st.integers(), st.floats(), st.text(max_size=9), st.binary(max_size=9)
    ),
    lambda inner: st.one_of(
        st.lists(inner, max_size=4),
        st.dictionaries(st.sampled_from(["header", "poses", "stamp", "x", "position", "sec"]), inner),
    ),
    max_leaves=8,
)


@settings(max_examples=200, deadline=None)
@given(SCRAPS)
def test_nonsense_is_refused_with_a_code(value: Any) -> None:
    """Whatever is packed, the result is a record or LAY006, never another exception."""
    for layout in (POSES, compute_layout(JAZZY, "std_msgs/ByteMultiArray")):
        try:
            record = layout.pack(value)
        except LayoutError as error:
            assert error.code == "LAY006"
        else:
            assert isinstance(layout.view(record), RecordView)
