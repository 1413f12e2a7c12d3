"""The parameters of the bridge's node as two topics of the PLC: what ROS wants, and what holds.

Both have one message, which is made from the configuration: the number of a set, and a field per parameter. A
set has taken effect when the PLC's message shows its number.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import yaml

from rosplc.config.file import Config
from rosplc.config.yaml_source import Problems
from rosplc.errors import ConfigError, RosplcError
from rosplc.layout import Layout, Limits, compute_layout
from rosplc.model import TypeStore
from rosplc.ros.parameters import Parameter, converted

if TYPE_CHECKING:
    from rosplc.config.settings import ParameterSettings

WANTED, CURRENT = "/parameters/wanted", "/parameters/current"  # as the objects' names have them
TYPE = "rosplc_parameters/msg/Set"
_SEPARATOR = "=" * 80
_FIELD_TYPES = {"bool": "bool", "integer": "int64", "double": "float64", "string": "string", "byte": "byte"}


@dataclass(frozen=True)
class ParametersPlan:
    """The parameters with everything decided."""

    declared: tuple[Parameter, ...]
    fields: dict[str, str]  # a parameter's name → its field in the PLC's message
    initial: Literal["file", "plc"]  # whose values hold where there are none from before
    task: str  # name of the PLC task
    layout: Layout  # of the message of both topics


def parameters_plan(config: Config, store: TypeStore, problems: Problems) -> ParametersPlan | None:
    """Return the plan of the configuration's parameters, None if there are none; what is wrong is noted."""
    asked, settings = config.settings.parameters, config.settings
    if not asked.declare:
        return None
    key, found = ("parameters", "declare"), len(problems)
    fields: dict[str, str] = {}
    declared: list[Parameter] = []
    capacities: dict[str, int] = {}
    for name, entry in asked.declare.items():
        # ROS has no capital letters, no double and no last underscores in names of fields.
        field = re.sub(r"_+", "_", name.replace(".", "_").lower()).rstrip("_")
        same = next((other for other, known in fields.items() if known == field), "")
        if same:
            problems.wrong(config.source, (*key, name), f"{name} and {same} are both {field} in the PLC")
        above = next((other for other in asked.declare if name.startswith(f"{other}.")), "")
        if above and store.ros_version == 1:
            problems.wrong(config.source, (*key, name), f"in ROS 1, {above} cannot also be a namespace")
        fields[name] = field
        most, longest = entry.capacity or settings.limits.sequence, entry.length or settings.limits.string
        if entry.type.endswith("_array"):
            capacities[f"values.{field}"] = most
        if entry.type.startswith("string"):
            capacities[f"values.{field}" + "[]" * entry.type.endswith("_array")] = longest
        try:
            declared.append(_parameter(name, entry, most, longest))
        except ValueError as error:
            problems.wrong(config.source, (*key, name), str(error))
    task = config.task(asked.task, ("parameters", "task"), problems)
    if len(problems) > found:
        return None
    lines = (f"{_field_type(each.kind, store)} {fields[each.name]}\n" for each in declared)
    text = f"uint64 number\nValues values\n{_SEPARATOR}\nMSG: rosplc_parameters/Values\n{''.join(lines)}"
    try:
        layout = compute_layout(store.with_definition(TYPE, text), TYPE, Limits(fields=capacities))
    except RosplcError as error:
        problems.move(error, config.source, key)
        return None
    return ParametersPlan(tuple(declared), fields, asked.initial, task, layout)


def _field_type(kind: str, store: TypeStore) -> str:
    element = _FIELD_TYPES[kind.removesuffix("_array")]
    if store.ros_version == 1 and element == "byte":
        element = "uint8"  # ROS 1's byte has a sign
    return element + "[]" * kind.endswith("_array")


def _parameter(name: str, entry: ParameterSettings, most: int, longest: int) -> Parameter:
    """Return a parameter; ValueError with what is wrong."""
    kind = entry.type.removesuffix("_array")
    span: tuple[float, float, float] | None = None
    if entry.range is not None:
        if entry.type not in ("integer", "double"):
            raise ValueError(f"a parameter of type {entry.type} cannot have a range")
        least, greatest, step = (converted(entry.type, each) for each in (*entry.range, 0)[:3])
        if not least <= greatest or step < 0:
            raise ValueError(f"the range {list(entry.range)} is empty or has a negative step")
        span = least, greatest, step
    value = entry.value
    if value is None:
        value = [] if kind != entry.type else {"bool": False, "string": ""}.get(kind, 0)
    found = Parameter(name, entry.type, None, entry.description, entry.read_only, span, most, longest)
    return replace(found, value=found.fitting(value))


def given_values(arguments: Iterable[str], node: str, declared: Iterable[Parameter]) -> dict[str, Any]:
    """Return what ``-p`` and ``--params-file`` make of a node's parameters; ``node`` is its full name.

    As in rclpy, names that are not declared are ignored. Raises ConfigError CFG011 for an impossible value.
    """
    values: dict[str, Any] = {}
    words = iter(arguments)
    for word in words:
        if word == "--params-file":
            values |= _from_file(Path(next(words)), node)
        elif word == "-p":
            rule, _, text = next(words).partition(":=")
            which, _, name = rule.rpartition(":")
            if which in ("", node.rpartition("/")[2]):
                values[name.replace("/", ".")] = _yaml(text, f"-p {rule}")
    found = {}
    for each in declared:
        if each.name in values:
            try:
                found[each.name] = each.fitting(values[each.name])
            except ValueError as error:
                raise _refuse(each.name, str(error)) from None
    return found


def _refuse(what: str, why: str) -> ConfigError:
    return ConfigError("CFG011", f"{what}: {why}", where="command line")


def _yaml(text: str, what: str) -> Any:
    try:
        return yaml.safe_load(text)
    except (yaml.YAMLError, RecursionError) as error:
        raise _refuse(what, f"not valid YAML: {' '.join(str(error).split())}") from None


def _from_file(path: Path, node: str) -> dict[str, Any]:
    """Return the parameters of a node from a file; ``*`` is one part of its name there, ``**`` any."""
    try:
        data = _yaml(path.read_text(), f"--params-file {path}")
    except (OSError, UnicodeError) as error:
        raise _refuse(f"--params-file {path}", str(error)) from None
    found: dict[str, Any] = {}
    for name, value in _flat(data):
        pattern, marker, parameter = name.partition("/ros__parameters/")
        expression = re.escape("/" + pattern.strip("/")).replace(r"/\*\*", "(/.*)?").replace(r"\*", "[^/]*")
        if marker and re.fullmatch(expression, node):
            found[parameter.replace("/", ".")] = value
    return found


def _flat(data: Any) -> Iterator[tuple[str, Any]]:
    for key, value in data.items() if isinstance(data, dict) else ():
        if isinstance(value, dict):
            yield from ((f"{key}/{name}", inner) for name, inner in _flat(value))
        else:
            yield str(key), value
