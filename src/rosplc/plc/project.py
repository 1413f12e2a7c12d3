"""A PLC project as data: the one model behind every delivery.

The generator fills these objects; the writers (``.st`` files, PLCopenXML, ScriptEngine
script) only render them, so that the three deliveries cannot disagree. Types, initial values
and implementations are Structured Text; everything else is structure.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias

__all__ = [
    "Dut",
    "Enumeration",
    "Gvl",
    "Item",
    "Method",
    "PlcProject",
    "Pou",
    "PouKind",
    "Task",
    "VarBlock",
    "VarBlockKind",
    "Variable",
]

VarBlockKind: TypeAlias = Literal[
    "VAR_INPUT", "VAR_OUTPUT", "VAR_IN_OUT", "VAR", "VAR_TEMP", "VAR_GLOBAL", "VAR_IN_OUT CONSTANT"
]
PouKind: TypeAlias = Literal["FUNCTION_BLOCK", "PROGRAM", "FUNCTION"]


@dataclass(frozen=True, slots=True)
class Variable:
    """One declared variable or struct member.

    Attributes:
        name: The identifier.
        type: The type as Structured Text, ``ARRAY[0..5] OF LREAL``.
        initial: The initial value as Structured Text, if any.
        comment: One line for people.
        arguments: What a function block's FB_Init takes, as Structured Text, in its order:
            ``(("sTopic", "'/cmd_vel'"),)`` is written ``name : type(sTopic := '/cmd_vel')``.
    """

    name: str
    type: str
    initial: str | None = None
    comment: str = ""
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


Item: TypeAlias = "Dut | Enumeration | Gvl | Pou"
"""An object of the project."""


@dataclass(frozen=True, slots=True)
class Task:
    """A task of the task configuration.

    Attributes:
        name: Its name in the task configuration.
        kind: ``"cyclic"`` or ``"freewheeling"``.
        interval_us: The cycle time in microseconds; 0 for a freewheeling task.
        priority: 0 (highest) to 31.
        watchdog_us: The watchdog time in microseconds; 0 for none.
        watchdog_sensitivity: How many excesses in a row raise it.
        programs: The programs that it calls, in order.
    """

    name: str
    kind: Literal["cyclic", "freewheeling"]
    interval_us: int
    priority: int
    watchdog_us: int = 0
    watchdog_sensitivity: int = 1
    programs: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class PlcProject:
    """Everything that a generation produces; objects stand in the order in which they depend.

    Attributes:
        name: The top folder's name in the PLC project.
        libraries: Library names to add (``"SysShm"``), as the library manager lists them.
        notes: What a person should know: renamed identifiers, sizes near a limit.
        programs: What the names of the programs begin with.
    """

    name: str
    duts: tuple[Dut | Enumeration, ...] = ()
    gvls: tuple[Gvl, ...] = ()
    pous: tuple[Pou, ...] = ()
    tasks: tuple[Task, ...] = ()
    libraries: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    programs: str = "SharedMemory"

    @property
    def items(self) -> tuple[Item, ...]:
        """Every object."""
        return (*self.duts, *self.gvls, *self.pous)
