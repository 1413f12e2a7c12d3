"""DUTs: one structure per message type and set of capacities, plus its constants.

A struct member for every layout member, padding included, so that any pack mode gives the
same offsets. Where one message type occurs with several sets of capacities in a project, the
first (in the order of topics) has the plain name and the others a suffix from their layout.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field

from rosplc.layout import Layout
from rosplc.layout.nodes import (
    ArrayNode,
    Member,
    Node,
    PaddingNode,
    ScalarNode,
    SequenceNode,
    StringNode,
    StructNode,
)
from rosplc.model import TypeStore
from rosplc.model.types import Constant, Field, MessageType, PrimitiveType, Value
from rosplc.plc.literals import IEC_TYPES, literal
from rosplc.plc.names import Scope, type_prefix
from rosplc.plc.project import Dut, Gvl, VarBlock, Variable

__all__ = ["DutBuilder", "MemberNames", "Renaming"]

_MAX_STRING = 32767


@dataclass(frozen=True)
class Renaming:
    """One name that could not stay: where, what it was, what it is."""

    where: str
    wanted: str
    given: str


@dataclass(frozen=True)
class MemberNames:
    """Identifiers of a DUT's members by their index in the struct node."""

    dut: str
    names: tuple[str, ...]

    def of(self, node: StructNode, member: Member) -> str:
        """Return the identifier of a member."""
        return self.names[node.members.index(member)]


@dataclass
class DutBuilder:
    """Collects the DUTs that layouts need, each once, in the order in which they depend.

    Attributes:
        store: Knows default values and constants.
        folder: The folder of everything built.
        scope: Names of the project's objects; who adds objects takes their names from it.
        duts: What has been built.
        constants: Variable lists of the types' constants.
        renamings: Names that had to change.
        omitted: Values that Structured Text cannot write, as sentences.
    """

    store: TypeStore
    folder: str = ""
    scope: Scope = field(default_factory=Scope)
    duts: list[Dut] = field(default_factory=list)
    constants: list[Gvl] = field(default_factory=list)
    renamings: list[Renaming] = field(default_factory=list)
    omitted: list[str] = field(default_factory=list)
    _names: dict[StructNode, MemberNames] = field(default_factory=dict)
    _seen_types: set[str] = field(default_factory=set)

    def add(self, layout: Layout) -> str:
        """Build a layout's DUTs; return the name of the message's own."""
        return self.struct(layout.root).dut

    def struct(self, node: StructNode) -> MemberNames:
        """Build a struct's DUT, after those that it contains."""
        known = self._names.get(node)
        if known:
            return known
        for member in node.members:
            inner = _element(member.node)
            if isinstance(inner, StructNode):
                self.struct(inner)
        message = self.store[node.type_name]
        scope = Scope()
        names = scope.give_all([_wanted(member) for member in node.members])
        wanted = type_prefix(node.type_name)
        plain = wanted
        if node.type_name in self._seen_types:
            wanted += "_" + hashlib.sha256(repr(node).encode()).hexdigest()[:6]
        dut = self.scope.give(wanted)
        result = MemberNames(dut, names)
        self._names[node] = result
        self._note(node, result, plain)
        defaults = {item.name: item for item in message.fields}
        members = tuple(
            Variable(name, self._type(member.node), _initial(member, defaults), self._comment(member))
            for name, member in zip(names, node.members, strict=True)
        )
        self.omitted.extend(
            f"{dut}: the default value of {item.name} is {item.default}, which cannot be written"
            for item in message.fields
            if item.default not in (None, ()) and _literal_of(item.default) is None
        )
        comment = f"{node.type_name}, {node.size} bytes"
        self.duts.append(Dut(dut, members, comment=comment, folder=self.folder))
        if node.type_name not in self._seen_types:
            self._seen_types.add(node.type_name)
            self._constants(message)
        return result

    def _note(self, node: StructNode, names: MemberNames, wanted: str) -> None:
        if names.dut != wanted:
            self.renamings.append(Renaming(f"{node.type_name}, {node.size} bytes", wanted, names.dut))
        for name, member in zip(names.names, node.members, strict=True):
            own = _wanted(member)
            if name != own and not isinstance(member.node, PaddingNode):
                self.renamings.append(Renaming(names.dut, own, name))

    def _type(self, node: Node) -> str:
        if isinstance(node, ScalarNode):
            return IEC_TYPES[node.kind]
        if isinstance(node, StringNode):
            return f"STRING({node.capacity})"
        if isinstance(node, PaddingNode):
            return f"ARRAY[0..{node.size - 1}] OF BYTE"
        if isinstance(node, ArrayNode):
            return f"ARRAY[0..{node.length - 1}] OF {self._type(node.element)}"
        if isinstance(node, SequenceNode):
            return f"ARRAY[0..{node.capacity - 1}] OF {self._type(node.element)}"
        return self.struct(node).dut

    @staticmethod
    def _comment(member: Member) -> str:
        if isinstance(member.node, PaddingNode):
            return ""
        if member.count_of:
            return f"elements of {member.count_of} in use"
        return ""

    def _constants(self, message: MessageType) -> None:
        if not message.constants:
            return
        name = self.scope.give(f"{type_prefix(message.name)}_Const")
        scope = Scope()
        variables = []
        names = scope.give_all([constant.name for constant in message.constants])
        for constant, given in zip(message.constants, names, strict=True):
            value = _constant(constant)
            if value is None:
                self.omitted.append(f"{name}: {constant.name} is {constant.value}, which cannot be written")
                continue
            if given != constant.name:
                self.renamings.append(Renaming(name, constant.name, given))
            variables.append(Variable(given, value[0], value[1]))
        block = VarBlock("VAR_GLOBAL", tuple(variables), constant=True)
        comment = f"Constants of {message.name}"
        self.constants.append(Gvl(name, (block,), (("qualified_only", ""),), comment, self.folder))


