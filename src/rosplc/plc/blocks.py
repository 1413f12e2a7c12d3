"""The Read and Write function blocks of a message type, on a channel or on classic memory.

All blocks extend base blocks (``templates/base`` and ``templates/classic``), which open, check, monitor and
count. ``templates/blocks`` contains the type-specific parts: the copy between memory and DUT, and the checks
that make a record safe to use (counts within their arrays, terminated strings).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from rosplc.layout import Layout
from rosplc.layout.nodes import ArrayNode, Node, PaddingNode, SequenceNode, StringNode, StructNode
from rosplc.plc.base import parse_object, render
from rosplc.plc.names import Scope
from rosplc.plc.project import Pou
from rosplc.plc.types import DutBuilder


@dataclass(frozen=True)
class _Pin:
    """An input or output for a top-level field, ``msg.<member>``."""

    name: str
    member: str
    type: str


@dataclass(frozen=True)
class _Step:
    """A check on the record in ``stShadow``."""

    # ``"count"``: keep ``path`` at most ``limit``; ``"string"``: end it after ``limit`` characters;
    # ``"loop"``: the steps ``inner`` for ``path`` from 0 to ``limit``
    kind: str
    path: str
    limit: int
    inner: tuple[_Step, ...] = ()


def block(
    kind: str,
    layout: Layout,
    builder: DutBuilder,
    name: str,
    folder: str,
    *,
    pins: bool = False,
    part: bool = False,
) -> Pou:
    """Return a ``Read``, ``Write``, ``ClassicRead`` or ``ClassicWrite`` block of a message type.

    ``builder`` builds the DUTs if needed; ``pins`` adds a pin for each top-level field, for Ladder and
    Function Block Diagram; ``part`` is for a message that is part of a service or action.
    """
    low, high = layout.layout_id_words
    steps = tuple(_mend(layout.root, "stShadow", builder, 0))
    ends = [("pbEnd", "POINTER TO BYTE")] if any(step.kind == "string" for step in _all(steps)) else []
    text = render(
        f"blocks/{kind}.st",
        layout=layout,
        dut=builder.add(layout),
        name=name,
        part=part,
        low=f"16#{low:08X}",
        high=f"16#{high:08X}",
        pins=_pins(layout, builder) if pins else [],
        mend_steps=steps,
        mend_variables=[*ends, *((f"udi{depth}", "UDINT") for depth in range(_depth(steps)))],
    )
    found = parse_object(text, name, folder)
    assert isinstance(found, Pou)
    return found


def call_block(
    role: str, type_name: str, parts: Mapping[str, tuple[str, str]], name: str, folder: str
) -> Pou:
    """Return a service's or action's block; ``role``: such as "Client"; ``parts``: DUT and block of each."""
    named = {part: {"dut": dut, "block": inner} for part, (dut, inner) in parts.items()}
    found = parse_object(render(f"blocks/{role}.st", type_name=type_name, name=name, **named), name, folder)
    assert isinstance(found, Pou)
    return found


def _pins(layout: Layout, builder: DutBuilder) -> list[_Pin]:
    """Return a pin for each top-level field, including counts."""
    names = builder.struct(layout.root)
    types = builder.members(layout)
    scope = Scope()  # nothing in the base blocks begins with pin_
    return [
        _Pin(scope.give(f"pin_{name}"), name, types[name])
        for name, member in zip(names.names, layout.root.members, strict=True)
        if not isinstance(member.node, PaddingNode)
    ]


def _mend(node: Node, path: str, builder: DutBuilder, depth: int) -> Iterator[_Step]:
    """Yield the steps that clamp counts and terminate strings, so that a faulty writer does no harm."""
    if isinstance(node, StringNode):
        yield _Step("string", path, node.capacity)
    elif isinstance(node, StructNode):
        names = builder.struct(node)
        for member in node.members:
            inner = f"{path}.{names.of(node, member)}"
            if member.count_of:
                counted = next(m.node for m in node.members if m.name == member.count_of and not m.count_of)
                if isinstance(counted, SequenceNode):
                    yield _Step("count", inner, counted.capacity)
            else:
                yield from _mend(member.node, inner, builder, depth)
    elif isinstance(node, (ArrayNode, SequenceNode)) and isinstance(node.element, (StringNode, StructNode)):
        steps = tuple(_mend(node.element, f"{path}[udi{depth}]", builder, depth + 1))
        if steps:
            yield _Step("loop", f"udi{depth}", node.capacity - 1, steps)


def _all(steps: tuple[_Step, ...]) -> Iterator[_Step]:
    for step in steps:
        yield step
        yield from _all(step.inner)


def _depth(steps: tuple[_Step, ...]) -> int:
    return max((1 + _depth(step.inner) for step in steps if step.kind == "loop"), default=0)
