"""The program as data: types, blocks, lists and functions, collected from the syntax trees."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import Any

from rosplc_st.translator.source import TranslationError, Unit
from rosplc_st.translator.types import (
    ALIASES,
    ELEMENTARY,
    STRING_DEFAULT,
    Array,
    Block,
    Elementary,
    Pointer,
    String,
    Struct,
    Type,
)

__all__ = ["Callable_", "Declared", "Dut", "FunctionBlock", "Place", "Program", "VariableList", "collect"]

_KINDS = {
    "InputDeclarations": "in",
    "OutputDeclarations": "out",
    "InputOutputDeclarations": "inout",
    "VariableDeclarations": "var",
    "FunctionVariableDeclarations": "var",
    "TemporaryVariableDeclarations": "temp",
}


@dataclass(frozen=True)
class Place:
    """Where a text stands, for messages."""

    file: str
    line: int

    def error(self, what: str) -> TranslationError:
        """Return an error at this place."""
        return TranslationError(what, self.file, self.line)

    def at(self, node: Any, base: int) -> Place:
        """Return the place of a node whose unit begins at line ``base``."""
        line = getattr(getattr(node, "meta", None), "line", None) or getattr(node, "line", None)
        return Place(self.file, base + line - 1) if line else self


@dataclass(frozen=True)
class Declared:
    """A declared variable: in which kind of block, its initial value and FB_Init's arguments."""

    name: str
    kind: str
    type: Type
    initial: Any
    arguments: tuple[Any, ...]
    constant: bool
    place: Place


@dataclass
class Callable_:
    """A function or method."""

    name: str
    place: Place
    base_line: int
    variables: list[Declared]
    returns: Type | None
    body: Any
    access: str = "PUBLIC"
    abstract: bool = False
    owner: str = ""

    @property
    def parameters(self) -> list[Declared]:
        """The variables that a caller gives."""
        return [v for v in self.variables if v.kind in ("in", "out", "inout")]


@dataclass
class Dut:
    """A structure."""

    name: str
    place: Place
    pack: int
    members: list[Declared]


@dataclass
class FunctionBlock:
    """A function block or program."""

    name: str
    place: Place
    base_line: int
    variables: list[Declared]
    body: Any
    base: str = ""
    abstract: bool = False
    is_program: bool = False
    methods: dict[str, Callable_] = field(default_factory=dict)


@dataclass
class VariableList:
    """A global variable list."""

    name: str
    place: Place
    qualified: bool
    variables: list[Declared]
    retained: bool = False


@dataclass
class Program:
    """Everything that was declared; keys are names in capitals."""

    cpu_bits: int
    duts: dict[str, Dut] = field(default_factory=dict)
    blocks: dict[str, FunctionBlock] = field(default_factory=dict)
    lists: dict[str, VariableList] = field(default_factory=dict)
    functions: dict[str, Callable_] = field(default_factory=dict)
    enumerations: dict[str, tuple[Elementary, dict[str, int]]] = field(default_factory=dict)

    def ancestry(self, name: str) -> list[FunctionBlock]:
        """Return a block and what it extends, the base first."""
        chain: list[FunctionBlock] = []
        while name:
            block = self.blocks.get(name)
            if block is None or block in chain:
                raise (chain[-1].place if chain else Place("?", 0)).error(f"EXTENDS {name}: no such block")
            chain.insert(0, block)
            name = block.base
        return chain

    def members(self, name: str) -> list[Declared]:
        """Return a block's variables that live in the instance, the base's first."""
        return [v for block in self.ancestry(name) for v in block.variables if v.kind != "temp"]

    def method(self, block: str, name: str) -> Callable_ | None:
        """Return the method that a call on an instance of ``block`` reaches."""
        for item in reversed(self.ancestry(block)):
            if name in item.methods:
                return item.methods[name]
        return None