def _initial(member: Member, fields: dict[str, Field]) -> str | None:
    """Return a member's initial value; a sequence's default also sets its count."""
    item = fields.get(member.count_of or member.name)
    if item is None or item.default is None or isinstance(member.node, PaddingNode):
        return None
    default: Value = item.default
    if member.count_of:
        return str(len(default)) if isinstance(default, tuple) else None
    element = _element(member.node)
    kind = element.kind if isinstance(element, ScalarNode) else "string"
    if isinstance(member.node, SequenceNode) and isinstance(default, tuple):
        missing = member.node.capacity - len(default)
        text = literal(kind, default)
        if text is None or not missing:
            return text
        zero = "''" if kind == "string" else literal(kind, 0)
        return f"{text[:-1]}, {missing}({zero})]"
    return literal(kind, default)


def _literal_of(value: Value) -> str | None:
    """Return some literal of a value; None where Structured Text has none (infinity, NaN)."""
    items = value if isinstance(value, tuple) else (value,)
    return literal("float64", items) if any(isinstance(item, float) for item in items) else ""


def _constant(constant: Constant) -> tuple[str, str] | None:
    if isinstance(constant.type, PrimitiveType):
        text = literal(constant.type.name, constant.value)
        return (IEC_TYPES[constant.type.name], text) if text is not None else None
    length = min(max(1, len(str(constant.value).encode("utf-8", "surrogateescape"))), _MAX_STRING)
    text = literal("string", constant.value)
    return (f"STRING({length})", text) if text is not None else None


def _wanted(member: Member) -> str:
    """Return what a member is called if nothing speaks against it."""
    if isinstance(member.node, PaddingNode):
        return f"abPad{member.offset}"
    return f"{member.name}_count" if member.count_of else member.name


def _element(node: Node) -> Node:
    return node.element if isinstance(node, (ArrayNode, SequenceNode)) else node
