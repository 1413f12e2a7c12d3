"""Read the hand-written Structured Text of ``templates/base`` into the project model.

The base blocks are written as a person writes them; PLCopenXML needs their declarations one
by one. This reader understands exactly the form used there (one declaration a line, comments
after ``//``) and fails on anything else, so that nothing is lost silently.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from importlib.resources import files
from typing import Literal, cast

from rosplc.plc.project import Dut, Gvl, Method, Pou, PouKind, VarBlock, VarBlockKind, Variable

__all__ = ["base_objects", "parse_object", "read_objects"]

_ORDER = (
    "RosPlc_WriterLine", "RosPlc_ReaderLine", "RosPlc_Header", "RosPlc_SlotHeader",
    "RosPlc_State", "RosPlc_Fence", "RosPlc_Advance", "RosPlc_Distance",
    "RosPlc_Channel", "RosPlc_Reader", "RosPlc_Writer",
)  # fmt: skip

_DECLARATION = re.compile(
    r"(?P<name>\w+) : (?P<type>[^:;]+?)(?: := (?P<initial>[^;]+))?;(?: // (?P<comment>.*))?\Z"
)
_ATTRIBUTE = re.compile(r"\{attribute '(?P<name>\w+)'(?: := '(?P<value>[^']*)')?\}\Z")
_HEAD = re.compile(
    r"(?P<kind>FUNCTION_BLOCK|FUNCTION|PROGRAM)(?P<abstract> ABSTRACT)? (?P<name>\w+)"
    r"(?: EXTENDS (?P<base>\w+))?(?: : (?P<type>\w+))?\Z"
)
_METHOD = re.compile(r"METHOD (?P<access>PUBLIC|PRIVATE|PROTECTED) (?P<name>\w+)(?: : (?P<type>.+))?\Z")
_BLOCK = re.compile(r"(?P<kind>VAR(?:_INPUT|_OUTPUT|_IN_OUT|_TEMP|_GLOBAL)?)(?P<constant> CONSTANT)?\Z")


def base_objects(folder: str) -> tuple[Dut | Gvl | Pou, ...]:
    """Return the hand-written objects, in the order in which they depend on each other."""
    return read_objects("base", _ORDER, folder)


def read_objects(templates: str, names: Iterable[str], folder: str) -> tuple[Dut | Gvl | Pou, ...]:
    """Return the named objects of a folder below ``templates/``, for ``folder`` in the PLC project."""
    root = files("rosplc.plc").joinpath(f"templates/{templates}")
    return tuple(parse_object(root.joinpath(f"{n}.st").read_text(encoding="ascii"), n, folder) for n in names)


def parse_object(text: str, name: str, folder: str = "") -> Dut | Gvl | Pou:
    """Return the object that a file of ``templates/`` holds; ``name`` is the file's.

    Raises:
        ValueError: The text is not of the form that the templates keep to.
    """
    lines = [line.rstrip() for line in text.splitlines()]
    comment, attributes, rest = _preamble(lines)
    first = rest[0] if rest else ""
    if first == f"TYPE {name} :":
        if rest[1] != "STRUCT" or rest[-2:] != ["END_STRUCT", "END_TYPE"]:
            raise ValueError(f"{name}: not a structure")
        return Dut(name, tuple(_variable(line, name) for line in rest[2:-2]), attributes, comment, folder)
    if first.startswith("VAR_GLOBAL"):
        blocks, after = _blocks(rest, name)
        if after:
            raise ValueError(f"{name}: text after the variables")
        return Gvl(name, blocks, attributes, comment, folder)
    return _pou(rest, name, comment, attributes, folder)


def _preamble(lines: list[str]) -> tuple[str, tuple[tuple[str, str], ...], list[str]]:
    comments: list[str] = []
    attributes: list[tuple[str, str]] = []
    for index, line in enumerate(lines):
        match = _ATTRIBUTE.match(line)
        if match:
            attributes.append((match["name"], match["value"] or ""))
        elif line.startswith("// "):
            comments.append(line[3:])
        elif line:
            return "\n".join(comments), tuple(attributes), lines[index:]
    raise ValueError("no object in the text")


def _variable(line: str, where: str) -> Variable:
    match = _DECLARATION.match(line.strip())
    if not match:
        raise ValueError(f"{where}: not a declaration: {line!r}")
    return Variable(match["name"], match["type"], match["initial"], match["comment"] or "")


def _blocks(lines: list[str], where: str) -> tuple[tuple[VarBlock, ...], list[str]]:
    """Split the leading variable blocks from what follows."""
    blocks: list[VarBlock] = []
    index = 0
    while index < len(lines) and (match := _BLOCK.match(lines[index])):
        end = lines.index("END_VAR", index)
        variables = tuple(_variable(line, where) for line in lines[index + 1 : end])
        blocks.append(VarBlock(cast(VarBlockKind, match["kind"]), variables, bool(match["constant"])))
        index = end + 1
    return tuple(blocks), lines[index:]


def _pou(
    lines: list[str], name: str, comment: str, attributes: tuple[tuple[str, str], ...], folder: str
) -> Pou:
    head = _HEAD.match(lines[0])
    if not head or head["name"] != name:
        raise ValueError(f"{name}: not the head of an object: {lines[0]!r}")
    end = lines.index(f"END_{head['kind']}")
    blocks, body = _blocks(lines[1:end], name)
    return Pou(
        name,
        cast(PouKind, head["kind"]),
        blocks,
        "\n".join(body),
        methods=tuple(_methods(lines[end + 1 :], name)),
        extends=head["base"],
        abstract=bool(head["abstract"]),
        return_type=head["type"],
        attributes=attributes,
        comment=comment,
        folder=folder,
    )


def _methods(lines: list[str], where: str) -> list[Method]:
    methods: list[Method] = []
    while any(lines):
        comment, _, rest = _preamble(lines)
        head = _METHOD.match(rest[0])
        if not head:
            raise ValueError(f"{where}: not the head of a method: {rest[0]!r}")
        end = rest.index("END_METHOD")
        blocks, body = _blocks(rest[1:end], f"{where}.{head['name']}")
        access = cast(Literal["PUBLIC", "PRIVATE", "PROTECTED"], head["access"])
        methods.append(Method(head["name"], blocks, "\n".join(body), head["type"], access, comment))
        lines = rest[end + 1 :]
    return methods
