"""DUTs: one structure per message type and set of capacities, with its constants and initial values.

Each layout member, including padding, has a struct member, so any pack mode gives the same
offsets. If a message type is used with several sets of capacities in a project, the first
(in the order of topics) gets the plain name, the others a suffix derived from their layout.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from rosplc.layout import Layout, nodes
from rosplc.model import TypeStore
from rosplc.model.types import Constant, Field, MessageType, PrimitiveType, Value
from rosplc.plc.names import IEC_TYPES, Scope, literal, type_prefix
from rosplc.plc.project import Dut, Gvl, VarBlock, Variable

_MAX_STRING = 32767


@dataclass(frozen=True)
class MemberNames:
    """The identifiers of a DUT's members, by their index in the struct node."""

    dut: str
    names: tuple[str, ...]

    def of(self, node: nodes.StructNode, member: nodes.Member) -> str:
        """Return the identifier of a member."""
        return self.names[node.members.index(member)]


@dataclass
class DutBuilder:
    """Collects the DUTs that layouts need, each once, in order of dependency."""

    store: TypeStore  # knows default values and constants
    folder: str = ""  # the folder of everything built
    # names of the project's objects; who adds objects takes their names from it
    scope: Scope = field(default_factory=Scope)
    duts: list[Dut] = field(default_factory=list)  # what has been built
    constants: list[Gvl] = field(default_factory=list)  # variable lists of the types' constants
    renamings: list[str] = field(default_factory=list)  # names that had to change, as sentences
    omitted: list[str] = field(default_factory=list)  # values that Structured Text cannot write, as sentences
    structs: dict[nodes.StructNode, MemberNames] = field(default_factory=dict)  # what the DUTs are built of
    _seen_types: set[str] = field(default_factory=set)

    def add(self, layout: Layout) -> str:
        """Build a layout's DUTs; return the name of the message's DUT."""
        return self.struct(layout.root).dut

    def members(self, layout: Layout) -> dict[str, str]:
        """Return the members of a type's DUT: name → type."""
        name = self.add(layout)
        return {member.name: member.type for dut in self.duts if dut.name == name for member in dut.members}

    def struct(self, node: nodes.StructNode) -> MemberNames:
        """Build a struct's DUT, after the DUTs that it contains."""
        if known := self.structs.get(node):
            return known
        for member in node.members:
            inner = _element(member.node)
            if isinstance(inner, nodes.StructNode):
                self.struct(inner)
        message = self.store[node.type_name]
        scope = Scope()
        names = scope.give_all([_wanted(member) for member in node.members])
        wanted = type_prefix(node.type_name)
        plain = wanted
        if node.type_name in self._seen_types:
            wanted += "_" + hashlib.sha256(repr(node).encode()).hexdigest()[:6]
        dut = self.scope.give(wanted)
        result = self.structs[node] = MemberNames(dut, names)
        self._note(node, result, plain)
        defaults = {item.name: item for item in message.fields}
        members = tuple(
            Variable(
                name,
                self._type(member.node),
                _initial(member, defaults),
                f"elements of {member.count_of} in use" if member.count_of else "",
            )
            for name, member in zip(names, node.members, strict=True)
        )
        self.omitted.extend(
            f"{dut}: the default value of {item.name} is {item.default}, which has no IEC literal"
            for item in message.fields
            if item.default not in (None, ()) and _literal_of(item.default) is None
        )
        comment = f"{node.type_name}, {node.size} bytes"
        self.duts.append(Dut(dut, members, comment=comment, folder=self.folder))
        if node.type_name not in self._seen_types:
            self._seen_types.add(node.type_name)
            self._constants(message)
        return result

    def _note(self, node: nodes.StructNode, names: MemberNames, wanted: str) -> None:
        self.note(f"{node.type_name}, {node.size} bytes", wanted, names.dut)
        for name, member in zip(names.names, node.members, strict=True):
            own = _wanted(member)
            if not isinstance(member.node, nodes.PaddingNode):
                self.note(names.dut, own, name)

    def note(self, where: str, wanted: str, given: str) -> None:
        """Record a renamed identifier."""
        if given != wanted:
            self.renamings.append(f"{where}: {wanted} was renamed to {given}")

    def _type(self, node: nodes.Node) -> str:
        if isinstance(node, nodes.ScalarNode):
            return IEC_TYPES[node.kind]
        if isinstance(node, nodes.StringNode):
            return f"STRING({node.capacity})"
        if isinstance(node, nodes.PaddingNode):
            return f"ARRAY[0..{node.size - 1}] OF BYTE"
        if isinstance(node, nodes.ArrayNode | nodes.SequenceNode):
            return f"ARRAY[0..{node.capacity - 1}] OF {self._type(node.element)}"
        return self.struct(node).dut

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
                self.omitted.append(f"{name}: {constant.name} is {constant.value}, which has no IEC literal")
                continue
            self.note(name, constant.name, given)
            variables.append(Variable(given, value[0], value[1]))
        block = VarBlock("VAR_GLOBAL", tuple(variables), constant=True)
        comment = f"Constants of {message.name}"
        self.constants.append(Gvl(name, (block,), (("qualified_only", ""),), comment, self.folder))


