"""Layout text, layout id and the words for a difference."""

from __future__ import annotations

from rosplc.layout import Limits, compute_layout
from rosplc.model import TypeStore

JAZZY = TypeStore.bundled("jazzy")


def test_the_text_is_the_specifications() -> None:
    """A small record's text, written out by hand from the specification."""
    store = TypeStore.from_definition(
        "t/T", f"bool on\nstring[] names\nI[2] pair\n{'=' * 80}\nMSG: t/I\nfloat64 x\nuint8 k\n"
    )
    layout = compute_layout(store, "t/T", Limits(fields={"names": 2, "names[]": 3}))
    assert layout.text == (
        "rosplc-layout 1\n"
        "t/msg/T size 48 align 8\n"
        "0 on bool\n"
        "1 - padding(3)\n"
        "4 names count(2)\n"
        "8 names sequence(2,4)\n"
        "8 names[] string(3)\n"
        "16 pair array(2,16)\n"
        "16 pair[].x float64\n"
        "24 pair[].k uint8\n"
        "25 - padding(7)\n"
    )
    assert len(layout.layout_id) == 16
    low, high = layout.layout_id_words
    assert (low.to_bytes(4, "little") + high.to_bytes(4, "little")).hex() == layout.layout_id


def test_the_fields_are_the_texts_lines() -> None:
    """fields() gives path and offset of each line but padding and counts."""
    layout = compute_layout(JAZZY, "visualization_msgs/Marker")
    lines = [line.split(" ") for line in layout.text.splitlines()[2:]]
    expected = [(p, int(o)) for o, p, what in lines if p != "-" and not what.startswith("count")]
    assert [(path, offset) for path, offset, _ in layout.fields()] == expected


def test_equal_layouts_are_equal() -> None:
    """Layouts are compared by what they say, not by how they came about."""
    one = compute_layout(JAZZY, "sensor_msgs/JointState", Limits(fields={"name": 16}))
    assert one == compute_layout(TypeStore.bundled("humble"), "sensor_msgs/msg/JointState")
    assert hash(one) == hash(compute_layout(JAZZY, "sensor_msgs/JointState"))
    assert one != compute_layout(JAZZY, "sensor_msgs/JointState", Limits(sequence=15))
    assert one != "something else"


def test_constants_are_no_part_of_the_id() -> None:
    """Constants may change without a new layout id."""
    texts = ("int8 x\n", "int8 A=1\nint8 x\n")
    one, other = (compute_layout(TypeStore.from_definition("a/B", t), "a/B") for t in texts)
    assert one.layout_id == other.layout_id


def test_a_difference_names_fields_not_offsets() -> None:
    """What differs is said in the terms of the definition, once per cause."""
    small = compute_layout(JAZZY, "sensor_msgs/JointState", Limits(fields={"name": 6}))
    large = compute_layout(JAZZY, "sensor_msgs/JointState")
    assert small.difference(large) == "name is count(6) on this side, count(16) on the other"
    assert small.difference(large.text) == small.difference(large)
    assert small.difference(small) == ""


def test_a_difference_of_definitions() -> None:
    """Fields that one side lacks are named as such, and so is another type."""
    stores = [TypeStore.from_definition("a/B", text) for text in ("int8 x\nint8 y\n", "int8 x\nint16 z\n")]
    one, other = (compute_layout(store, "a/B") for store in stores)
    assert one.difference(other) == "y exists only on this side; z exists only on the other side"
    swapped = compute_layout(TypeStore.from_definition("a/B", "int8 y\nint8 x\n"), "a/B")
    assert one.difference(swapped) == "the fields are in a different order"
    twist, accel = (compute_layout(JAZZY, f"geometry_msgs/{name}") for name in ("Twist", "Accel"))
    assert twist.difference(accel).endswith("/msg/Twist on this side, geometry_msgs/msg/Accel on the other")


def test_a_long_difference_is_cut() -> None:
    """Many differences are counted instead of listed."""
    one = compute_layout(JAZZY, "visualization_msgs/Marker", Limits(string=10, sequence=2))
    text = one.difference(compute_layout(JAZZY, "visualization_msgs/Marker"))
    assert text.count(" on this side, ") == 5
    assert text.endswith(" more")
