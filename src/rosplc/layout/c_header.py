"""Layouts → a C header (valid C11 and C++11) whose structs are the records.

Every padding byte is a member, so no packing attribute is needed; static assertions confirm sizes and
offsets.
"""

from __future__ import annotations

import re
from collections.abc import Iterable

from rosplc.layout.layout import Layout
from rosplc.layout.nodes import ArrayNode, Node, PaddingNode, ScalarNode, SequenceNode, StringNode, StructNode

_WORDS = """
alignas alignof and and_eq asm auto bitand bitor bool break case catch char char16_t char32_t
char8_t class co_await co_return co_yield compl concept const const_cast consteval constexpr
constinit continue decltype default delete do double dynamic_cast else enum errno explicit export
extern false float for friend goto i386 if inline int linux long mutable namespace new noexcept not
not_eq NULL nullptr offsetof operator or or_eq private protected public register reinterpret_cast
requires restrict return short signed sizeof static static_assert static_cast struct switch
template this thread_local throw true try typedef typeid typename typeof typeof_unqual union unix
unsigned using virtual void volatile wchar_t while xor xor_eq
"""
# Keywords of C and C++, and names that common headers or gcc define as macros.
C_RESERVED = frozenset(_WORDS.split())

_C_TYPES = {
    "bool": "uint8_t", "byte": "uint8_t", "char": "uint8_t", "uint8": "uint8_t", "int8": "int8_t",
    "uint16": "uint16_t", "int16": "int16_t", "uint32": "uint32_t", "int32": "int32_t",
    "uint64": "uint64_t", "int64": "int64_t", "float32": "float", "float64": "double",
}  # fmt: skip

_PREAMBLE = """\
/* Records of rosplc (spec/type-mapping.md). Generated; changes are lost. */
#ifndef {guard}
#define {guard}

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
#define ROSPLC_ASSERT(condition) static_assert(condition, #condition)
#define ROSPLC_ALIGNOF(type) alignof(type)
#else
#define ROSPLC_ASSERT(condition) _Static_assert(condition, #condition)
#define ROSPLC_ALIGNOF(type) _Alignof(type)
#endif

ROSPLC_ASSERT(sizeof(float) == 4 && sizeof(double) == 8);
"""


def c_header(layouts: Iterable[Layout], guard: str = "ROSPLC_RECORDS_H") -> str:
    """Return one header with the structs of all layouts, equal ones once; ``guard`` is its include guard.

    A type's struct is ``package__Name``; where one type is needed with several limits, the later ones get a
    number. A sequence ``x`` has the members ``x_count`` and ``x``.
    """
    unique = list(dict.fromkeys(layouts))
    names = _Names()
    for layout in unique:
        names.of(layout.root)  # the layouts' own names come first, they are the ones used
    parts = [_PREAMBLE.format(guard=guard)]
    written: set[str] = set()
    for layout in unique:
        for node in _bottom_up(layout.root, {}):
            if names.of(node) not in written:
                written.add(names.of(node))
                parts.append(_struct(node, names))
        own = names.of(layout.root)
        low, high = layout.layout_id_words
        parts.append(f"#define {own}_LAYOUT_ID_LO 0x{low:08X}u\n#define {own}_LAYOUT_ID_HI 0x{high:08X}u\n")
    parts.append(f"#endif /* {guard} */\n")
    return "\n".join(parts)


def member_identifiers(node: StructNode) -> tuple[str, ...]:
    """Return a struct's C member names in the order of its members."""
    taken = {member.name for member in node.members}
    used: set[str] = set()
    result = []
    for index, member in enumerate(node.members):
        if isinstance(member.node, PaddingNode):
            name = f"padding_{index}"
        elif member.count_of is not None:
            name = f"{member.name}_count"
        else:
            name = member.name
        while name in C_RESERVED or name in used or (name != member.name and name in taken):
            name += "_"
        used.add(name)
        result.append(name)
    return tuple(result)


class _Names:
    """Struct names: one per type and limits."""

    def __init__(self) -> None:
        self._by_node: dict[int, str] = {}
        self._by_value: dict[StructNode, str] = {}
        self._used: set[str] = set()

    def of(self, node: StructNode) -> str:
        # Nodes are shared within a layout: looking at the identity first saves deep hashing.
        if id(node) not in self._by_node:
            if node not in self._by_value:
                self._by_value[node] = self._new(node.type_name)
            self._by_node[id(node)] = self._by_value[node]
        return self._by_node[id(node)]

    def _new(self, type_name: str) -> str:
        base = re.sub(r"\W", "__", type_name.replace("/msg/", "/"))
        name, number = base, 2
        while name in self._used:
            name, number = f"{base}_{number}", number + 1
        self._used.add(name)
        return name


def _bottom_up(node: StructNode, seen: dict[int, None]) -> list[StructNode]:
    """Return the structs that ``node`` holds, each after those it holds, itself last."""
    result: list[StructNode] = []
    for member in node.members:
        inner = member.node.element if isinstance(member.node, ArrayNode | SequenceNode) else member.node
        if isinstance(inner, StructNode) and id(inner) not in seen:
            seen[id(inner)] = None
            result += _bottom_up(inner, seen)
    return [*result, node]


def _struct(node: StructNode, names: _Names) -> str:
    own = names.of(node)
    lines = [f"/* {node.type_name} */", f"typedef struct {own} {{"]
    named = list(zip(node.members, member_identifiers(node), strict=True))
    lines += [f"    {_declaration(member.node, identifier, names)};" for member, identifier in named]
    lines.append(f"}} {own};")
    lines.append(f"ROSPLC_ASSERT(sizeof({own}) == {node.size});")
    # 32-bit x86 aligns structs less; that changes no offset, since no compiler adds padding.
    lines.append(f"ROSPLC_ASSERT(ROSPLC_ALIGNOF({own}) <= {node.align});")
    lines += [f"ROSPLC_ASSERT(offsetof({own}, {name}) == {member.offset});" for member, name in named]
    return "\n".join(lines) + "\n"


def _declaration(node: Node, name: str, names: _Names) -> str:
    if isinstance(node, PaddingNode):
        return f"uint8_t {name}[{node.size}]"
    if isinstance(node, ArrayNode | SequenceNode):
        return _declaration(node.element, f"{name}[{node.capacity}]", names)
    if isinstance(node, StringNode):
        return f"char {name}[{node.size}]"
    if isinstance(node, StructNode):
        return f"{names.of(node)} {name}"
    assert isinstance(node, ScalarNode)
    return f"{_C_TYPES[node.kind]} {name}"
