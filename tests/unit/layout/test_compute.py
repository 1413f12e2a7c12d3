"""Limits and the computation of layouts."""

from __future__ import annotations

import pytest

from rosplc.errors import LayoutError, MessageTypeError
from rosplc.layout import Limits, compute_layout
from rosplc.layout.nodes import MAX_ITEMS, ScalarNode, SequenceNode, StringNode, StructNode
from rosplc.model import TypeStore

JAZZY = TypeStore.bundled("jazzy")
SEPARATOR = "=" * 80 + "\n"


def store_of(text: str, **others: str) -> TypeStore:
    """A store with type t/T of this text and further types of package t."""
    parts = [f"{SEPARATOR}MSG: t/{name}\n{body}" for name, body in others.items()]
    return TypeStore.from_definition("t/T", text + "".join(parts))


def capacities(text: str, limits: Limits) -> dict[str, int]:
    layout = compute_layout(store_of(text), "t/T", limits)
    return {p: n.capacity for p, _, n in layout.fields() if isinstance(n, SequenceNode | StringNode)}


def test_a_capacity_is_the_limit_else_the_bound_else_the_default() -> None:
    """A field's own limit wins; a bound caps the default but is not raised to it."""
    text = "string a\nstring<=5 b\nstring<=200 c\nint8[] d\nint8[<=3] e\nint8[<=99] f\nstring<=9 g\n"
    limits = Limits(string=20, sequence=10, fields={"a": 30, "g": 4, "f": 50})
    expected = {"a": 30, "b": 5, "c": 20, "d": 10, "e": 3, "f": 50, "g": 4}
    assert capacities(text + "\n", limits) == expected


def test_defaults_are_80_bytes_and_16_elements() -> None:
    """Without any limit a string has 80 bytes and a sequence 16 elements."""
    assert capacities("string a\nint8[] b\nstring[] c\n", Limits()) == {
        "a": 80,
        "b": 16,
        "c": 16,
        "c[]": 80,
    }


@pytest.mark.parametrize(
    "arguments",
    [
        {"string": 0},
        {"string": 65535},
        {"string": "80"},
        {"string": True},
        {"sequence": 0},
        {"sequence": -1},
        {"sequence": (1 << 24) + 1},
        {"sequence": 1.5},
        {"fields": {"a": 0}},
        {"fields": {"a": None}},
    ],
)
def test_capacities_have_a_range(arguments: dict[str, object]) -> None:
    """A capacity that is not a whole number or out of range is refused."""
    with pytest.raises(LayoutError) as caught:
        Limits(**arguments)  # type: ignore[arg-type]
    assert caught.value.code == "LAY001"


def test_a_string_has_its_own_range() -> None:
    """A limit that a sequence may have is still too large for a string."""
    with pytest.raises(LayoutError) as caught:
        compute_layout(JAZZY, "std_msgs/String", Limits(fields={"data": 65535}))
    assert (caught.value.code, caught.value.where) == ("LAY001", "data")


@pytest.mark.parametrize(
    ("path", "hint"),
    [
        ("nmae", "name"),
        ("header", None),
        ("header.frame", "header.frame_id"),
        ("header.stamp.sec", None),
        ("name[][]", "name[]"),
        ("position[]", "position"),
        ("name.x", None),
        ("", None),
        ("header..frame_id", "header.frame_id"),
        ("header[].frame_id", "header.frame_id"),
        ("name ", "name"),
    ],
)
def test_limits_for_nothing_are_refused(path: str, hint: str | None) -> None:
    """A path that names no string or sequence is refused, with the nearest one that does."""
    with pytest.raises(LayoutError) as caught:
        compute_layout(JAZZY, "sensor_msgs/JointState", Limits(fields={path: 5}))
    assert caught.value.code == "LAY002"
    assert caught.value.where == path
    if hint:
        assert f"did you mean {hint}?" in caught.value.what


def test_an_array_takes_no_limit() -> None:
    """An array's length is the definition's; only what is inside can have a limit."""
    store = store_of("string[3] a\n")
    with pytest.raises(LayoutError, match=r"a\[\]"):
        compute_layout(store, "t/T", Limits(fields={"a": 2}))
    assert compute_layout(store, "t/T", Limits(fields={"a[]": 2})).size == 9


def test_a_limit_above_the_bound_is_refused() -> None:
    """The definition's own bound cannot be exceeded."""
    store = store_of("string<=5 a\nint8[<=3] b\nstring<=5[] c\n")
    for path in ("a", "b", "c[]"):
        with pytest.raises(LayoutError) as caught:
            compute_layout(store, "t/T", Limits(fields={path: 6}))
        assert (caught.value.code, caught.value.where) == ("LAY004", path)


def test_a_default_value_needs_its_room() -> None:
    """A limit below the definition's default value is refused at once, not when packing."""
    for text, limits in (("string a 'hello'\n", Limits(string=4)), ("int8[] a [1, 2]\n", Limits(sequence=1))):
        with pytest.raises(LayoutError) as caught:
            compute_layout(store_of(text), "t/T", limits)
        assert (caught.value.code, caught.value.where) == ("LAY006", "a")