def _initial(member: nodes.Member, fields: dict[str, Field]) -> str | None:
    """Return a member's initial value; a sequence's default also sets its count."""
    item = fields.get(member.count_of or member.name)
    if item is None or item.default is None or isinstance(member.node, nodes.PaddingNode):
        return None
    default: Value = item.default
    if member.count_of:
        return str(len(default)) if isinstance(default, tuple) else None
    element = _element(member.node)
    kind = element.kind if isinstance(element, nodes.ScalarNode) else "string"
    if isinstance(member.node, nodes.SequenceNode) and isinstance(default, tuple):
        missing = member.node.capacity - len(default)
        text = literal(kind, default)
        if text is None or not missing:
            return text
        zero = "''" if kind == "string" else literal(kind, 0)
        return f"{text[:-1]}, {missing}({zero})]"
    return literal(kind, default)


def _literal_of(value: Value) -> str | None:
    """Return a literal of a value; None if Structured Text has none (infinity, NaN)."""
    items = value if isinstance(value, tuple) else (value,)
    return literal("float64", items) if any(isinstance(item, float) for item in items) else ""


def _constant(constant: Constant) -> tuple[str, str] | None:
    if isinstance(constant.type, PrimitiveType):
        text = literal(constant.type.name, constant.value)
        return (IEC_TYPES[constant.type.name], text) if text is not None else None
    length = min(max(1, len(str(constant.value).encode("utf-8", "surrogateescape"))), _MAX_STRING)
    text = literal("string", constant.value)
    return (f"STRING({length})", text) if text is not None else None


def _wanted(member: nodes.Member) -> str:
    """Return the preferred name of a member."""
    if isinstance(member.node, nodes.PaddingNode):
        return f"abPad{member.offset}"
    return f"{member.name}_count" if member.count_of else member.name


def _element(node: nodes.Node) -> nodes.Node:
    return node.element if isinstance(node, (nodes.ArrayNode, nodes.SequenceNode)) else node


def initial_value(node: nodes.StructNode, value: Mapping[str, Any], builder: DutBuilder) -> str | None:
    """Return the initial value with these fields, accepted by ``Layout.pack``; None without fields."""
    names = builder.struct(node)
    parts = []
    for member in node.members:
        if not member.name or member.name not in value:
            continue
        given = value[member.name]
        text = str(len(given)) if member.count_of else _value(member.node, given, builder)
        if text is not None:
            parts.append(f"{names.of(node, member)} := {text}")
    return f"({', '.join(parts)})" if parts else None


def _value(node: nodes.Node, value: Any, builder: DutBuilder) -> str | None:
    if isinstance(node, nodes.StructNode):
        return initial_value(node, value, builder)
    if isinstance(node, nodes.ScalarNode):
        return literal(node.kind, value)
    if isinstance(node, nodes.StringNode):
        return literal("string", value)
    assert isinstance(node, (nodes.ArrayNode, nodes.SequenceNode))
    return _elements(node, value, builder)


def _elements(node: nodes.ArrayNode | nodes.SequenceNode, value: Any, builder: DutBuilder) -> str | None:
    """Return an array's initial value; further elements are initial structures, zero or empty."""
    element = node.element
    if isinstance(element, nodes.StructNode):
        # An element without a field of its own still needs a place: it names one that is initial.
        texts = [initial_value(element, item, builder) or _untouched(element, builder) for item in value]
        return None if None in texts or not texts else f"[{', '.join(str(text) for text in texts)}]"
    kind = element.kind if isinstance(element, nodes.ScalarNode) else "string"
    texts = [literal(kind, item) for item in value]
    if node.capacity > len(texts):
        # Written out: a default value of the definition, which may be longer, must not show through.
        texts.append(f"{node.capacity - len(texts)}({literal(kind, '' if kind == 'string' else 0)})")
    return f"[{', '.join(str(text) for text in texts)}]"


def _untouched(node: nodes.StructNode, builder: DutBuilder) -> str | None:
    """Return a structure's initial value, written with one of its members; None if no member has one."""
    defaults = {item.name: item.default for item in builder.store[node.type_name].fields}
    names = builder.struct(node)
    for member in node.members:
        default = defaults.get(member.count_of or member.name)
        text = _plain(member.node, default, builder) if member.name else None
        if text is not None:
            return f"({names.of(node, member)} := {text})"
    return None


def _plain(node: nodes.Node, default: Any, builder: DutBuilder) -> str | None:
    """Return a member's initial value; None if its default is a list."""
    if isinstance(node, nodes.StructNode):
        return _untouched(node, builder)
    if isinstance(default, tuple):
        return None
    if isinstance(node, nodes.ScalarNode):
        return literal(node.kind, 0 if default is None else default)
    if isinstance(node, nodes.StringNode):
        return literal("string", default or "")
    if isinstance(node, (nodes.ArrayNode, nodes.SequenceNode)):
        inner = _plain(node.element, None, builder)
        return None if inner is None else f"[{inner}]"
    return None
