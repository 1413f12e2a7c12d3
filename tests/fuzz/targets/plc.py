"""Names, constants, default values and safe messages that try to become PLC code."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from typing import Any, cast

from rosplc.config.plans import ClassicPlan
from rosplc.errors import GenerationError, LayoutError, MessageTypeError
from rosplc.layout import Limits, compute_layout
from rosplc.model import ArrayType, MessageType, PrimitiveType, SequenceType, StringType, TypeStore
from rosplc.model.types import Constant, Field
from rosplc.plc import base
from rosplc.plc.build import build_project
from rosplc.plc.plan import PlcTask, PlcTopic, ProjectOptions
from tests.fuzz.choices import Choices
from tests.fuzz.oracle import refusals
from tests.fuzz.plc_oracle import check_project

__all__ = ["check", "seeds"]

# What is written by hand is the same each time; reading it takes most of a generation.
base.parse_object = cache(base.parse_object)
base.read_objects = cast(Any, cache(base.read_objects))

_KINDS: tuple[PrimitiveType | StringType, ...] = (
    StringType(), StringType(9), PrimitiveType("bool"), PrimitiveType("float64"), PrimitiveType("int64"),
    PrimitiveType("uint8"), PrimitiveType("float32"), PrimitiveType("uint64"),
)  # fmt: skip
_WORDS = ("data", "type", "end_struct", "DATA", "x", "x_count", "abPad0", "a__b", "msg", "r")
_TYPES = ("cell_msgs/msg/Top", "a/msg/Type", "RosPlc/msg/Header")
_TOPICS = ("/cmd_vel", "/a/b", "/a_b", "/type", "/A/b")
_TASKS = ("RosTask", "Fast")
_BASE = {
    name: TypeStore.bundled("jazzy")[name]
    for name in ("builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration")
}


def _name(choices: Choices, usual: tuple[str, ...]) -> str:
    number = choices.byte()
    return usual[number % len(usual)] if number & 1 else choices.text()


def _value(choices: Choices, kind: object) -> bool | int | float | str:
    if isinstance(kind, StringType):
        return choices.text()[: kind.bound or 80].replace("\0", "")  # a NUL never gets past the parser
    name = kind.name if isinstance(kind, PrimitiveType) else ""
    if name == "bool":
        return choices.flag()
    if name.startswith("float"):
        large = 1e300 if name == "float64" else 1e30  # the parser refuses what does not fit
        return choices.pick((0.0, -0.0, 1.5, large, -1e-300, float("inf"), float("nan"), 0.1))
    return choices.pick((0, 1, 255, 128))


def _message(choices: Choices) -> MessageType:
    name = _name(choices, _TYPES)
    fields: dict[str, Field] = {}
    for _ in range(choices.below(5)):
        own, kind, shape = _name(choices, _WORDS), choices.pick(_KINDS), choices.below(4)
        default = _value(choices, kind) if choices.flag() else None
        if shape == 1:
            fields[own] = Field(own, ArrayType(kind, 2), None if default is None else (default, default))
        elif shape == 2:
            fields[own] = Field(own, SequenceType(kind), None if default is None else (default,))
        else:
            fields[own] = Field(own, kind, default)
    constants = {}
    for _ in range(choices.below(3)):
        own, kind = _name(choices, _WORDS), choices.pick(_KINDS)
        constants[own] = Constant(own, kind, _value(choices, kind))
    return MessageType(name, tuple(fields.values()), tuple(constants.values()))


def check(data: bytes) -> None:
    """Whatever the names and texts are, they are refused or stay names and texts in every delivery."""
    choices = Choices(data)
    message = _message(choices)
    options = ProjectOptions(
        pins=choices.flag(), prefix=_name(choices, ("rosplc", "cell-1")), fenced=choices.flag()
    )
    with refusals(MessageTypeError, LayoutError, GenerationError):
        store = TypeStore("jazzy", {**_BASE, message.name: message})
        layout = compute_layout(store, message.name, Limits(90, 3))
        topics: dict[str, PlcTopic] = {}
        for _ in range(1 + choices.below(3)):
            topic, reading, task = _name(choices, _TOPICS), choices.flag(), _name(choices, _TASKS)
            safe = None
            classic = (
                ClassicPlan(_name(choices, _WORDS), _name(choices, _WORDS)) if choices.below(4) == 3 else None
            )
            if reading and message.fields and choices.flag():
                field = choices.pick(message.fields)
                kind = field.type.element if isinstance(field.type, ArrayType | SequenceType) else field.type
                value = _value(choices, kind)
                safe = {field.name: value if kind is field.type else [value]}
                layout.pack(safe)
            topics[topic] = PlcTopic(
                topic,
                layout,
                "read" if reading else "write",
                task,
                stale_after_ns=choices.number(5),
                on_stale="hold" if safe is None else "value",
                safe=safe,
                classic=classic,
            )
        tasks = [PlcTask(name) for name in dict.fromkeys(topic.task for topic in topics.values())]
        project = build_project(store, list(topics.values()), tasks, options)
        check_project(project, [layout])


def _usual(number: int) -> bytes:
    return bytes([2 * number + 1])


def _own(text: str) -> bytes:
    return b"\0" + text.encode() + b"\xff"


def seeds() -> Iterator[bytes]:
    """Each place in turn with texts that would end a string, a comment, a declaration or an element."""
    for text in (
        "x'; END_VAR PROGRAM evil //", "*) END_TYPE (*", "$'", "$", "{attribute 'x'}", "]]><pou name='x'/>",
        "&amp;<!--", "'''\nimport os\n'''", "\\", "\\u0027", "\u2028x", "\n", "a\tb", "\0", "ü",
        "}; int x; /*",
    ):  # fmt: skip
        part, own, plain = text.encode() + b"\xff", _own(text), _usual(0)
        string, number = b"\0", b"\5"
        for place in range(7):
            name, field, constant, prefix, topic, task, memory = (
                own if place == index else plain for index in range(7)
            )
            message = name + b"\3" + field + string + b"\0\1" + part
            message += _usual(4) + number + b"\2\1\0" + _usual(5) + string + b"\1\1" + part
            message += b"\2" + constant + string + part + _usual(1) + number + b"\1"
            read = topic + b"\1" + task + b"\0\1\0" + part + b"\5\0\0\0\0"
            write = _usual(1) + b"\0" + _usual(0) + b"\3" + memory + plain + bytes(5)
            yield message + b"\1" + prefix + b"\1\1" + read + write
