"""ROS messages as people write and read them: YAML in, YAML and Python's notation out, as ros2cli has it."""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping
from typing import Any

import numpy
import yaml

from rosplc.codec import Codec
from rosplc.layout import Limits, compute_layout
from rosplc.layout.nodes import limit_paths
from rosplc.model import ArrayType, NamedType, PrimitiveType, SequenceType, TypeStore

_SHOWN = 128  # elements and characters that are shown of a long array or string, as ``ros2 topic echo`` does
_NUMPY = {"char": "uint8"}


class Writer:
    """Encodes the message that values make, as often as it is called; what they lack has its default.

    The values are nested as the type is; ``header: auto`` and ``stamp: now`` become the present time, as in
    ``ros2 topic pub``.
    """

    def __init__(self, store: TypeStore, type_name: str, value: Mapping[str, Any]) -> None:
        self._store, self._type_name, self._value = store, type_name, value
        lengths: dict[str, int] = {}
        _note_lengths(_with_time(store, type_name, value), "", lengths)
        known = set(limit_paths(store, type_name))
        capacities = {path: max(1, length) for path, length in lengths.items() if path in known}
        self._codec = Codec(compute_layout(store, type_name, Limits(fields=capacities)))

    def __call__(self) -> bytes:
        """Return the message as it is now. Raises LayoutError LAY006, naming the field that does not fit."""
        value = _with_time(self._store, self._type_name, self._value)
        return self._codec.encode(self._codec.layout.pack(value))


def _with_time(store: TypeStore, type_name: str, value: Any) -> Any:
    if type_name == "std_msgs/msg/Header" and value == "auto":
        value = {"stamp": "now"}
    if type_name == "builtin_interfaces/msg/Time" and value == "now":
        seconds, rest = divmod(time.time_ns(), 10**9)
        return {"sec": seconds, "nanosec": rest}
    if not isinstance(value, Mapping):
        return value
    types = {each.name: each.type for each in store[type_name].fields}
    return {
        name: _with_time(store, kind.name, part) if isinstance(kind := types.get(name), NamedType) else part
        for name, part in value.items()
    }


def _note_lengths(value: Any, path: str, lengths: dict[str, int]) -> None:
    if isinstance(value, Mapping):
        for name, part in value.items():
            _note_lengths(part, f"{path}.{name}" if path else str(name), lengths)
    elif isinstance(value, (str, bytes, list)):
        length = len(value.encode("utf-8", "surrogateescape") if isinstance(value, str) else value)
        lengths[path] = max(length, lengths.get(path, 0))
        for part in value if isinstance(value, list) else ():
            _note_lengths(part, f"{path}[]", lengths)


def as_yaml(value: Any, *, whole: bool = False) -> str:
    """Return a message as ``ros2 topic echo`` prints it, without the line between two messages."""
    shown = _shortened(value, sys.maxsize if whole else _SHOWN)
    text = yaml.safe_dump(shown, sort_keys=False, allow_unicode=True, width=2**31, default_flow_style=False)
    return text.removesuffix("\n...\n").rstrip("\n")  # YAML's mark after a lone value


def _shortened(value: Any, most: int) -> Any:
    if isinstance(value, dict):
        return {name: _shortened(part, most) for name, part in value.items()}
    if isinstance(value, (list, tuple, bytes)):
        return [*(_shortened(part, most) for part in value[:most]), *(["..."] if len(value) > most else [])]
    return f"{value[:most]}..." if isinstance(value, str) and len(value) > most else value


def as_python(store: TypeStore, type_name: str, value: Any) -> str:
    """Return a message as Python's ``repr`` of it is in ROS 2, such as ``std_msgs.msg.Bool(data=True)``."""
    parts = []
    for field in store[type_name].fields:
        part, kind = value[field.name], field.type
        inner = kind.element if isinstance(kind, (ArrayType, SequenceType)) else kind
        if (
            isinstance(inner, PrimitiveType)
            and isinstance(kind, ArrayType)
            and inner.name not in ("bool", "byte")
        ):
            text = repr(numpy.array(list(part), _NUMPY.get(inner.name, inner.name)))
        elif isinstance(inner, PrimitiveType) and inner.name == "byte":
            text = repr(bytes([part]) if inner is kind else [bytes([each]) for each in part])
        elif not isinstance(inner, NamedType):
            text = repr(list(part) if isinstance(part, bytes) else part)
        elif inner is kind:
            text = as_python(store, inner.name, part)
        else:
            text = f"[{', '.join(as_python(store, inner.name, each) for each in part)}]"
        parts.append(f"{field.name}={text}")
    return f"{type_name.replace('/', '.')}({', '.join(parts)})"
