"""The PLC part for OpenPLC: Structured Text, and C or C++ between it and ``rosplc/plc.h``.

``openplc`` is OpenPLC Runtime 4.1 with the compiler STruC++, ``matiec`` the compiler of OpenPLC v3 and
Beremiz. The function blocks have the same names as for CODESYS. Their bodies call C or C++, which copies
field by field: a STruC++ variable is an object, and matiec's strings differ from those of a record.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from importlib.resources import files
from typing import Any, Literal

from rosplc.config.plans import CallPlan
from rosplc.config.resolve import Project
from rosplc.errors import GenerationError
from rosplc.layout import Layout, compute_layout, nodes
from rosplc.model import TypeStore
from rosplc.plc import build
from rosplc.plc.base import render
from rosplc.plc.names import Scope, instance_names, literal, string_literal, time_literal
from rosplc.plc.plan import PlcTask, PlcTopic, beat_ms
from rosplc.plc.project import Dut
from rosplc.plc.types import DutBuilder

Plc = Literal["openplc", "matiec"]
_COMPILERS = {"openplc": "STruC++", "matiec": "matiec"}
_LEFT_OUT = {
    "openplc": re.compile(r"\[.*|(ULINT#|-)?\d{16,}( .*)?"),  # STruC++ keeps numbers as floating-point ones
    "matiec": re.compile(r".*\d - 1.*"),  # an initial value is no expression
}
_ARRAY_STRING = 254  # characters that STruC++ keeps of each string in an array despite its declared length
_STRING = 126  # bytes that matiec keeps of every string, whatever is declared


def openplc_files(project: Project, plc: Plc) -> tuple[dict[str, bytes], tuple[str, ...]]:
    """Return path below the output folder → file for a configuration, and notes for the user.

    Raises GenerationError (PLC006) for a name that is too long for matiec.
    """
    inner = {plan.topic for plan in project.topics if plan.own == "parameters"}
    topics = [each for each in build.plc_topics(project) if each.classic is None and each.topic not in inner]
    for name in [topic.topic for topic in topics] + [call.called for call in project.calls]:
        if plc == "matiec" and len(name) > _STRING:
            what = f"the name has {len(name)} characters; a matiec string has at most {_STRING}"
            raise GenerationError("PLC006", what, where=name)
    made = _Openplc(project.store, project.config.settings.prefix, plc)
    made.notes += [f"{plan.topic}: classic mode needs CODESYS" for plan in project.topics if plan.classic]
    made.notes += ["parameters need CODESYS"] if inner else []
    for topic in sorted(topics, key=lambda topic: topic.topic):
        made.block(topic.layout, topic.direction)
    for call in sorted(project.calls, key=lambda call: call.name):
        made.use(call)
    return made.files(topics, build.plc_tasks(project), project.calls), tuple(made.notes)


def openplc_types(distro: str, plc: Plc) -> tuple[dict[str, bytes], tuple[str, ...]]:
    """Return the same for both blocks of every message type of a distribution, without a program."""
    made = _Openplc(TypeStore.bundled(distro), "rosplc", plc)
    for name in made.builder.store.names():
        for direction in ("read", "write"):
            made.block(compute_layout(made.builder.store, name), direction)
    return made.files((), ()), tuple(made.notes)


class _Openplc:
    def __init__(self, store: TypeStore, prefix: str, plc: Plc) -> None:
        self.plc = plc
        self.builder = DutBuilder(store, scope=Scope(["Config0", "Res0"]))
        self.prefix = prefix
        self.notes: list[str] = []
        self.layouts: dict[str, dict[str, Any]] = {}
        self.blocks: dict[tuple[Layout, str], dict[str, str]] = {}
        self.uses: dict[tuple[str | Layout, ...], dict[str, Any]] = {}

    def block(self, layout: Layout, direction: str) -> None:
        if (layout, direction) not in self.blocks:
            dut = self._layout(layout)
            name = self.builder.scope.give(f"{dut}_{direction.capitalize()}")
            self.blocks[layout, direction] = {"name": name, "dut": dut, "direction": direction}

    def use(self, call: CallPlan) -> dict[str, Any]:
        key: tuple[str | Layout, ...] = (build.call_role(call), *call.layouts)
        if key not in self.uses:
            duts = [self._layout(layout) for layout in call.layouts]
            name = self.builder.scope.give(build.call_name(call, duts))
            parts = {part.word: dut for part, dut in zip(call.parts, duts, strict=True)}
            self.uses[key] = {"name": name, "role": key[0], "calls": call.server == "ros", "parts": parts}
        return self.uses[key]

    def _layout(self, layout: Layout) -> str:
        dut = self.builder.add(layout)
        low, high = layout.layout_id_words
        self.layouts[dut] = {"name": dut.upper(), "low": low, "high": high, "size": layout.size}
        self.layouts[dut]["room"] = -(-layout.size // 8) * 8
        return dut

    def files(
        self, topics: Sequence[PlcTopic], tasks: Sequence[PlcTask], calls: Sequence[CallPlan] = ()
    ) -> dict[str, bytes]:
        structs = {names.dut: node for node, names in self.builder.structs.items()}
        duts = [self._dut(dut, structs[dut.name]) for dut in self.builder.duts]
        self.notes += self.builder.renamings
        blocks = tuple(self.blocks.values())
        matiec = self.plc == "matiec"
        bodies = "rosplc_blocks.c" if matiec else "rosplc_blocks.cpp"
        made = {
            "rosplc.st": render(
                "openplc/rosplc.st", duts=duts, blocks=blocks, uses=self.uses.values(), matiec=matiec
            ),
            f"generated/{bodies}": render(
                f"{self.plc}/{bodies}",
                prefix=self.prefix,
                beat_ms=max((beat_ms(task) for task in tasks), default=1000),
                structs=[
                    {"name": dut.name.upper(), "members": list(self._members(structs[dut.name]))}
                    for dut in duts
                ],
                layouts=self.layouts,
                blocks=blocks,
                uses=self.uses.values(),
            ),
        }
        if topics or calls:
            made["example.st"] = render("openplc/example.st", tasks=list(self._tasks(topics, tasks, calls)))
        result = {path: text.encode("ascii") for path, text in made.items()}
        fixed = files("rosplc.plc").joinpath(f"templates/{self.plc}")
        header = "rosplc_matiec.h" if matiec else "rosplc_openplc.hpp"
        result[f"generated/{header}"] = fixed.joinpath(header).read_bytes()
        for name in ("README.txt",) if matiec else ("README.txt", "build.mjs"):
            result[name] = fixed.joinpath(name).read_bytes()
        for item in files("rosplc").joinpath("include/rosplc").iterdir():
            if item.name.endswith(".h"):
                result[f"generated/rosplc/{item.name}"] = item.read_bytes()
        # OpenPLC 4.1 compiles *.cpp alone; what lies in a subfolder may be compiled, too, or not.
        library = "rosplc/plc.c" if matiec else "rosplc_plc.cpp"
        result[f"generated/{library}"] = files("rosplc").joinpath("include/rosplc/plc.c").read_bytes()
        if self.notes:
            result["NOTES.txt"] = ("\n".join(self.notes) + "\n").encode()
        return result

    def _dut(self, dut: Dut, node: nodes.StructNode) -> Dut:
        """Return a structure without padding and without initial values that the compiler would alter."""
        members = []
        for variable, member in zip(dut.members, node.members, strict=True):
            if isinstance(member.node, nodes.PaddingNode):
                continue
            where = f"{dut.name}.{variable.name}"
            element = getattr(member.node, "element", None)
            if self.plc == "matiec":
                variable = replace(variable, type=_of_matiec(member.node, variable.type))
            elif isinstance(element, nodes.StringNode) and element.capacity > _ARRAY_STRING:
                self.notes.append(f"{where}: STruC++ keeps only {_ARRAY_STRING} characters of each string")
            initial = variable.initial or ""
            text = "'" in initial and variable.type.endswith("OF BYTE")
            if text or _LEFT_OUT[self.plc].fullmatch(initial):
                self.notes.append(
                    f"{where}: the default value {initial} is omitted: {_COMPILERS[self.plc]} would alter it"
                )
                variable = replace(variable, initial=None)
            members.append(variable)
        return replace(dut, members=tuple(members))

    def _members(self, node: nodes.StructNode) -> Iterator[dict[str, Any]]:
        names = self.builder.struct(node)
        for member in node.members:
            if isinstance(member.node, nodes.PaddingNode):
                continue
            several = member.node if isinstance(member.node, (nodes.ArrayNode, nodes.SequenceNode)) else None
            inner = several.element if several else member.node
            yield {
                "name": names.of(node, member).upper(),
                "of": self._kind(inner),
                "offset": member.offset,
                "count": several.capacity if several else 0,
                "stride": several.stride if several else 0,
                "capacity": f", {inner.capacity}" if isinstance(inner, nodes.StringNode) else "",
                "most": _counted(node, member),
            }

    def _kind(self, node: nodes.Node) -> str:
        """Return how matiec's C code copies a value; empty: byte by byte."""
        if isinstance(node, nodes.StructNode):
            return self.builder.struct(node).dut.upper()
        if isinstance(node, nodes.StringNode):
            return "bytes" if node.capacity > _STRING else "string"
        return "bool" if isinstance(node, nodes.ScalarNode) and node.kind == "bool" else ""

    def _tasks(
        self, topics: Sequence[PlcTopic], tasks: Sequence[PlcTask], calls: Sequence[CallPlan]
    ) -> Iterator[dict[str, Any]]:
        for task in sorted(tasks, key=lambda task: task.name):
            own = sorted((t for t in topics if t.task == task.name), key=lambda topic: topic.topic)
            names = instance_names([topic.topic for topic in own])
            scope = Scope(names.values())
            uses = [
                {
                    "name": scope.give(name),
                    "block": self.use(use)["name"],
                    "arguments": f"sName := {string_literal(use.called)}"
                    + (f", sClient := {string_literal(use.client)}" if use.client else ""),
                }
                for gvl in (build.SERVICE_GVL, build.ACTION_GVL)
                for (_, use), name in build.use_names(gvl, [call for call in calls if call.task == task.name])
            ]
            if own or uses:
                yield {
                    "name": task.name,
                    "program": self.builder.scope.give(f"ROS_{task.name}"),
                    "interval": time_literal(task.interval_ns or 10_000_000),
                    "priority": task.priority,
                    "uses": uses,
                    "instances": [
                        {
                            "name": names[topic.topic],
                            "block": self.blocks[topic.layout, topic.direction]["name"],
                            "direction": topic.direction,
                            "topic": string_literal(topic.topic),
                            "arguments": list(build.read_arguments(topic)),
                            "safe": list(self._safe(topic.layout.root, topic.safe or {}, "")),
                        }
                        for topic in own
                    ],
                }

    def _safe(self, node: nodes.Node, value: Any, path: str) -> Iterator[str]:
        if isinstance(node, nodes.StructNode):
            names = self.builder.struct(node)
            for member in node.members:
                if member.name in value and not isinstance(member.node, nodes.PaddingNode):
                    given = len(value[member.name]) if member.count_of else value[member.name]
                    yield from self._safe(member.node, given, f"{path}.{names.of(node, member)}".lstrip("."))
        elif isinstance(node, (nodes.ArrayNode, nodes.SequenceNode)):
            for index, item in enumerate(value):
                yield from self._safe(node.element, item, f"{path}[{index}]")
        elif self.plc == "matiec" and isinstance(node, nodes.StringNode) and node.capacity > _STRING:
            start = f"{path[:-1]}, " if path.endswith("]") else f"{path}["
            for index, byte in enumerate(value.encode("utf-8", "surrogateescape")):
                yield f"{start}{index}] := {byte}"
        else:
            kind = "string" if isinstance(node, nodes.StringNode) else getattr(node, "kind", "")
            if (text := literal(kind, value)) is not None:
                yield f"{path} := {text}"


def _of_matiec(node: nodes.Node, declared: str) -> str:
    """Return a member's type for matiec; a string too long for STRING becomes bytes that end with a 0."""
    several = node if isinstance(node, (nodes.ArrayNode, nodes.SequenceNode)) else None
    inner = several.element if several else node
    if not isinstance(inner, nodes.StringNode):
        return declared
    if inner.capacity <= _STRING:
        return f"ARRAY[0..{several.capacity - 1}] OF STRING" if several else "STRING"
    rows = f"0..{several.capacity - 1}, " if several else ""
    return f"ARRAY[{rows}0..{inner.capacity}] OF BYTE"


def _counted(node: nodes.StructNode, member: nodes.Member) -> int:
    """Return the capacity of the sequence whose elements a member counts; 0 if it is no count."""
    counted = (m.node for m in node.members if m.name == member.count_of and not m.count_of)
    return (
        next((n.capacity for n in counted if isinstance(n, nodes.SequenceNode)), 0) if member.count_of else 0
    )