class _Collector:
    def __init__(self, program: Program) -> None:
        self.program = program
        self.names: list[str] = []

    def type(self, spec: Any, place: Place) -> Type:
        """Return the type that a specification names; a user's type is settled by `resolve`."""
        kind = type(spec).__name__
        if kind in ("TypeInitialization", "ArrayTypeInitialization", "StringTypeInitialization"):
            return self.type(spec.spec, place)
        if kind in ("IndirectSimpleSpecification", "DataType"):
            inner = self.type(spec.type if kind[0] == "I" else spec.type_name, place)
            if spec.indirection is not None:
                if spec.indirection.reference:
                    raise place.error("REFERENCE TO")
                for _ in range(spec.indirection.pointer_depth):
                    inner = Pointer(inner)
            return inner
        if kind == "SimpleSpecification":
            return self.type(spec.type, place)
        if kind == "InitializedStructure":
            return self.type(spec.name, place)
        if kind == "StringTypeSpecification":
            if str(spec.type_name).upper() != "STRING":
                raise place.error(str(spec.type_name))
            if spec.length is None:
                return String(STRING_DEFAULT)
            length = spec.length.length
            return String(self.literal(getattr(length, "expr", getattr(length, "expression", None)), place))
        if kind == "ArraySpecification":
            element = self.type(spec.type, place)
            for dimension in reversed(spec.subranges):
                if type(dimension).__name__ != "PartialSubrange":
                    raise place.error("ARRAY without literal bounds")
                low, high = self.literal(dimension.start, place), self.literal(dimension.stop, place)
                if high < low:
                    raise place.error(f"ARRAY[{low}..{high}]")
                element = Array(low, high, element)
            return element
        if kind == "Token":
            name = str(spec).upper()
            if name in ALIASES:
                name = ALIASES[name][0 if self.program.cpu_bits == 64 else 1]
            if name == "STRING":
                return String(STRING_DEFAULT)
            return ELEMENTARY.get(name) or Struct(name)
        raise place.error(f"type {kind}")

    @staticmethod
    def literal(node: Any, place: Place) -> int:
        """Return a literal bound or length."""
        negative = type(node).__name__ == "UnaryOperation" and str(node.op) == "-"
        inner = node.expr if negative else node
        if type(inner).__name__ != "Integer":
            raise place.error("a bound or length that is not a literal number")
        value = int(str(inner.value).replace("_", ""))
        return -value if negative else value

    def variables(
        self, block: Any, kind: str, place: Place, base: int, *, retain: bool = False
    ) -> Iterator[Declared]:
        attributes = str(getattr(block, "attrs", "") or "").lower()
        flags = attributes.rpartition(".")[2]
        constant = "constant" in flags
        for odd in ("retain", "persistent"):
            if odd in flags and not retain:
                raise place.at(block, base).error(odd.upper())
        for item in block.items:
            here = place.at(item, base)
            form = type(item).__name__
            if form == "GlobalVariableDeclaration":
                names, located = item.spec.variables, item.spec.location
            elif form in (
                "VariableOneInitDeclaration", "ArrayVariableInitDeclaration", "StringVariableInitDeclaration",
                "StructuredVariableInitDeclaration", "StructureElementDeclaration",
            ):  # fmt: skip
                names = [v.variable.name for v in item.variables]
                located = next((v.location for v in item.variables if v.location), None)
            else:
                raise here.error(f"declaration {form}")
            if located is not None:
                raise here.error("AT")
            init = item.init
            initial = getattr(
                init, "init" if type(init).__name__ == "InitializedStructure" else "value", None
            )
            arguments = getattr(getattr(init, "spec", None), "init_parameters", None) or ()
            if type(init).__name__ == "FunctionCall":
                arguments, initial = init.parameters, None
                type_ = self.type(init.name.name, here)
            else:
                type_ = self.type(init, here)
            for name in names:
                yield Declared(str(name).upper(), kind, type_, initial, tuple(arguments), constant, here)

    def blocks(self, item: Any, place: Place, base: int) -> list[Declared]:
        found: list[Declared] = []
        for block in item.declarations or ():
            kind = _KINDS.get(type(block).__name__)
            if kind is None:
                raise place.at(block, base).error(f"variables {type(block).__name__}")
            found.extend(self.variables(block, kind, place, base))
        seen: set[str] = set()
        for variable in found:
            if variable.name in seen:
                raise variable.place.error(f"{variable.name} is declared twice")
            seen.add(variable.name)
        return found

    def callable(self, item: Any, place: Place, base: int) -> Callable_:
        access = str(item.access or "").lower().rpartition(".")[2]
        level = next(
            (w.upper() for w in ("private", "protected", "internal", "final") if w in access), "PUBLIC"
        )
        if level in ("INTERNAL", "FINAL"):
            raise place.error(level)
        returns = self.type(item.return_type, place) if item.return_type is not None else None
        name = str(item.name).upper()
        variables = self.blocks(item, place, base)
        if any(v.name == name for v in variables):
            raise place.error(f"{name} is declared in {name}")
        return Callable_(name, place, base, variables, returns, item.body, level, "abstract" in access)

    def add(self, unit: Unit, items: Iterable[Any], owner: FunctionBlock | None) -> FunctionBlock | None:
        """Add a unit's objects; return the block that methods after it belong to."""
        for item in items:
            kind = type(item).__name__
            place = Place(unit.file, unit.line).at(item, unit.line)
            if kind == "DataTypeDeclaration":
                self.dut(unit, item.declaration, place)
            elif kind in ("FunctionBlock", "Program"):
                owner = self.block(unit, item, place)
            elif kind == "Method":
                if owner is None:
                    raise place.error("METHOD outside a function block")
                method = self.callable(item, place, unit.line)
                method.owner = owner.name
                if method.name in owner.methods:
                    raise place.error(f"method {method.name} is declared twice")
                owner.methods[method.name] = method
            elif kind == "Function":
                function = self.callable(item, place, unit.line)
                self.new(function.name, place)
                self.program.functions[function.name] = function
            elif kind == "GlobalVariableDeclarations":
                self.variable_list(unit, item, place)
            else:
                raise place.error(f"object {kind}")
        return owner

    def new(self, name: str, place: Place) -> None:
        if name in self.names:
            raise place.error(f"{name} is declared twice")
        self.names.append(name)

    def enumeration(self, item: Any, place: Place) -> None:
        """Keep an enumeration's names and numbers; each needs a number, and a type is named."""
        name = str(item.name).upper()
        self.new(name, place)
        given = item.init.spec
        base = ELEMENTARY.get(str(given.type_name).upper())
        if base is None or not base.integral:
            raise place.error(f"{name}: an enumeration without an integer type")
        values = {str(v.name).upper(): self.literal(v.value, place) for v in given.values}
        if len(values) != len(given.values):
            raise place.error(f"{name}: a name is declared twice")
        self.program.enumerations[name] = (base, values)

    def dut(self, unit: Unit, item: Any, place: Place) -> None:
        if type(item).__name__ == "EnumeratedTypeDeclaration":
            self.enumeration(item, place)
            return
        if type(item).__name__ != "StructureTypeDeclaration" or item.extends or item.indirection:
            raise place.error(f"type {type(item).__name__}")
        name = str(item.name).upper()
        self.new(name, place)
        pack = int(dict(unit.attributes).get("pack_mode", "8"))

        class Members:
            attrs = None
            items = item.declarations

        members = list(self.variables(Members, "var", place, unit.line))
        if not members:
            raise place.error(f"{name}: a structure without members")
        if len({m.name for m in members}) != len(members):
            raise place.error(f"{name}: a member is declared twice")
        self.program.duts[name] = Dut(name, place, pack, members)

    def block(self, unit: Unit, item: Any, place: Place) -> FunctionBlock:
        name = str(item.name).upper()
        self.new(name, place)
        if getattr(item, "implements", None):
            raise place.error("IMPLEMENTS")
        extends = getattr(item, "extends", None)
        abstract = "abstract" in str(getattr(item, "access", "") or "").lower()
        block = FunctionBlock(
            name, place, unit.line, self.blocks(item, place, unit.line), item.body,
            str(extends.interfaces[0]).upper() if extends else "", abstract, type(item).__name__ == "Program",
        )  # fmt: skip
        self.program.blocks[name] = block
        return block

    def variable_list(self, unit: Unit, item: Any, place: Place) -> None:
        name = unit.file.upper()
        qualified = "qualified_only" in dict(unit.attributes)
        known = self.program.lists.get(name)
        if known is None:
            self.new(name, place)
            known = self.program.lists[name] = VariableList(name, place, qualified, [])
        known.variables += self.variables(item, "var", place, unit.line, retain=True)
        known.retained = known.retained or "retain" in str(item.attrs or "").lower()

    def resolve(self) -> None:
        """Settle which of the user's types are structures and which are blocks; check that all exist."""
        program = self.program

        def settle(type_: Type, place: Place, inner: bool = False) -> Type:
            if isinstance(type_, Pointer) and type_.target is not None:
                return Pointer(settle(type_.target, place, True))
            if isinstance(type_, Array):
                return Array(type_.low, type_.high, settle(type_.element, place, inner))
            if isinstance(type_, Struct) and type_.name in program.enumerations:
                return program.enumerations[type_.name][0]
            if isinstance(type_, Struct) and type_.name not in program.duts:
                if type_.name not in program.blocks:
                    raise place.error(f"unknown type {type_.name}")
                if program.blocks[type_.name].abstract and not inner:
                    raise place.error(f"an instance of {type_.name}, which is ABSTRACT")
                return Block(type_.name)
            return type_

        def mend(variables: list[Declared]) -> None:
            for index, v in enumerate(variables):
                variables[index] = Declared(
                    v.name, v.kind, settle(v.type, v.place), v.initial, v.arguments, v.constant, v.place
                )

        callables = [*program.functions.values()]
        for block in program.blocks.values():
            mend(block.variables)
            callables += block.methods.values()
        for item in callables:
            mend(item.variables)
            item.returns = settle(item.returns, item.place) if item.returns is not None else None
        for dut in program.duts.values():
            mend(dut.members)
        for variables in program.lists.values():
            mend(variables.variables)
            if variables.retained and not all(isinstance(v.type, Block) for v in variables.variables):
                raise variables.place.error("RETAIN of something that is no function block")
        for block in program.blocks.values():
            seen: set[str] = set()
            for variable in program.members(block.name):
                if variable.name in seen:
                    raise block.place.error(f"{block.name}: {variable.name} hides a variable of its base")
                seen.add(variable.name)


def collect(parsed: Iterable[tuple[Unit, list[Any]]], cpu_bits: int) -> Program:
    """Return everything that the trees declare."""
    collector = _Collector(Program(cpu_bits))
    owner: FunctionBlock | None = None
    file = ""
    for unit, items in parsed:
        if unit.file != file:
            owner, file = None, unit.file
        owner = collector.add(unit, items, owner)
    collector.resolve()
    return collector.program
