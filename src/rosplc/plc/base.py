"""Structured Text templates: rendered by jinja2, and read into the project model.

PLCopenXML needs individual declarations, so the reader accepts only the form used by the templates (one
declaration per line, comments after ``//``) and fails on anything else: nothing is lost silently.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache
from importlib.resources import files
from typing import Any, Literal, cast

import jinja2

from rosplc.config.transforms import TransformError
from rosplc.errors import CODES
from rosplc.layout import compute_layout
from rosplc.model import TypeStore
from rosplc.plc import project
from rosplc.plc.names import string_literal
from rosplc.plc.types import DutBuilder
from rosplc.shm import constants

_BASE = (
    "RosPlc_Error", "RosPlc_WriterLine", "RosPlc_ReaderLine", "RosPlc_Header", "RosPlc_SlotHeader",
    "RosPlc_Format", "RosPlc_State", "RosPlc_ErrorText", "RosPlc_Fence", "RosPlc_Fenced", "RosPlc_Advance",
    "RosPlc_Distance", "RosPlc_Block", "RosPlc_Channel", "RosPlc_Reader", "RosPlc_Writer",
)  # fmt: skip
CALL_NAMES = (
    "RosPlc_Reason", "RosPlc_Call", "RosPlc_Part", "RosPlc_CallReader", "RosPlc_CallWriter",
    "RosPlc_CallBlock", "RosPlc_Caller", "RosPlc_Client", "RosPlc_Answerer", "RosPlc_Server",
)  # fmt: skip
ACTION_NAMES = ("RosPlc_GoalStatus", "RosPlc_ActionClient", "RosPlc_ActionServer")
CLASSIC_NAMES = ("RosPlc_ClassicState", "RosPlc_Classic", "RosPlc_ClassicReader", "RosPlc_ClassicWriter")
"""Names that no generated object may take, whether or not a project has classic topics."""
OWN_NAMES = {
    "log": ("RosPlc_LogWriter", "RosPlc_LogLevel", "RosPlc_Log"),
    "pose": ("RosPlc_Pose", "RosPlc_TransformError"),
    "time": ("RosPlc_Time",),
}
"""The objects for each of the bridge's own topics; the first is the type of its instance."""
_OF_BRIDGES = (
    "DESCRIPTION", "OTHER_BRIDGE", "OTHER_USER", "REPLACED", "NOT_PLAIN_FILE", "READ_ONLY", "DIRECTORY",
    "MEMORY_SIZE", "LOCK_FREED", "SEMAPHORE_COUNT", "SEMAPHORE_WORD_SIZE",
)  # fmt: skip
"""Errors that no PLC block reports."""
_COMMON = {
    "constants": {
        **{name: value for name, value in vars(constants).items() if isinstance(value, int)},
        **{direction.name: direction.value for direction in constants.Direction},
    },
    "bit_patterns": ("FNV_OFFSET", "FNV_PRIME", "CRC_POLYNOMIAL"),
    "errors": tuple(number for number in constants.ErrorNumber if number.name not in _OF_BRIDGES),
    "reasons": tuple(constants.Reason),
    "transform_errors": tuple(TransformError),
    "titles": {number.value: CODES[f"SHM{number.value}"].title for number in constants.ErrorNumber},
}


@cache
def _environment() -> jinja2.Environment:
    environment = jinja2.Environment(
        loader=jinja2.FunctionLoader(
            lambda name: files("rosplc.plc").joinpath(f"templates/{name}").read_text(encoding="ascii")
        ),
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        undefined=jinja2.StrictUndefined,
    )
    environment.filters["literal"] = string_literal
    return environment


def render(template: str, **values: Any) -> str:
    """Return a template's text; ``template`` is a path below ``templates/``."""
    return _environment().get_template(template).render(**_COMMON, **values)


def base_objects(folder: str) -> tuple[project.Item, ...]:
    """Return the objects that every project has, in order of dependency."""
    return read_objects("base", _BASE, folder)


def classic_objects(folder: str) -> tuple[project.Item, ...]:
    """Return the objects that classic blocks extend."""
    return read_objects("classic", CLASSIC_NAMES, folder)


def call_objects(folder: str, *, actions: bool) -> tuple[project.Item, ...]:
    """Return the objects that the blocks of services and, with ``actions``, of actions extend."""
    return read_objects("calls", CALL_NAMES + ACTION_NAMES * actions, folder)


def read_objects(
    templates: str, names: Iterable[str], folder: str, **values: Any
) -> tuple[project.Item, ...]:
    """Return the named objects of a folder below ``templates/``, for ``folder`` in the PLC project."""
    return tuple(parse_object(render(f"{templates}/{name}.st", **values), name, folder) for name in names)


def parse_object(text: str, name: str, folder: str = "") -> project.Item:
    """Parse the text of an object; ValueError if it does not have the form used by the templates."""
    comment, attributes, rest = _preamble([line.rstrip() for line in text.rstrip().splitlines()])
    if rest[0] == f"TYPE {name} :" and rest[-1] == "END_TYPE":
        if (rest[1], rest[-2]) == ("STRUCT", "END_STRUCT"):
            return project.Dut(
                name, tuple(_variable(line, name) for line in rest[2:-2]), attributes, comment, folder
            )
        if rest[1] == "(" and rest[-2].startswith(") "):
            values = tuple(_enumerator(line, name) for line in rest[2:-2])
            return project.Enumeration(name, values, rest[-2][2:].rstrip(";"), attributes, comment, folder)
    if rest[0].startswith("VAR_GLOBAL"):
        blocks, after = _blocks(rest, name)
        if not after:
            return project.Gvl(name, blocks, attributes, comment, folder)
    return _pou(rest, name, comment, attributes, folder)


