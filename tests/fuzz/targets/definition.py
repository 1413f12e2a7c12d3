"""``.msg`` text for ROS 1 and ROS 2: parsed, printed, hashed, laid out, compiled to a plan."""

from __future__ import annotations

from collections.abc import Iterator

from rosplc.codec import Codec, Wire
from rosplc.errors import LayoutError, MessageTypeError
from rosplc.layout import Limits, compute_layout
from rosplc.layout.c_header import c_header
from rosplc.model import TypeStore
from tests.fuzz.choices import Choices
from tests.fuzz.oracle import refusals

__all__ = ["check", "seeds"]

_NAME = "fuzz_msgs/msg/Top"
_LARGE = 1 << 16
_MORE = """\
uint8 A=1
string B="x'#"
string<=5 name "a"
float64[3] values [1, -2.5, .5]
Inner[<=2] inner
time[] when
wstring no
================================================================================
MSG: fuzz_msgs/Inner
bool[] marks [true, false]
byte b -1
char c
"""


def check(data: bytes) -> None:
    """Whatever the text is, it is refused or means the same after printing and reading it again."""
    choices = Choices(data)
    distro, bundled, truncating = choices.pick(("", "noetic", "jazzy")), choices.flag(), choices.flag()
    text = choices.rest().decode("utf-8", "surrogateescape")
    with refusals(MessageTypeError, LayoutError):
        known = TypeStore.bundled(distro) if bundled and distro else TypeStore(distro, {})
        store = known.with_definition(_NAME, text)
        printed = store.definition_text(_NAME)
        again = TypeStore.from_definition(_NAME, printed, distro=distro)
        assert again.definition_text(_NAME) == printed
        assert again[_NAME] == store[_NAME]
        if distro == "noetic":
            assert again.md5(_NAME) == store.md5(_NAME)
        else:
            assert again.type_hash(_NAME) == store.type_hash(_NAME)
        layout = compute_layout(store, _NAME, Limits(7, 3))
        if layout.size > _LARGE:
            return
        c_header([layout])
        codec = Codec(layout, Wire.ROS1 if distro == "noetic" else Wire.CDR)
        record = layout.pack({})
        codec.decode(codec.encode(record), truncate=truncating)
        repr(layout.view(record))


def seeds() -> Iterator[bytes]:
    """Definitions of many shapes."""
    store = TypeStore.bundled("jazzy")
    for name in ("sensor_msgs/msg/JointState", "diagnostic_msgs/msg/DiagnosticArray", "std_msgs/msg/Empty"):
        yield b"\0\0\0" + store.definition_text(name).encode()
    yield b"\1\1\0" + TypeStore.bundled("noetic").definition_text("sensor_msgs/msg/Imu").encode()
    for prefix in (b"\0\0\0", b"\1\0\1", b"\2\1\0"):
        yield prefix + _MORE.encode()
        yield prefix + _MORE.replace("wstring no\n", "").encode()
