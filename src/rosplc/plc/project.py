"""A PLC project as data, the common model for every output format, and its objects as Structured Text.

The generator fills these objects; the writers (``.st`` files, PLCopenXML, ScriptEngine
script) only render them, so the three formats cannot differ. Types, initial values and
implementations are Structured Text; everything else is structured data.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal, NamedTuple, TypeAlias

from rosplc.plc.plan import PlcTask

VarBlockKind: TypeAlias = Literal[
    "VAR_INPUT", "VAR_OUTPUT", "VAR_IN_OUT", "VAR", "VAR_TEMP", "VAR_GLOBAL", "VAR_IN_OUT CONSTANT"
]
PouKind: TypeAlias = Literal["FUNCTION_BLOCK", "PROGRAM", "FUNCTION"]


@dataclass(frozen=True, slots=True)
class Variable:
    """One declared variable or struct member."""

    name: str  # the identifier
    type: str  # the type as Structured Text, ``ARRAY[0..5] OF LREAL``
    initial: str | None = None  # the initial value as Structured Text, if any
    comment: str = ""  # one line for people
    # what a function block's FB_Init takes, as Structured Text, in its order: ``(("sTopic",
    # "'/cmd_vel'"),)`` is written ``name : type(sTopic := '/cmd_vel')``
    arguments: tuple[tuple[str, str], ...] = ()


@dataclass(frozen=True, slots=True)
class VarBlock:
    """A ``VAR… END_VAR`` block; ``constant`` adds the CONSTANT qualifier."""

    kind: VarBlockKind
    variables: tuple[Variable, ...]
    constant: bool = False


@dataclass(frozen=True, slots=True)
class Dut:
    """A structure type; ``attributes`` are pragmas such as ``("pack_mode", "8")``."""

    name: str
    members: tuple[Variable, ...]
    attributes: tuple[tuple[str, str], ...] = (("pack_mode", "8"),)
    comment: str = ""
    folder: str = ""


@dataclass(frozen=True, slots=True)
class Enumeration:
    """An enumeration type: names and numbers of type ``base``."""

    name: str
    values: tuple[tuple[str, int], ...]
    base: str
    attributes: tuple[tuple[str, str], ...] = ()
    comment: str = ""
    folder: str = ""


@dataclass(frozen=True, slots=True)
class Gvl:
    """A global variable list."""

    name: str
    blocks: tuple[VarBlock, ...]
    attributes: tuple[tuple[str, str], ...] = ()
    comment: str = ""
    folder: str = ""


@dataclass(frozen=True, slots=True)
class Method:
    """A method of a function block; ``access`` is PUBLIC, PRIVATE or PROTECTED."""

    name: str
    blocks: tuple[VarBlock, ...]
    implementation: str
    return_type: str | None = None
    access: Literal["PUBLIC", "PRIVATE", "PROTECTED"] = "PUBLIC"
    comment: str = ""


@dataclass(frozen=True, slots=True)
class Pou:
    """A function block, program or function."""

    name: str
    kind: PouKind
    blocks: tuple[VarBlock, ...]
    implementation: str
    methods: tuple[Method, ...] = ()
    extends: str | None = None
    abstract: bool = False
    return_type: str | None = None
    attributes: tuple[tuple[str, str], ...] = ()
    comment: str = ""
    folder: str = ""


Item: TypeAlias = "Dut | Enumeration | Gvl | Pou"  # an object of the project


class Task(NamedTuple):
    """A task of the task configuration, with the programs that it calls, in order."""

    task: PlcTask
    programs: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class PlcProject:
    """The complete result of a generation; objects are in order of dependency."""

    name: str  # the top folder's name in the PLC project
    duts: tuple[Dut | Enumeration, ...] = ()
    gvls: tuple[Gvl, ...] = ()
    pous: tuple[Pou, ...] = ()
    tasks: tuple[Task, ...] = ()
    libraries: tuple[str, ...] = ()  # library names to add (``"SysShm"``), as the library manager lists them
    notes: tuple[str, ...] = ()  # what a person should know: renamed identifiers, sizes near a limit
    programs: str = "SharedMemory"  # what the names of the programs begin with

    @property
    def items(self) -> tuple[Item, ...]:
        """All objects."""
        return (*self.duts, *self.gvls, *self.pous)


def _comment(text: str) -> list[str]:
    return [f"// {line}".rstrip() for line in text.splitlines()]


def _attributes(attributes: Iterable[tuple[str, str]]) -> list[str]:
    return [
        f"{{attribute '{name}' := '{value}'}}" if value else f"{{attribute '{name}'}}"
        for name, value in attributes
    ]


def _variable(variable: Variable) -> str:
    arguments = ""
    if variable.arguments:
        arguments = "(" + ", ".join(value for _, value in variable.arguments) + ")"
    initial = f" := {variable.initial}" if variable.initial is not None else ""
    comment = f" // {variable.comment}" if variable.comment else ""
    return f"    {variable.name} : {variable.type}{arguments}{initial};{comment}"


def _blocks(blocks: Iterable[VarBlock]) -> list[str]:
    lines: list[str] = []
    for block in blocks:
        if not block.variables:
            continue
        lines.append(f"{block.kind} CONSTANT" if block.constant else block.kind)
        lines.extend(_variable(variable) for variable in block.variables)
        lines.append("END_VAR")
    return lines


def declaration(item: Item) -> str:
    """Return the declaration part as CODESYS stores it, ending with a line feed."""
    lines = [*_comment(item.comment), *_attributes(item.attributes)]
    if isinstance(item, Dut):
        lines += [f"TYPE {item.name} :", "STRUCT", *map(_variable, item.members), "END_STRUCT", "END_TYPE"]
    elif isinstance(item, Enumeration):
        values = [f"    {name} := {value}" for name, value in item.values]
        lines += [f"TYPE {item.name} :", "(", ",\n".join(values), f") {item.base};", "END_TYPE"]
    elif isinstance(item, Gvl):
        lines += _blocks(item.blocks)
    else:
        head = item.kind + (" ABSTRACT" if item.abstract else "") + f" {item.name}"
        if item.extends:
            head += f" EXTENDS {item.extends}"
        if item.return_type:
            head += f" : {item.return_type}"
        lines += [head, *_blocks(item.blocks)]
    return "\n".join(lines) + "\n"


def method_declaration(method: Method) -> str:
    """Return a method's declaration part as CODESYS stores it, ending with a line feed."""
    head = f"METHOD {method.access} {method.name}"
    if method.return_type:
        head += f" : {method.return_type}"
    return "\n".join([*_comment(method.comment), head, *_blocks(method.blocks)]) + "\n"


def object_text(item: Item) -> str:
    """Return the complete text of an object, as in a ``.st`` file."""
    text = declaration(item)
    if not isinstance(item, Pou):
        return text
    parts = [text + _body(item.implementation) + f"END_{item.kind}\n"]
    parts += [method_declaration(m) + _body(m.implementation) + "END_METHOD\n" for m in item.methods]
    return "\n".join(parts)


def _body(text: str) -> str:
    return f"{text}\n" if text else ""


def project_texts(project: PlcProject) -> dict[str, str]:
    """Return the complete text of every object by name, in the order of the project."""
    return {item.name: object_text(item) for item in project.items}
