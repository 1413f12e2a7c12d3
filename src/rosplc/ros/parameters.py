"""A ROS 2 node's parameters: the six services of rcl_interfaces, and the topic ``/parameter_events``.

A node without these services delays ``ros2 param list`` for the whole graph. The texts of refusals are for
people; those of rclpy and rclcpp differ.
"""

from __future__ import annotations

import math
import sys
import threading
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Literal, get_args

from rosplc._version import __version__
from rosplc.clock import SYSTEM, Clock
from rosplc.model import TypeStore
from rosplc.ros import fields
from rosplc.ros.backend import Backend, Publisher, Qos, ServiceServer

Kind = Literal[
    "bool", "integer", "double", "string", "byte_array",
    "bool_array", "integer_array", "double_array", "string_array",
]  # fmt: skip
KINDS: tuple[Kind, ...] = get_args(Kind)
"""The kinds of parameters; the first is number 1 in ``rcl_interfaces/msg/ParameterType``."""
EVENTS = "/parameter_events"
_QOS = Qos(depth=1000)  # rmw's profiles for the services and the events of parameters
_EVENT = "rcl_interfaces/msg/ParameterEvent"
_MOST_DIGITS = 1e-9  # of a step, by which a double may miss it

_VALUES: dict[str, tuple[tuple[type, ...], float, float]] = {
    "bool": ((bool,), False, True),
    "integer": ((int,), -(2**63), 2**63 - 1),
    "double": ((float, int), -sys.float_info.max, sys.float_info.max),  # neither infinite nor no number
    "byte": ((int,), 0, 255),
}

Done = Callable[[str], None]
"""Called once at the end of a change, with a reason for failure, or empty if the values are in effect."""
Apply = Callable[[Mapping[str, Any], Done], None]
"""Called to put values into effect, all of them or none; must not block."""


@dataclass(frozen=True)
class Parameter:
    """A declared parameter."""

    name: str
    kind: Kind
    value: Any  # what it is at first; bytes for a ``byte_array``
    description: str = ""
    read_only: bool = False
    range: tuple[float, float, float] | None = None  # least, greatest, step (0: any); of numbers
    most: int = 2**32 - 1  # elements of an array at most
    longest: int = 2**32 - 1  # bytes of a string, or of each string of an array, at most
    take: Callable[[Any], None] | None = None  # takes a new value at once; without it ``apply`` is asked

    @property
    def number(self) -> int:
        """The number of its kind."""
        return KINDS.index(self.kind) + 1

    def descriptor(self) -> dict[str, Any]:
        """Return its ParameterDescriptor."""
        found: dict[str, Any] = {"name": self.name, "type": self.number}
        found |= {"description": self.description, "read_only": self.read_only}
        if self.range is not None:
            span = dict(zip(("from_value", "to_value", "step"), self.range, strict=True))
            found["integer_range" if self.kind == "integer" else "floating_point_range"] = [span]
        return found

    def refusal(self, kind: str, value: Any) -> str:
        """Return why the parameter cannot have a value; empty if it can."""
        if self.read_only:
            return f"{self.name} is read-only"
        if kind != self.kind:
            return f"{self.name} is of type {self.kind} and cannot change to {kind}"
        if kind.endswith("_array") and len(value) > self.most:
            return f"{self.name} can have at most {self.most} elements, not {len(value)}"
        texts = [value] if kind == "string" else value if kind == "string_array" else []
        if any(len(text.encode(errors="surrogateescape")) > self.longest for text in texts):
            return f"the text for {self.name} has more than {self.longest} bytes"
        return "" if self.range is None else self._outside(value)

    def fitting(self, value: Any) -> Any:
        """Convert a YAML value to a value of this parameter, read-only or not; ValueError with the reason."""
        found = converted(self.kind, value)
        if why := replace(self, read_only=False).refusal(self.kind, found):
            raise ValueError(why)
        return found

    def _outside(self, value: float) -> str:
        assert self.range is not None
        least, greatest, step = self.range
        if not least <= value <= greatest:
            return f"{self.name} must be within {least} … {greatest}"
        if step and value != greatest:
            rest = math.remainder(value - least, step) if self.kind == "double" else (value - least) % step
            if abs(rest) > (step * _MOST_DIGITS if self.kind == "double" else 0):
                return f"{self.name} must be {least} plus a multiple of {step}"
        return ""


def converted(kind: str, value: Any) -> Any:
    """Convert a YAML value to a parameter kind; ValueError with the reason if that is not possible."""
    if kind.endswith("_array"):
        if not isinstance(value, list):
            raise ValueError(f"{value!r} is not of type {kind}")
        found = [converted(kind.removesuffix("_array"), each) for each in value]
        return bytes(found) if kind == "byte_array" else found
    types, least, greatest = _VALUES.get(kind, ((str,), "", value))
    if type(value) not in types or not least <= value <= greatest:
        raise ValueError(f"{value!r} is not of type {kind}")
    return float(value) if kind == "double" else value


def shown_parameters(values: Mapping[str, str | list[str]]) -> list[Parameter]:
    """Return read-only parameters that describe the node: ``version`` and the given values."""
    return [
        Parameter(name, "string" if isinstance(value, str) else "string_array", value, "read-only", True)
        for name, value in {"version": __version__, **values}.items()
    ]