def test_records_have_a_size_limit() -> None:
    """A record of more than 2^30 bytes is refused, whatever it is made of."""
    half = store_of(f"uint8[{1 << 29}] a\nuint8[{1 << 29}] b\n")
    assert compute_layout(half, "t/T").size == 1 << 30
    for text in (
        f"uint8[{(1 << 30) + 1}] a\n",
        f"uint8[{1 << 30}] a\nint8 b\n",
        f"float64[{1 << 31}] a\n",
        f"S[{1 << 15}] a\n",
    ):
        with pytest.raises(LayoutError) as caught:
            compute_layout(store_of(text, S=f"uint8[{1 << 16}] x\n"), "t/T")
        assert caught.value.code == "LAY003"


@pytest.mark.parametrize("leaf", ["int8 x\n", "", "string[] s\n"])
def test_definitions_that_explode_are_refused(leaf: str) -> None:
    """A short definition that names billions of fields is refused without computing them."""
    others = {f"L{i}": f"L{i + 1} a\nL{i + 1} b\n" for i in range(1, 30)} | {"L30": leaf}
    store = store_of("L1 a\n", **others)
    with pytest.raises(LayoutError) as caught:
        compute_layout(store, "t/T", Limits(string=1, sequence=1))
    assert caught.value.code == "LAY003"
    with pytest.raises(LayoutError):
        compute_layout(store, "t/T", Limits(fields={"no.such.field": 5}))


def test_wide_records_have_an_item_limit() -> None:
    """The number of items is limited exactly as the specification says."""
    inner = "".join(f"int8 f{i}\n" for i in range(1 << 10))
    fits = "".join(f"S s{i}\n" for i in range(MAX_ITEMS >> 10))
    assert compute_layout(store_of(fits, S=inner), "t/T").size == MAX_ITEMS
    with pytest.raises(LayoutError, match="LAY003"):
        compute_layout(store_of(fits + "int8 more\n", S=inner), "t/T")


def test_one_type_with_other_limits_elsewhere() -> None:
    """Each use of a nested type has the limits of its own path."""
    layout = compute_layout(
        JAZZY, "geometry_msgs/TransformStamped", Limits(fields={"header.frame_id": 5, "child_frame_id": 9})
    )
    sizes = {path: node.capacity for path, _, node in layout.fields() if isinstance(node, StringNode)}
    assert sizes == {"header.frame_id": 5, "child_frame_id": 9}


def test_a_message_without_fields_is_one_byte_of_padding() -> None:
    """Empty messages take a byte but have no field."""
    layout = compute_layout(JAZZY, "std_msgs/Empty")
    assert layout.root.empty
    assert (layout.size, layout.align, list(layout.fields())) == (1, 1, [])
    assert not compute_layout(JAZZY, "std_msgs/Bool").root.empty


def test_a_sequence_has_a_count_and_its_elements() -> None:
    """A sequence is two members, of which the first says which it counts."""
    root = compute_layout(JAZZY, "std_msgs/Float64MultiArray").root
    count, data = (m for m in root.members if m.name == "data")
    assert (count.count_of, data.count_of) == ("data", None)
    assert count.node == ScalarNode("uint32", 4)
    assert data.node == SequenceNode(ScalarNode("float64", 8), 16)
    assert data.offset % 8 == 0


@pytest.mark.parametrize("distro", ["humble", "jazzy", "kilted", "lyrical", "noetic"])
def test_members_leave_no_gap(distro: str) -> None:
    """In every struct of every bundled type the members touch each other and fill the struct."""

    def check(node: StructNode) -> None:
        end = 0
        for member in node.members:
            assert member.offset == end
            assert member.offset % member.node.align == 0
            end += member.node.size
            inner = getattr(member.node, "element", member.node)
            if isinstance(inner, StructNode):
                check(inner)
        assert end == node.size
        assert node.size % node.align == 0

    store = TypeStore.bundled(distro)
    for name in store.names():
        check(compute_layout(store, name).root)


def test_unknown_types_are_the_stores_error() -> None:
    """A type that is not in the store gives its error, not the layout's."""
    with pytest.raises(MessageTypeError, match="TYP001"):
        compute_layout(JAZZY, "geometry_msgs/Twit")


def test_limits_are_values() -> None:
    """Equal limits are equal and hash alike, in whichever order the fields are given."""
    one = Limits(fields={"a": 1, "b": 2})
    other = Limits(fields={"b": 2, "a": 1})
    assert one == other
    assert hash(one) == hash(other)
    assert one != Limits(fields={"a": 1})
    assert Limits.from_dict(one.to_dict()) == one
    assert Limits.from_dict({}) == Limits()


@pytest.mark.parametrize(
    "data",
    [
        {"string": "x"},
        {"fields": []},
        {"fields": {1: 2}},
        {"fields": {"a": "b"}},
        {"strings": 5},
        {"sequence": None},
        {"sequence": float("nan")},
    ],
)
def test_untrusted_limits_are_checked(data: dict[str, object]) -> None:
    """Limits from a self-description are refused unless they have the right form."""
    with pytest.raises(LayoutError, match="LAY001"):
        Limits.from_dict(data)
