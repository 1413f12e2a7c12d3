"""Classes of the ROS installation: found by a type's name, and compared with the bridge's definition.

The middleware's type support is the class's: were the definitions different, values would be in wrong fields.
"""

from __future__ import annotations

import importlib
import operator
from typing import Any

from rosplc.errors import BackendError
from rosplc.model import TypeStore
from rosplc.model.types import ArrayType, FieldType, MessageType, PrimitiveType, SequenceType, StringType
from rosplc.ros._base import is_service

# How rosidl_generator_py writes a field's type (resource/_msg.py.em); `char` is uint8 there.
_NAMES = {"bool": "boolean", "byte": "octet", "char": "uint8", "float32": "float", "float64": "double"}


# Where a class of an action keeps those that rosidl derives.
_DERIVED = {
    "SendGoal": "Impl.SendGoalService",
    "GetResult": "Impl.GetResultService",
    "FeedbackMessage": "Impl.FeedbackMessage",
}
_WORDS = {"msg": "message", "srv": "service", "action": "action"}


def message_class(type_name: str) -> Any:
    """Import a message's or service's class, or a part's (``…/Name_Request``); ROS011: not installed."""
    package, kind, name = type_name.split("/")
    try:
        module = importlib.import_module(f"{package}.{kind}")
    except Exception as error:  # whatever a half-installed package raises
        raise BackendError(
            "ROS011",
            f"the Python package {package} of {type_name} cannot be imported: {error}",
            remedy=f"Install ros-DISTRO-{package.replace('_', '-')}, or build it with colcon, and source its "
            "setup.bash before the bridge starts.",
        ) from error
    base, *parts = [name] if kind == "msg" else name.split("_")
    if not hasattr(module, base):
        what = f"the installed package {package} has no {_WORDS[kind]} {base} ({module.__file__})"
        raise BackendError("ROS011", what)
    path = ".".join([base, *(_DERIVED.get(part, part) for part in parts)])
    try:
        found = operator.attrgetter(path)(module)
    except AttributeError:
        found = None
    if not hasattr(found, "get_fields_and_field_types") and not hasattr(found, "Request"):
        what = f"the package {package} that Python finds is not one of ROS 2 ({module.__file__})"
        remedy = "Keep ROS 1's packages out of PYTHONPATH, and source the setup.bash of ROS 2 last."
        raise BackendError("ROS011", what, remedy=remedy)
    return found


def field_text(kind: FieldType) -> str:
    """Return a field's type as a generated class's ``get_fields_and_field_types`` writes it."""
    if isinstance(kind, SequenceType):
        bound = "" if kind.bound is None else f", {kind.bound}"
        return f"sequence<{field_text(kind.element)}{bound}>"
    if isinstance(kind, ArrayType):
        return f"{field_text(kind.element)}[{kind.length}]"
    if isinstance(kind, StringType):
        return "string" if kind.bound is None else f"string<{kind.bound}>"
    if isinstance(kind, PrimitiveType):
        return _NAMES.get(kind.name, kind.name)
    package, _, name = kind.name.split("/")
    return f"{package}/{name}"


class MessageClasses:
    """The classes of the types of a store, the bridge's own definitions, each compared once."""

    def __init__(self, store: TypeStore) -> None:
        self._store = store
        self._found: dict[str, Any] = {}

    def __getitem__(self, type_name: str) -> Any:
        """Return a type's class; TYP001, ROS011 if it is not installed, ROS012 if with other fields."""
        if type_name not in self._found:
            parts = ("_Request", "_Response") if is_service(type_name) else ("",)
            for part in parts:
                self._compare(self._store[type_name + part], set())
            self._found[type_name] = message_class(type_name)
        return self._found[type_name]

    def _compare(self, message: MessageType, seen: set[str]) -> None:
        if message.name in seen or message.name in self._found:
            return
        seen.add(message.name)
        theirs = list(message_class(message.name).get_fields_and_field_types().items())
        ours = [(field.name, field_text(field.type)) for field in message.fields]
        if ours != theirs:
            what = f"{message.name} is installed with another definition than the bridge has"
            difference = _first_difference(ours, theirs)
            raise BackendError("ROS012", f"{what} ({self._store.distro}): {difference}")
        for name in message.needs:
            self._compare(self._store[name], seen)


def _first_difference(ours: list[tuple[str, str]], theirs: list[tuple[str, str]]) -> str:
    for number, (one, other) in enumerate(zip(ours, theirs, strict=False), 1):
        if one != other:
            return f"field {number} is `{other[1]} {other[0]}` there, `{one[1]} {one[0]}` here"
    more, where = (theirs, "there") if len(theirs) > len(ours) else (ours, "here")
    name, kind = more[min(len(ours), len(theirs))]
    return f"`{kind} {name}` exists only {where}"