class ParameterServer:
    """Serves a node's parameters; ``apply`` puts requested values into effect.

    Raises as :meth:`rosplc.ros.backend.Backend.serve`.
    """

    def __init__(
        self,
        backend: Backend,
        store: TypeStore,
        declared: Iterable[Parameter],
        apply: Apply = lambda _values, done: done(""),
        *,
        clock: Clock = SYSTEM,
    ) -> None:
        self.declared = {each.name: each for each in declared}
        self.values = {name: each.value for name, each in self.declared.items()}
        self._store, self._apply, self._clock = store, apply, clock
        self._lock = threading.Lock()
        self._servers: dict[str, ServiceServer] = {}
        self._events: Publisher = backend.advertise(EVENTS, _EVENT, _QOS)
        for service, take in (
            ("ListParameters", self._list),
            ("DescribeParameters", self._describe),
            ("GetParameters", self._get),
            ("GetParameterTypes", self._types),
            ("SetParameters", self._set),
            ("SetParametersAtomically", self._set_atomically),
        ):
            name = "".join(f"_{char.lower()}" if char.isupper() else char for char in service)[1:]
            kind = f"rcl_interfaces/srv/{service}"
            server = backend.serve(f"~/{name}", kind, _QOS, partial(self._requested, kind, take))
            self._servers[kind] = server
        self._node = server.topic.rpartition("/")[0]
        self._tell("new_parameters", self.declared)

    def close(self) -> None:
        """Leave the graph."""
        for end in (*self._servers.values(), self._events):
            end.close()

    def begin(self, names: Collection[str]) -> Mapping[str, Any]:
        """Return earlier values of these parameters: there are none."""
        return {}

    def changed(self, values: Mapping[str, Any]) -> None:
        """Note values that are in effect now, and publish the changes."""
        with self._lock:
            changed = [name for name, value in values.items() if self.values[name] != value]
            self.values.update(values)
        if changed:
            self._tell("changed_parameters", changed)

    def _take(self, values: Mapping[str, Any]) -> None:
        """Let parameters with a ``take`` function process their values."""
        for name, value in values.items():
            if (take := self.declared[name].take) is not None:
                take(value)
        self.changed(values)

    def _tell(self, what: str, names: Iterable[str]) -> None:
        stamp = fields.time(self._clock.time_ns())
        found = [{"name": name, "value": self._value(self.declared[name])} for name in names]
        self._events.write(
            fields.pack(self._store, _EVENT, {"stamp": stamp, "node": self._node, what: found})
        )

    def _value(self, each: Parameter) -> dict[str, Any]:
        """Return a parameter's ParameterValue."""
        return {"type": each.number, f"{each.kind}_value": self.values[each.name]}

    # -- the services; each handler is given the request's fields, and how to answer

    def _requested(self, service: str, take: Any, payload: bytes, caller: bytes, _stamp_ns: int) -> None:
        def answer(**values: Any) -> None:
            self._servers[service].reply(caller, fields.pack(self._store, f"{service}_Response", values))

        take(fields.unpack(self._store, f"{service}_Request", payload), answer)

    def _list(self, request: Mapping[str, Any], answer: Callable[..., None]) -> None:
        prefixes, depth = request["prefixes"], request["depth"]

        def wanted(name: str) -> bool:
            if not prefixes:
                return not depth or name.count(".") < depth
            inner = [name[len(prefix) + 1 :] for prefix in prefixes if name.startswith(f"{prefix}.")]
            return name in prefixes or any(not depth or part.count(".") < depth for part in inner)

        names = [name for name in self.declared if wanted(name)]
        groups = dict.fromkeys(name.rpartition(".")[0] for name in names)
        answer(result={"names": names, "prefixes": [group for group in groups if group]})

    def _known(self, names: Sequence[str]) -> list[Parameter]:
        """Return parameters by name; an empty list if one is not declared, as in rclpy."""
        return [self.declared[name] for name in names] if self.declared.keys() >= set(names) else []

    def _describe(self, request: Mapping[str, Any], answer: Callable[..., None]) -> None:
        answer(descriptors=[each.descriptor() for each in self._known(request["names"])])

    def _get(self, request: Mapping[str, Any], answer: Callable[..., None]) -> None:
        answer(values=[self._value(each) for each in self._known(request["names"])])

    def _types(self, request: Mapping[str, Any], answer: Callable[..., None]) -> None:
        answer(types=bytes(each.number for each in self._known(request["names"])))

    def _wish(self, asked: Any) -> tuple[list[str], dict[str, Any], dict[str, Any]]:
        """Return for each requested value the reason for a refusal, or empty, and the values: own, others."""
        refused: list[str] = []
        own: dict[str, Any] = {}
        others: dict[str, Any] = {}
        for each in asked:
            name, number = each["name"], each["value"]["type"]
            kind = KINDS[number - 1] if 1 <= number <= len(KINDS) else "not set"
            value = each["value"].get(f"{kind}_value")
            known = self.declared.get(name)
            refused.append(f"{name} is not declared" if known is None else known.refusal(kind, value))
            if known is not None and not refused[-1]:
                (others if known.take is None else own)[name] = value
        return refused, own, others

    def _set(self, request: Mapping[str, Any], answer: Callable[..., None]) -> None:
        names = [each["name"] for each in request["parameters"]]
        refused, own, others = self._wish(request["parameters"])
        self._take(own)

        def done(why: str) -> None:
            reasons = [each or why * (name in others) for each, name in zip(refused, names, strict=True)]
            answer(results=[{"successful": not each, "reason": each} for each in reasons])

        if others:
            self._apply(others, done)
        else:
            done("")

    def _set_atomically(self, request: Mapping[str, Any], answer: Callable[..., None]) -> None:
        refused, own, others = self._wish(request["parameters"])

        def done(why: str) -> None:
            self._take({} if why else own)
            answer(result={"successful": not why, "reason": why})

        why = "; ".join(filter(None, refused))
        if others and not why:
            self._apply(others, done)
        else:
            done(why)