def _preamble(lines: list[str]) -> tuple[str, tuple[tuple[str, str], ...], list[str]]:
    comments: list[str] = []
    attributes: list[tuple[str, str]] = []
    for index, line in enumerate(lines):
        if line.startswith("{attribute '"):
            attribute, _, value = line[12:].rstrip("}").partition(" := ")
            attributes.append((attribute.rstrip("'"), value.strip("'")))
        elif line.startswith("// "):
            comments.append(line[3:])
        elif line:
            return "\n".join(comments), tuple(attributes), lines[index:]
    raise ValueError("the text contains no object")


def _enumerator(line: str, where: str) -> tuple[str, int]:
    name, _, value = line.strip().rstrip(",").partition(" := ")
    if not value:
        raise ValueError(f"{where}: not an enumeration value: {line!r}")
    return name, int(value)


def _variable(line: str, where: str) -> project.Variable:
    code, _, comment = line.strip().partition("; // ")
    declared, _, initial = code.removesuffix(";").partition(" := ")
    name, _, type_ = declared.partition(" : ")
    if type_.endswith("('')"):  # a channel's block, which learns its topic later
        return project.Variable(name, type_.removesuffix("('')"), None, comment, (("sTopic", "''"),))
    if not type_ or not name.isidentifier() or ";" in code[:-1] or not (comment or code.endswith(";")):
        raise ValueError(f"{where}: not a declaration: {line!r}")
    return project.Variable(name, type_, initial or None, comment)


def _blocks(lines: list[str], where: str) -> tuple[tuple[project.VarBlock, ...], list[str]]:
    """Split the leading variable blocks from what follows."""
    blocks: list[project.VarBlock] = []
    while lines and lines[0].startswith("VAR"):
        end = lines.index("END_VAR")
        kind, _, constant = lines[0].partition(" ")
        variables = tuple(_variable(line, where) for line in lines[1:end])
        blocks.append(project.VarBlock(cast(project.VarBlockKind, kind), variables, constant == "CONSTANT"))
        lines = lines[end + 1 :]
    return tuple(blocks), lines


def _pou(
    lines: list[str], name: str, comment: str, attributes: tuple[tuple[str, str], ...], folder: str
) -> project.Pou:
    kind, *words = lines[0].split()
    if kind not in ("FUNCTION_BLOCK", "FUNCTION", "PROGRAM"):
        raise ValueError(f"{name}: not an object: {lines[0]!r}")
    abstract = words[:1] == ["ABSTRACT"]
    words = words[abstract:]
    extends = words[2] if words[1:2] == ["EXTENDS"] else None
    returns = words[2] if words[1:2] == [":"] else None
    if words[:1] != [name] or len(words) != (3 if extends or returns else 1) or f"END_{kind}" not in lines:
        raise ValueError(f"{name}: not a valid object header: {lines[0]!r}")
    end = lines.index(f"END_{kind}")
    blocks, body = _blocks(lines[1:end], name)
    return project.Pou(
        name,
        cast(project.PouKind, kind),
        blocks,
        "\n".join(body),
        methods=tuple(_methods(lines[end + 1 :], name)),
        extends=extends,
        abstract=abstract,
        return_type=returns,
        attributes=attributes,
        comment=comment,
        folder=folder,
    )


def _methods(lines: list[str], where: str) -> Iterable[project.Method]:
    while any(lines):
        comment, _, rest = _preamble(lines)
        head, _, returns = rest[0].partition(" : ")
        words = head.split()
        if words[:1] != ["METHOD"] or len(words) != 3:
            raise ValueError(f"{where}: not a valid method header: {rest[0]!r}")
        end = rest.index("END_METHOD")
        blocks, body = _blocks(rest[1:end], f"{where}.{words[2]}")
        access = cast(Literal["PUBLIC", "PRIVATE", "PROTECTED"], words[1])
        yield project.Method(words[2], blocks, "\n".join(body), returns or None, access, comment)
        lines = rest[end + 1 :]


# Message type that a helper uses → the helpers, each after those that it calls.
_TIMES = (
    "RosPlc_TimeToLtime", "RosPlc_LtimeToTime", "RosPlc_TimeToLdt", "RosPlc_LdtToTime",
)  # fmt: skip
_DURATIONS = ("RosPlc_DurationToTime", "RosPlc_TimeToDuration")
_ANGLES = (
    "RosPlc_YawPitchRoll", "RosPlc_Atan2", "RosPlc_QuaternionToYpr", "RosPlc_YprToQuaternion",
)  # fmt: skip
_GENERAL = ("RosPlc_Handshake", "RosPlc_HandshakeReply")
_HELPERS = {
    "builtin_interfaces/msg/Time": _TIMES,
    "builtin_interfaces/msg/Duration": _DURATIONS,
    "geometry_msgs/msg/Quaternion": _ANGLES,
}
HELPER_NAMES = (*_GENERAL, *_TIMES, *_DURATIONS, *_ANGLES)
"""Names that no generated object may take, whether or not the helper is part of a project."""


def helper_objects(store: TypeStore, builder: DutBuilder, folder: str) -> tuple[project.Item, ...]:
    """Return the helpers whose message types are in ``store``; ``builder`` builds these types."""
    names: list[str] = list(_GENERAL)
    for type_name, helpers in _HELPERS.items():
        if type_name in store:
            builder.add(compute_layout(store, type_name))
            names += helpers
    return read_objects("helpers", tuple(names), folder)
