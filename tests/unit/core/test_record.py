"""Shapes and views of the C core, against hostile builders, values and records."""

from __future__ import annotations

import gc
import subprocess
import sys
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rosplc._core import Shape
from rosplc.errors import LayoutError
from rosplc.layout import Limits, RecordView, compute_layout
from rosplc.model import TypeStore

JAZZY = TypeStore.bundled("jazzy")


def shape(*fields: tuple[object, ...], size: int = 16) -> Shape:
    return Shape("t/msg/T", size, fields, {}, RecordView)


INNER = shape(("x", None, "uint64", 0, 8, -1, -1), size=8)


@pytest.mark.parametrize(
    "field",
    [
        ("x", None, "uint64", 9, 8, -1, -1),
        ("x", None, "uint64", 0xFFFFFFFC, 8, -1, -1),
        ("x", None, "uint64", 0, 4, -1, -1),
        ("x", None, "uint128", 0, 16, -1, -1),
        ("x", None, "string", 0, 17, -1, -1),
        ("x", None, "string", 0, 0, -1, -1),
        ("x", None, "uint8", 0, 1, 17, -1),
        ("x", None, "uint64", 0, 8, 2**31, 0),
        ("x", None, "uint64", 0, 8, 2**61, -1),
        ("x", None, "uint8", 0, 1, 2, 13),
        ("x", None, "uint8", 0, 1, 2, 2**40),
        ("x", None, INNER, 9, 8, -1, -1),
        ("x", None, INNER, 0, 4, 2, -1),
        ("x", "secs", "uint8", 0, 1, -1, -1),
        ("x", 5, "uint8", 0, 1, -1, -1),
        ("x", None, None, 0, 8, -1, -1),
    ],
)
def test_a_field_that_leaves_its_struct_is_refused(field: tuple[object, ...]) -> None:
    """Offsets, sizes, numbers and counts beyond the struct, and unknown kinds, never become a shape."""
    with pytest.raises(ValueError, match="is not a field of a record of 16 bytes"):
        shape(field)


def test_a_field_reads_only_views_that_have_it() -> None:
    """Taken from its class and used on another struct's view, a field refuses to read beyond it."""
    large = shape(("x", None, "uint64", 8, 8, -1, -1)).view(b"\1" * 16)
    field: Any = vars(type(large))["x"]
    assert field.__get__(large) == 0x0101010101010101
    for other in (INNER.view(bytes(8)), b"12345678"):
        with pytest.raises(TypeError, match="views of its own type"):
            field.__get__(other)
    with pytest.raises(TypeError, match="cannot create"):
        type(large)()  # type: ignore[call-arg]


@pytest.mark.parametrize("kind", ["uint16[] x", "uint16[3] x"])
def test_a_list_that_shrinks_meanwhile_is_refused(kind: str) -> None:
    """A conversion that empties the list it comes from, or its dictionary, writes nothing it should not."""

    class Emptying:
        def __index__(self) -> int:
            items.clear()
            value.clear()
            gc.collect()
            return 1

    layout = compute_layout(TypeStore.from_definition("t/T", f"{kind}\nint8 y\n"), "t/T")
    items: list[Any] = [Emptying(), 2, 3]
    value: dict[str, Any] = {"x": items, "y": 1}
    with pytest.raises(LayoutError, match="changed while they were packed") as caught:
        layout.pack(value)
    assert caught.value.where == "x[1]"


def test_a_view_keeps_its_bytes() -> None:
    """A nested view alone keeps the buffer alive, and a bytearray cannot shrink below its views."""
    layout = compute_layout(JAZZY, "geometry_msgs/Twist")
    record = layout.pack({"linear": {"x": 1.5}})
    linear = layout.view(record).linear
    with pytest.raises(BufferError):
        record.clear()
    del record
    gc.collect()
    assert linear.x == 1.5


@settings(max_examples=150, deadline=None)
@given(st.data())
def test_hostile_records_stay_within_their_bytes(data: st.DataObject) -> None:
    """Any bytes read as some value of the type, in a buffer that ends with the record."""
    name = data.draw(st.sampled_from(["sensor_msgs/JointState", "diagnostic_msgs/DiagnosticArray"]))
    layout = compute_layout(JAZZY, name, Limits(sequence=2, string=3))
    record = data.draw(st.sampled_from([b"\xff", b"\0", b"\x80a"])) * layout.size
    record = data.draw(st.binary(max_size=layout.size)).ljust(layout.size, record[:1])[: layout.size]
    found = layout.to_dict(bytes(record))
    assert layout.pack(found) == layout.pack(layout.view(record))
    assert len(layout.excerpt(record, 1)["header"]) == 2


_TWO_INTERPRETERS = """
import importlib, sys
try:
    import _xxsubinterpreters as interpreters
except ImportError:
    import _interpreters as interpreters
from rosplc.layout import compute_layout
from rosplc.model import TypeStore
from rosplc.ros.rospy._tcp import Loop, Sender

other = interpreters.create()
for module in ("rosplc._core._native", "rosplc.ros.rospy._tcp"):
    program = f"import sys; sys.path[:] = {sys.path}; import importlib; importlib.import_module({module!r})"
    try:
        failure = interpreters.run_string(other, program)
    except interpreters.RunFailedError as error:
        failure = error
    print("loaded" if failure is None else "refused")
interpreters.destroy(other)
layout = compute_layout(TypeStore.bundled("noetic"), "std_msgs/msg/Int32")
print(layout.to_dict(layout.pack({"data": 7})), type(Sender(Loop(1))).__name__)
"""


def test_another_interpreter_of_the_process_changes_nothing() -> None:
    """It is refused: types of an interpreter that has ended would be in place of this one's."""
    done = subprocess.run(
        [sys.executable, "-c", _TWO_INTERPRETERS], capture_output=True, text=True, check=False, timeout=60
    )
    assert done.stdout == "refused\nrefused\n{'data': 7} Sender\n", done.stderr
