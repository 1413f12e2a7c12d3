"""Views of records."""

from __future__ import annotations

import copy

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rosplc.errors import LayoutError
from rosplc.layout import Limits, compute_layout
from rosplc.model import TypeStore

JAZZY = TypeStore.bundled("jazzy")
STATE = compute_layout(JAZZY, "sensor_msgs/JointState", Limits(sequence=3, string=4))
VALUE = {"header": {"frame_id": "base"}, "name": ["a", "b"], "position": [1.0, 2.0, 3.0]}


def test_fields_are_attributes() -> None:
    """Values, nested messages and lists are had by name, and completed by name."""
    view = STATE.view(STATE.pack(VALUE))
    assert view.header.frame_id == "base"
    assert view.name == ["a", "b"]
    assert view.position == [1.0, 2.0, 3.0]
    assert dir(view) == ["effort", "header", "name", "position", "velocity"]


def test_a_view_prints_its_values() -> None:
    """The text of a view is readable, and long lists are shortened."""
    view = compute_layout(JAZZY, "geometry_msgs/Pose").view(
        compute_layout(JAZZY, "geometry_msgs/Pose").initial()
    )
    assert repr(view) == (
        "Pose(position=Point(x=0.0, y=0.0, z=0.0), orientation=Quaternion(x=0.0, y=0.0, z=0.0, w=1.0))"
    )
    data = compute_layout(JAZZY, "std_msgs/UInt8MultiArray", Limits(sequence=100))
    text = repr(data.view(data.pack({"data": bytes(range(100))})))
    assert "data=[0, 1, 2, 3, 4, 5, 6, 7, … 92 more])" in text


def test_views_are_equal_by_value() -> None:
    """Padding and unused elements make no difference, values do, and views have no hash."""
    layout = compute_layout(TypeStore.from_definition("t/T", "int8 a\nfloat64 b\n"), "t/T")
    one, other = layout.pack({"a": 1}), layout.pack({"a": 1})
    other[3] = 0xFF
    assert one != other
    assert layout.view(one) == layout.view(other)
    assert layout.view(one) != layout.view(layout.pack({"a": 2}))
    assert layout.view(one) != {"a": 1, "b": 0.0}
    with pytest.raises(TypeError):
        hash(layout.view(one))


def test_a_view_follows_its_buffer() -> None:
    """A view reads at each access; what was read before stays as it was."""
    buffer = STATE.pack(VALUE)
    view = STATE.view(buffer)
    names = view.name
    STATE.pack_into({"name": ["new"]}, buffer)
    assert (names, view.name) == (["a", "b"], ["new"])


def test_a_deep_copy_stays() -> None:
    """A deep copy of a view, also of a nested one, no longer follows the buffer."""
    buffer = STATE.pack(VALUE)
    view = STATE.view(buffer)
    whole, nested = copy.deepcopy(view), copy.deepcopy(view.header)
    STATE.pack_into({"name": ["new"]}, buffer)
    assert (whole.name, nested.frame_id, view.name) == (["a", "b"], "base", ["new"])
    assert copy.copy(nested.stamp) == nested.stamp


def test_a_view_is_read_only() -> None:
    """Assigning to a field says how records are written instead."""
    view = STATE.view(STATE.pack(VALUE))
    with pytest.raises(AttributeError, match="pack a new"):
        view.name = ["x"]


def test_other_names_are_attribute_errors() -> None:
    """A misspelt field is an AttributeError that names the type."""
    view = STATE.view(STATE.pack(VALUE))
    with pytest.raises(AttributeError, match="sensor_msgs/msg/JointState has no field 'nmae'"):
        _ = view.nmae
    assert not hasattr(view, "__len__")


def test_short_buffers_are_refused() -> None:
    """A buffer smaller than a record is refused before anything is read; a larger one is fine."""
    with pytest.raises(LayoutError, match="LAY006"):
        STATE.view(bytes(STATE.size - 1))
    assert STATE.view(bytes(STATE.size + 1)).name == []


def test_bytes_that_are_no_utf8_survive() -> None:
    """A string of any bytes is read without loss and packs to the same bytes."""
    layout = compute_layout(JAZZY, "std_msgs/String", Limits(string=4))
    record = b"\xff\xfe\xc3a\0"
    assert layout.view(record).data == "\udcff\udcfe\udcc3a"
    assert layout.pack(layout.view(record)) == record


@settings(max_examples=200, deadline=None)
@given(st.data())
def test_any_bytes_can_be_read(data: st.DataObject) -> None:
    """A record of any bytes at all reads as a value, which packs and reads the same."""
    name = data.draw(st.sampled_from(["sensor_msgs/JointState", "diagnostic_msgs/DiagnosticArray"]))
    layout = compute_layout(JAZZY, name, Limits(sequence=2, string=3))
    record = data.draw(st.binary(min_size=layout.size, max_size=layout.size))
    view = layout.view(record)
    again = layout.pack(layout.to_dict(record))
    assert repr(layout.view(again)) == repr(view)


def test_an_excerpt_has_the_first_elements_and_knows_the_length() -> None:
    """Arrays, sequences, and those inside elements are cut; what is short is whole, a plain list."""
    record = STATE.pack(VALUE)
    found = STATE.excerpt(record, 2)
    assert (found["position"], found["position"].length) == ([1.0, 2.0], 3)
    assert type(found["name"]) is list
    assert STATE.excerpt(record, 3) == STATE.to_dict(record)
    array = compute_layout(JAZZY, "std_msgs/UInt8MultiArray", Limits(sequence=4))
    inner = array.excerpt(array.pack({"layout": {"dim": [{"label": "a"}, {"label": "b"}]}}), 1)
    assert inner["layout"]["dim"] == [{"label": "a", "size": 0, "stride": 0}]
    assert inner["layout"]["dim"].length == 2
    with pytest.raises(LayoutError):
        STATE.excerpt(b"short", 1)
