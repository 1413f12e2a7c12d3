"""From topics to a PLC project: everything the technician finds after the import.

The order of the output depends on names alone, never on the order of a file or a set, so
that a second generation from the same input gives the same bytes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

from rosplc.errors import GenerationError
from rosplc.layout import Layout
from rosplc.model import TypeStore
from rosplc.plc.base import base_objects
from rosplc.plc.blocks import read_block, write_block
from rosplc.plc.classic import (
    CLASSIC_NAMES,
    LIBRARY,
    Classic,
    check_classic,
    classic_arguments,
    classic_objects,
    classic_read_block,
    classic_wait,
    classic_write_block,
)
from rosplc.plc.helpers import HELPER_NAMES, helper_objects
from rosplc.plc.instances import instance_names, plain_name
from rosplc.plc.literals import string_literal, time_literal
from rosplc.plc.names import Scope
from rosplc.plc.project import Dut, Gvl, PlcProject, Pou, Task, VarBlock, Variable
from rosplc.plc.types import DutBuilder, Renaming

__all__ = ["PlcTask", "PlcTopic", "ProjectOptions", "build_project", "build_type_library"]

_ON_STALE = {"hold": 0, "zero": 1, "value": 2}
_LARGE_DUT = 64 * 1024
_MOST_TASKS = 16  # as many as RosPlc_State.axMayOpen has elements
_LONGEST_TOPIC = 255  # bytes: FB_Init of RosPlc_Channel takes a STRING(255)
_LIBRARIES: tuple[str, ...] = ("SysShm", "SysMem", "SysTypes2 Interfaces")
_READ_GVL, _WRITE_GVL, _SETTINGS_GVL = "ROS_Read", "ROS_Write", "RosPlc_Settings"


@dataclass(frozen=True)
class PlcTopic:
    """One topic as the PLC sees it.

    Attributes:
        topic: As ROS writes it.
        layout: Its message's layout.
        direction: ``"read"`` towards the PLC, ``"write"`` towards ROS.
        task: Name of the task that serves it.
        object_size: Bytes of the shared-memory object; 0: the block asks the object.
        stale_after_ns: Age from which a message is stale; 0: never.
        on_stale: What the message becomes then.
        in_order: Take every message, not only the newest.
        latched: Take the state found at the start as a new message.
        classic: Set for a topic in classic mode; ``object_size`` and ``in_order`` then have no meaning.
    """

    topic: str
    layout: Layout
    direction: Literal["read", "write"]
    task: str
    object_size: int = 0
    stale_after_ns: int = 0
    on_stale: Literal["hold", "zero", "value"] = "hold"
    in_order: bool = False
    latched: bool = False
    classic: Classic | None = None


@dataclass(frozen=True)
class PlcTask:
    """One task of the configuration; times in nanoseconds, 0: none."""

    name: str
    interval_ns: int = 10_000_000
    priority: int = 4
    kind: Literal["cyclic", "freewheeling"] = "cyclic"
    watchdog_ns: int = 0
    watchdog_sensitivity: int = 1


@dataclass(frozen=True)
class ProjectOptions:
    """What holds for the whole project.

    Attributes:
        folder: The top folder in the PLC project.
        prefix: The prefix of shared-memory names.
        fenced: Whether the target orders memory accesses by a fence: always on x86, on ARM
            only where the device description enables the MemoryBarrier library.
        beat_ms: The longest time between two beats that the PLC promises: several scans of
            its slowest task.
        pins: Give blocks a pin for each top-level field.
    """

    folder: str = "ROS"
    prefix: str = "rosplc"
    fenced: bool = True
    beat_ms: int = 1000
    pins: bool = False


_MAKERS = {
    ("read", False): read_block,
    ("write", False): write_block,
    ("read", True): classic_read_block,
    ("write", True): classic_write_block,
}


@dataclass
class _Blocks:
    """The function blocks of the types in use, each built once."""

    builder: DutBuilder
    options: ProjectOptions
    pous: list[Pou] = field(default_factory=list)
    _known: dict[tuple[str, bool, Layout], str] = field(default_factory=dict)

    def name(self, layout: Layout, direction: str, classic: bool = False) -> str:
        key = (direction, classic, layout)
        if key not in self._known:
            dut = self.builder.add(layout)
            wanted = f"{dut}_{'Classic' if classic else ''}{'Read' if direction == 'read' else 'Write'}"
            name = self.builder.scope.give(wanted)
            if name != wanted:
                self.builder.renamings.append(Renaming(f"block of {layout.type_name}", wanted, name))
            make = _MAKERS[direction, classic]
            folder = f"{self.options.folder}/Blocks"
            self.pous.append(make(layout, self.builder, name, folder, pins=self.options.pins))
            self._known[key] = name
        return self._known[key]


def build_project(
    store: TypeStore,
    topics: Sequence[PlcTopic],
    tasks: Sequence[PlcTask],
    options: ProjectOptions | None = None,
) -> PlcProject:
    """Return the project for a set of topics.

    Args:
        store: The types.
        topics: Every topic once.
        tasks: Every task that a topic names; at most 16.
        options: See :class:`ProjectOptions`.

    Raises:
        GenerationError: PLC003, there are more tasks than the blocks serve; PLC005, two tasks have
            names that are one to CODESYS; PLC006, a topic's name is longer than the blocks take; PLC007, the
            name of a classic topic's memory or semaphore is none.
    """
    _check_tasks(tasks)
    _check_topics(topics)
    options = options or ProjectOptions()
    topics = sorted(topics, key=lambda item: item.topic)
    base = base_objects(f"{options.folder}/Base")
    libraries = _LIBRARIES
    if any(topic.classic for topic in topics):
        base = (*base, *classic_objects(f"{options.folder}/Base"))
        libraries = (*_LIBRARIES, LIBRARY)
    builder = _builder(store, options, base)
    blocks = _Blocks(builder, options)
    names = {
        direction: instance_names([topic.topic for topic in topics if topic.direction == direction])
        for direction in ("read", "write")
    }
    instances: dict[str, list[Variable]] = {"read": [], "write": []}
    calls: dict[tuple[str, str], list[str]] = {}
    renamings: list[Renaming] = []
    order = sorted(tasks, key=lambda task: task.name)
    indices = {task.name: index for index, task in enumerate(order)}
    cycles = {task.name: task.interval_ns if task.kind == "cyclic" else 0 for task in tasks}
    for topic in topics:
        block = blocks.name(topic.layout, topic.direction, topic.classic is not None)
        wanted, name = plain_name(topic.topic), names[topic.direction][topic.topic]
        if name != wanted:
            renamings.append(Renaming(f"instance of {topic.topic}", wanted, name))
        argument: tuple[tuple[str, str], ...] = (("sTopic", string_literal(topic.topic)),)
        if topic.classic is not None:
            argument = classic_arguments(topic.classic)
        instances[topic.direction].append(Variable(name, block, None, _what(topic), argument))
        calls.setdefault((topic.direction, topic.task), []).append(
            _call(name, topic, indices[topic.task], cycles[topic.task])
        )
    programs, plc_tasks = _programs(order, indices, calls, options, builder.scope)
    gvls = [*(item for item in base if isinstance(item, Gvl)), _settings(options), *builder.constants]
    for direction, name in (("read", _READ_GVL), ("write", _WRITE_GVL)):
        if instances[direction]:
            block_ = VarBlock("VAR_GLOBAL", tuple(instances[direction]))
            comment = "One function block per topic; programs of the project use their outputs."
            if direction == "write":
                comment = "One function block per topic; programs of the project set msg."
            gvls.append(Gvl(name, (block_,), (("qualified_only", ""),), comment, options.folder))
    helpers = helper_objects(store, builder, f"{options.folder}/Helpers")
    return PlcProject(
        options.folder,
        duts=(*(item for item in (*base, *helpers) if isinstance(item, Dut)), *builder.duts),
        gvls=tuple(gvls),
        pous=(*(item for item in (*base, *helpers) if isinstance(item, Pou)), *blocks.pous, *programs),
        tasks=plc_tasks,
        libraries=libraries,
        notes=tuple(_notes(builder, renamings, topics, options)),
    )


def build_type_library(
    store: TypeStore, layouts: Sequence[Layout], options: ProjectOptions | None = None
) -> PlcProject:
    """Return a project with both blocks of each layout and no topics or tasks."""
    options = options or ProjectOptions()
    base = base_objects(f"{options.folder}/Base")
    builder = _builder(store, options, base)
    blocks = _Blocks(builder, options)
    for layout in sorted(layouts, key=lambda item: item.type_name):
        blocks.name(layout, "read")
        blocks.name(layout, "write")
    helpers = helper_objects(store, builder, f"{options.folder}/Helpers")
    return PlcProject(
        options.folder,
        duts=(*(item for item in (*base, *helpers) if isinstance(item, Dut)), *builder.duts),
        gvls=(*(item for item in base if isinstance(item, Gvl)), _settings(options), *builder.constants),
        pous=(*(item for item in (*base, *helpers) if isinstance(item, Pou)), *blocks.pous),
        libraries=_LIBRARIES,
        notes=tuple(_notes(builder, [], (), options)),
    )


def _check_tasks(tasks: Sequence[PlcTask]) -> None:
    if len(tasks) > _MOST_TASKS:
        raise GenerationError("PLC003", f"the topics use {len(tasks)} tasks", where="tasks")
    seen: dict[str, str] = {}
    for task in tasks:
        other = seen.setdefault(task.name.upper(), task.name)
        if other != task.name:
            raise GenerationError("PLC005", f"{other} and {task.name}", where="tasks")


def _check_topics(topics: Sequence[PlcTopic]) -> None:
    for topic in topics:
        # CODESYS would cut the literal off without a word, and the block look for another object.
        if len(topic.topic.encode()) > _LONGEST_TOPIC:
            raise GenerationError("PLC006", f"the name has {len(topic.topic)} characters", where=topic.topic)
        if topic.classic is not None:
            check_classic(topic.topic, topic.classic)


def _builder(store: TypeStore, options: ProjectOptions, base: Sequence[Dut | Gvl | Pou]) -> DutBuilder:
    """Return a builder whose scope knows the hand-written objects: all objects share one namespace."""
    taken = [
        *(item.name for item in base),
        *CLASSIC_NAMES,
        *HELPER_NAMES,
        _READ_GVL,
        _WRITE_GVL,
        _SETTINGS_GVL,
    ]
    return DutBuilder(store, f"{options.folder}/Types", scope=Scope(taken))


def _settings(options: ProjectOptions) -> Gvl:
    variables = (
        Variable("sPrefix", "STRING(32)", string_literal(options.prefix), "prefix of the bridge's objects"),
        Variable(
            "xFenced", "BOOL", "TRUE" if options.fenced else "FALSE", "FALSE: the delayed rule, for ARM"
        ),
        Variable("udiBeatMs", "UDINT", str(options.beat_ms), "longest time between two calls of a block"),
    )
    block = VarBlock("VAR_GLOBAL", variables, constant=True)
    comment = "What the generation fixed for the whole project."
    return Gvl(_SETTINGS_GVL, (block,), (("qualified_only", ""),), comment, f"{options.folder}/Base")


def _what(topic: PlcTopic) -> str:
    """Say in a line what an instance carries."""
    which = ""
    if topic.classic is not None:
        which = ", classic"
    elif topic.direction == "read":
        which = ", every message" if topic.in_order else ", the newest message"
    return f"{topic.layout.type_name} in task {topic.task}{which}"


def _call(name: str, topic: PlcTopic, task: int, cycle_ns: int) -> str:
    gvl = _READ_GVL if topic.direction == "read" else _WRITE_GVL
    arguments = [f"uiTask := {task}", f"udiMapSize := {topic.object_size}"]
    if topic.classic is not None:
        arguments[1] = f"tWait := {time_literal(classic_wait(topic.classic, cycle_ns) * 1_000_000)}"
    if topic.direction == "read":
        if topic.stale_after_ns:
            arguments.append(f"tStaleAfter := {time_literal(topic.stale_after_ns)}")
        if topic.on_stale != "hold":
            arguments.append(f"uiOnStale := {_ON_STALE[topic.on_stale]}")
        if topic.in_order and topic.classic is None:
            arguments.append("xInOrder := TRUE")
        if topic.latched:
            arguments.append("xLatched := TRUE")
    return f"{gvl}.{name}({', '.join(arguments)});"


def _programs(
    tasks: Sequence[PlcTask],
    indices: dict[str, int],
    calls: dict[tuple[str, str], list[str]],
    options: ProjectOptions,
    scope: Scope,
) -> tuple[list[Pou], tuple[Task, ...]]:
    """Return a reading and a writing program per task that has topics, and the tasks."""
    programs: list[Pou] = []
    plc_tasks: list[Task] = []
    single = sum(1 for task in tasks if any((d, task.name) in calls for d in ("read", "write"))) == 1
    for task in tasks:
        names = []
        for direction in ("read", "write"):
            lines = calls.get((direction, task.name), [])
            if not lines and not (direction == "read" and ("write", task.name) in calls):
                continue
            wanted = f"SharedMemory_{direction.capitalize()}"
            name = scope.give(wanted if single else f"{wanted}_{task.name}")
            body = list(lines)
            if direction == "read":
                body.insert(
                    0, f"RosPlc_State.axMayOpen[{indices[task.name]}] := TRUE; // one open attempt per scan"
                )
            what = (
                "Takes what came from ROS; call it first"
                if direction == "read"
                else "Sends to ROS; call it last"
            )
            comment = f"{what} in task {task.name}."
            programs.append(Pou(name, "PROGRAM", (), "\n".join(body), comment=comment, folder=options.folder))
            names.append(name)
        if names:
            plc_tasks.append(
                Task(
                    task.name,
                    task.kind,
                    task.interval_ns // 1000 if task.kind == "cyclic" else 0,
                    task.priority,
                    task.watchdog_ns // 1000,
                    task.watchdog_sensitivity,
                    tuple(names),
                )
            )
    return programs, tuple(plc_tasks)


def _notes(
    builder: DutBuilder, renamings: list[Renaming], topics: Sequence[PlcTopic], options: ProjectOptions
) -> list[str]:
    notes = [f"{r.where}: {r.wanted} is named {r.given}" for r in (*builder.renamings, *renamings)]
    notes += builder.omitted
    for topic in topics:
        if topic.layout.size > _LARGE_DUT:
            copies = 3 if topic.direction == "read" else 1
            notes.append(
                f"{topic.topic}: {topic.layout.type_name} takes {topic.layout.size} bytes, "
                f"{copies} times in the PLC; check the size of the application's data area"
            )
        if topic.in_order and topic.direction == "read" and not options.fenced and topic.classic is None:
            notes.append(
                f"{topic.topic}: without a memory fence the PLC takes one message in two scans at most; "
                "if more come for longer, messages are lost, and counted"
            )
    return notes
