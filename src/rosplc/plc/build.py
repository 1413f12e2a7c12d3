"""Builds a PLC project from topics or a configuration: everything that the import creates.

The order of the output depends only on names, so the same input always gives the same bytes.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain

from rosplc._version import __version__
from rosplc.config.parameters import CURRENT, WANTED, ParametersPlan
from rosplc.config.plans import CallPlan
from rosplc.config.resolve import Project, object_plans
from rosplc.errors import GenerationError
from rosplc.layout import Layout
from rosplc.layout.nodes import StructNode
from rosplc.model import TypeStore
from rosplc.plc.base import (
    ACTION_NAMES,
    CALL_NAMES,
    CLASSIC_NAMES,
    HELPER_NAMES,
    OWN_NAMES,
    base_objects,
    call_objects,
    classic_objects,
    helper_objects,
    parse_object,
    read_objects,
    render,
)
from rosplc.plc.blocks import block, call_block
from rosplc.plc.names import Scope, instance_names, plain_name, string_literal, time_literal, type_prefix
from rosplc.plc.plan import (
    LIBRARY,
    UNKNOWN_BEAT_MS,
    PlcTask,
    PlcTopic,
    ProjectOptions,
    beat_ms,
    check_classic,
    classic_wait,
)
from rosplc.plc.project import Dut, Enumeration, Gvl, Item, PlcProject, Pou, Task, VarBlock, Variable
from rosplc.plc.types import DutBuilder, initial_value
from rosplc.shm import Direction, Part

READ_GVL, WRITE_GVL = "ROS_Read", "ROS_Write"  # the lists that hold the instances
SERVICE_GVL, ACTION_GVL = "ROS_Services", "ROS_Actions"
"""The lists of the instances of services and actions."""
SAFE_GVL = "ROS_Safe"  # the list that holds what a message becomes when its source is silent
PARAMETER_GVL, _PARAMETER_BLOCK = "ROS_Parameters", "RosPlc_Parameters"
_PROGRAMS = {"read": "Receives from ROS; call it first", "write": "Sends to ROS; call it last"}
_ON_STALE = {"hold": 0, "zero": 1, "value": 2}


def call(name: str, topic: PlcTopic, task: int, cycle_ns: int) -> str:
    """Return the configured call of a topic's instance; ``cycle_ns`` is 0 if the task has no interval."""
    gvl = READ_GVL if topic.direction == "read" else WRITE_GVL
    arguments = [f"uiTask := {task}", f"udiMapSize := {topic.object_size}"]
    if topic.classic is not None:
        arguments[1] = f"tWait := {time_literal(classic_wait(topic.classic, cycle_ns) * 1_000_000)}"
    arguments += read_arguments(topic, f"{SAFE_GVL}.{name}")
    if topic.max_age_ns:
        arguments.append(f"tMaxAge := {time_literal(topic.max_age_ns)}")
    return f"{gvl}.{name}({', '.join(arguments)});"


def read_arguments(topic: PlcTopic, safe: str = "") -> Iterator[str]:
    """Yield the arguments of a Read block's call; ``safe`` is the variable of the safe value, if any."""
    if topic.direction == "read":
        if topic.stale_after_ns:
            yield f"tStaleAfter := {time_literal(topic.stale_after_ns)}"
        if topic.on_stale != "hold":
            yield f"uiOnStale := {_ON_STALE[topic.on_stale]}"
        if topic.on_stale == "value" and topic.safe is not None and safe:
            yield f"stSafe := {safe}"
        if topic.in_order:
            yield "xInOrder := TRUE"
        if topic.latched:
            yield "xLatched := TRUE"


def programs_of(
    tasks: Sequence[PlcTask], calls: dict[tuple[str, str], list[str]], options: ProjectOptions, scope: Scope
) -> tuple[list[Pou], tuple[Task, ...]]:
    """Return the tasks, and a reading and a writing program for each task with topics."""
    programs: list[Pou] = []
    found: list[Task] = []
    used = {task for _, task in calls}
    for index, task in enumerate(tasks):
        names = []
        for direction, what in _PROGRAMS.items():
            lines = calls.get((direction, task.name), [])
            if direction == "read" and task.name in used:
                opening = f"RosPlc_State.axMayOpen[{index}] := TRUE; // one open attempt per scan"
                lines = [opening, *lines]
            if lines:
                wanted = f"{options.programs}_{direction.capitalize()}"
                names.append(scope.give(wanted if len(used) == 1 else f"{wanted}_{task.name}"))
                comment, text = f"{what} in task {task.name}.", "\n".join(lines)
                programs.append(Pou(names[-1], "PROGRAM", (), text, comment=comment, folder=options.folder))
        if names:
            found.append(Task(task, tuple(names)))
    return programs, tuple(found)


_LARGE_DUT = 64 * 1024
MOST_TASKS = 16  # as many as RosPlc_State.axMayOpen has elements
LONGEST_TOPIC = 255  # ASCII characters: FB_Init of RosPlc_Channel takes a STRING(255)
_TOPIC = re.compile(r"(/[A-Za-z_][A-Za-z0-9_]*)+\Z")
_TASK = re.compile(r"[A-Za-z_][A-Za-z0-9_]{0,63}\Z")
_PREFIX = re.compile(r"[A-Za-z][A-Za-z0-9_-]{0,31}\Z")
_CLIENT = re.compile(r"([A-Za-z][A-Za-z0-9_]{0,31})?\Z")
_LIBRARIES: tuple[str, ...] = ("SysShm", "SysMem", "SysTypes2 Interfaces")
_SETTINGS_GVL = "RosPlc_Settings"
_SAFE_COMMENT = """Safe values of messages while their source is silent, whether or not the bridge is running.
After you change them, download the program: an online change may keep the previous values."""


def call_role(call: CallPlan) -> str:
    """Return the role of the PLC: Client, Server, ActionClient or ActionServer."""
    return ("Action" if call.kind == "action" else "") + ("Server" if call.server == "plc" else "Client")


def call_name(call: CallPlan, duts: Sequence[str]) -> str:
    """Return the preferred name of the block; ``duts`` are the DUTs of its parts."""
    key = call_role(call), *call.layouts
    plain = list(duts) == [type_prefix(layout.type_name) for layout in call.layouts]
    own = "" if plain else "_" + hashlib.sha256(repr(key).encode()).hexdigest()[:6]
    return f"{type_prefix(call.type_name)}_{key[0]}{own}"


@dataclass
class _Blocks:
    """The function blocks of all types in use, each built once."""

    builder: DutBuilder
    options: ProjectOptions
    pous: list[Pou] = field(default_factory=list)
    _known: dict[tuple[str, bool, Layout], str] = field(default_factory=dict)
    _calls: dict[tuple[str | Layout, ...], str] = field(default_factory=dict)

    def name(self, layout: Layout, direction: str, *, classic: bool = False, part: bool = False) -> str:
        kind = f"{'Classic' if classic else ''}{direction.capitalize()}"
        key = (kind, part, layout)
        if key not in self._known:
            name = self._known[key] = self._named(f"{self.builder.add(layout)}_{kind}", layout.type_name)
            folder, pins = f"{self.options.folder}/Blocks", self.options.pins and not part
            self.pous.append(block(kind, layout, self.builder, name, folder, pins=pins, part=part))
        return self._known[key]

    def of_call(self, call: CallPlan) -> str:
        """Return the block of a service or action; build it and those of its parts if needed."""
        role = call_role(call)
        key: tuple[str | Layout, ...] = (role, *call.layouts)
        if key not in self._calls:
            parts = {}
            folder = f"{self.options.folder}/Blocks"
            for part, layout in zip(call.parts, call.layouts, strict=True):
                way = "write" if part.asks == (call.server == "ros") else "read"
                parts[part.word] = self.builder.add(layout), self.name(layout, way, part=True)
            wanted = call_name(call, [dut for dut, _ in parts.values()])
            name = self._calls[key] = self._named(wanted, call.type_name)
            self.pous.append(call_block(role, call.type_name, parts, name, folder))
        return self._calls[key]

    def _named(self, wanted: str, what: str) -> str:
        name = self.builder.scope.give(wanted)
        self.builder.note(f"block of {what}", wanted, name)
        return name


def build_project(
    store: TypeStore,
    topics: Sequence[PlcTopic],
    tasks: Sequence[PlcTask],
    options: ProjectOptions | None = None,
    *,
    layouts: Sequence[Layout] = (),
    calls: Sequence[CallPlan] = (),
    parameters: ParametersPlan | None = None,
) -> PlcProject:
    """Return the project for a set of topics, services and actions, each given once.

    ``tasks`` has every task that a topic uses, at most 16; ``layouts`` get both blocks, whether or not a
    topic uses them. Raises GenerationError PLC003 if there are more tasks than the blocks support, PLC005 if
    two task names are equal for CODESYS, PLC006 if a topic's name is too long for the blocks, PLC007 if a
    classic topic's memory or semaphore has an invalid name, PLC008 if a topic, task or prefix has one.
    """
    options = options or ProjectOptions()
    _check_name(_PREFIX, options.prefix, "prefix")
    _check_name(_TASK, options.programs, "programs")
    _check_tasks(tasks)
    _check_topics(topics)
    for use in calls:
        _check_ros_name(use.called, f"{use.kind}s")
        _check_name(_CLIENT, use.client, use.called)
    topics = sorted(topics, key=lambda item: item.topic)
    base, libraries = base_objects(f"{options.folder}/Base"), _LIBRARIES
    if any(topic.classic for topic in topics):
        base = (*base, *classic_objects(f"{options.folder}/Base"))
        libraries = (*_LIBRARIES, LIBRARY)
    if calls:
        actions = any(use.kind == "action" for use in calls)
        base = (*base, *call_objects(f"{options.folder}/Base", actions=actions))
    # All objects share one namespace with those that are written by hand.
    own = (
        *CLASSIC_NAMES, *CALL_NAMES, *ACTION_NAMES, *HELPER_NAMES, *chain(*OWN_NAMES.values()),
        READ_GVL, WRITE_GVL, SERVICE_GVL, ACTION_GVL, SAFE_GVL, _SETTINGS_GVL,
        PARAMETER_GVL, _PARAMETER_BLOCK,
    )  # fmt: skip
    builder = DutBuilder(store, f"{options.folder}/Types", Scope([*(item.name for item in base), *own]))
    blocks = _Blocks(builder, options)
    for layout in sorted(layouts, key=lambda item: item.type_name):
        blocks.name(layout, "read")
        blocks.name(layout, "write")
    names = {
        direction: instance_names([topic.topic for topic in topics if topic.direction == direction])
        for direction in ("read", "write")
    }
    instances: dict[str, list[Variable]] = {"read": [], "write": []}
    lines: dict[tuple[str, str], list[str]] = {}
    own_blocks: tuple[Item, ...] = ()
    order = sorted(tasks, key=lambda task: task.name)
    indices = {task.name: index for index, task in enumerate(order)}
    cycles = {task.name: task.interval_ns if task.kind == "cyclic" else 0 for task in tasks}
    for topic in topics:
        block_name = blocks.name(topic.layout, topic.direction, classic=topic.classic is not None)
        wanted, name = plain_name(topic.topic), names[topic.direction][topic.topic]
        builder.note(f"instance of {topic.topic}", wanted, name)
        if topic.own:
            types = builder.members(topic.layout)
            values = {"block": block_name, "instance": name, "task": topic.task, "types": types}
            block_name = OWN_NAMES[topic.own][0]
            if not any(item.name == block_name for item in own_blocks):
                own_blocks += read_objects("own", OWN_NAMES[topic.own], f"{options.folder}/Blocks", **values)
        names_of = {"sTopic": topic.topic}
        if topic.classic is not None:
            names_of = {"sMemory": topic.classic.name, "sSemaphore": topic.classic.semaphore}
        arguments = tuple((key, string_literal(text)) for key, text in names_of.items())
        instances[topic.direction].append(Variable(name, block_name, None, _what(topic), arguments))
        line = call(name, topic, indices[topic.task], cycles[topic.task])
        lines.setdefault((topic.direction, topic.task), []).append(line)
    of_calls = {gvl: _uses(gvl, calls, blocks, indices, lines) for gvl in (SERVICE_GVL, ACTION_GVL)}
    variables: list[Variable] = []
    if parameters is not None:
        pou, variables = _parameters(parameters, names, builder, options)
        blocks.pous.append(pou)
        lines["read", parameters.task].append(f"{PARAMETER_GVL}.block();")
    programs, found_tasks = programs_of(order, lines, options, builder.scope)
    helpers = helper_objects(store, builder, f"{options.folder}/Helpers")
    hand_written = (*base, *helpers, *own_blocks)
    gvls = [*(item for item in base if isinstance(item, Gvl)), _settings(options, order), *builder.constants]

    def add_list(name: str, variables: Sequence[Variable], comment: str, *, constant: bool = False) -> None:
        if variables:
            block_ = VarBlock("VAR_GLOBAL", tuple(variables), constant)
            gvls.append(Gvl(name, (block_,), (("qualified_only", ""),), comment, options.folder))

    one_each = "One function block per topic; programs of the project"
    add_list(READ_GVL, instances["read"], f"{one_each} use their outputs.")
    add_list(WRITE_GVL, instances["write"], f"{one_each} set msg.")
    for gvl, found in of_calls.items():
        add_list(gvl, found, "One function block per client or server; programs of the project use its pins.")
    add_list(PARAMETER_GVL, variables, "The parameters of the bridge's node; programs read and set values.")
    add_list(SAFE_GVL, _safe(topics, names["read"], builder), _SAFE_COMMENT, constant=True)
    return PlcProject(
        options.folder,
        duts=(*(item for item in hand_written if isinstance(item, Dut | Enumeration)), *builder.duts),
        gvls=tuple(gvls),
        pous=(*(item for item in hand_written if isinstance(item, Pou)), *blocks.pous, *programs),
        tasks=found_tasks,
        libraries=libraries,
        notes=tuple(_notes(builder, topics, cycles, options)),
        programs=options.programs,
    )


def _uses(
    gvl: str,
    calls: Sequence[CallPlan],
    blocks: _Blocks,
    indices: dict[str, int],
    lines: dict[tuple[str, str], list[str]],
) -> list[Variable]:
    """Return the instances of a list, and add their calls to the reading programs."""
    found = []
    for (key, use), name in use_names(gvl, calls):
        wanted = plain_name(key).replace("-", "_")
        blocks.builder.note(f"instance of {key}", wanted, name)
        client = use.server == "ros"
        arguments = [("sName", string_literal(use.called))]
        if client:
            arguments.append(("sClient", string_literal(use.client)))
        comment = f"{use.type_name} in task {use.task}; the PLC is the {'client' if client else 'server'}"
        found.append(Variable(name, blocks.of_call(use), None, comment, tuple(arguments)))
        lines.setdefault(("read", use.task), []).append(f"{gvl}.{name}(uiTask := {indices[use.task]});")
    return found


def use_names(gvl: str, calls: Sequence[CallPlan]) -> list[tuple[tuple[str, CallPlan], str]]:
    """Return the content of a list of instances, in the order of object names: key, use, instance name."""
    some = [use for use in calls if (use.kind == "action") == (gvl == ACTION_GVL)]
    uses = {f"{use.called}-{use.client}".rstrip("-"): use for use in some}
    names = instance_names(list(uses))
    return [(item, names[item[0]]) for item in sorted(uses.items())]


def build_type_library(
    store: TypeStore, layouts: Sequence[Layout], options: ProjectOptions | None = None
) -> PlcProject:
    """Return a project with both blocks of each layout and no topics or tasks."""
    return build_project(store, (), (), options, layouts=layouts)


def _check_tasks(tasks: Sequence[PlcTask]) -> None:
    if len(tasks) > MOST_TASKS:
        raise GenerationError("PLC003", f"the topics use {len(tasks)} tasks", where="tasks")
    seen: dict[str, str] = {}
    for task in tasks:
        _check_name(_TASK, task.name, "tasks")
        other = seen.setdefault(task.name.upper(), task.name)
        if other != task.name:
            raise GenerationError("PLC005", f"{other} and {task.name} differ only in case", where="tasks")


def _check_topics(topics: Sequence[PlcTopic]) -> None:
    for topic in topics:
        _check_ros_name(topic.topic, "topics")
        if topic.classic is not None:
            check_classic(topic.topic, topic.classic)


def _check_ros_name(name: str, where: str) -> None:
    # CODESYS would cut the literal off without a word, and the block look for another object.
    if len(name) > LONGEST_TOPIC:
        raise GenerationError(
            "PLC006", f"the name has {len(name)} characters", where=name[: 2 * LONGEST_TOPIC]
        )
    _check_name(_TOPIC, name, where)


def _check_name(pattern: re.Pattern[str], name: str, where: str) -> None:
    """Refuse an invalid name before it is used in comments and literals."""
    if not pattern.match(name):
        raise GenerationError("PLC008", f"{name[:80]!r} is not a valid name", where=where)


def _settings(options: ProjectOptions, tasks: Sequence[PlcTask]) -> Gvl:
    beats = [str(max(beat_ms(task), options.beat_ms)) for task in tasks]
    if len(beats) < MOST_TASKS:
        beats.append(f"{MOST_TASKS - len(beats)}({UNKNOWN_BEAT_MS})")
    text = render("RosPlc_Settings.st", version=__version__, options=options, beats=beats, most=MOST_TASKS)
    settings = parse_object(text, _SETTINGS_GVL, f"{options.folder}/Base")
    assert isinstance(settings, Gvl)
    return settings


def _safe(topics: Sequence[PlcTopic], names: dict[str, str], builder: DutBuilder) -> list[Variable]:
    """Return the constants with the safe values of topics."""
    return [
        Variable(
            names[topic.topic],
            builder.add(topic.layout),
            initial_value(topic.layout.root, topic.safe, builder),
            f"for {topic.topic} after {time_literal(topic.stale_after_ns)} of silence",
        )
        for topic in topics
        if topic.direction == "read" and topic.on_stale == "value" and topic.safe is not None
    ]


def _parameters(
    plan: ParametersPlan, names: Mapping[str, Mapping[str, str]], builder: DutBuilder, options: ProjectOptions
) -> tuple[Pou, list[Variable]]:
    """Return the block for the parameters, and the variables of their list."""
    builder.add(plan.layout)
    values = next(member.node for member in plan.layout.root.members if member.name == "values")
    assert isinstance(values, StructNode)
    dut = builder.struct(values).dut
    ends = {
        "wanted": f"{READ_GVL}.{names['read'][WANTED]}",
        "current": f"{WRITE_GVL}.{names['write'][CURRENT]}",
    }
    text = render(
        f"blocks/{_PARAMETER_BLOCK}.st", dut=dut, gvl=PARAMETER_GVL, plc=plan.initial == "plc", **ends
    )
    pou = parse_object(text, _PARAMETER_BLOCK, f"{options.folder}/Blocks")
    assert isinstance(pou, Pou)
    initial = initial_value(values, {plan.fields[each.name]: each.value for each in plan.declared}, builder)
    return pou, [
        Variable("values", dut, initial, "the current values; a program may change them"),
        Variable("block", _PARAMETER_BLOCK, None, "takes values set in ROS, and reports the current values"),
    ]


def _what(topic: PlcTopic) -> str:
    """Describe an instance in one line."""
    which = ""
    if topic.classic is not None:
        which = ", classic"
    elif topic.direction == "read":
        which = ", every message" if topic.in_order else ", the newest message"
    return f"{topic.layout.type_name} in task {topic.task}{which}"


def _notes(
    builder: DutBuilder, topics: Sequence[PlcTopic], cycles: dict[str, int], options: ProjectOptions
) -> list[str]:
    notes = [*builder.renamings, *builder.omitted]
    for topic in topics:
        if topic.classic is not None and (cycle := cycles.get(topic.task, 0)):
            wait, half = -(-topic.classic.wait_ns // 1_000_000), classic_wait(topic.classic, cycle)
            if half < wait:
                notes.append(
                    f"{topic.topic}: the wait for its lock is reduced from {wait} ms to {half} ms, "
                    f"half the interval of task {topic.task}"
                )
        if topic.layout.size > _LARGE_DUT:
            copies = (4 if topic.classic else 3) if topic.direction == "read" else 1
            notes.append(
                f"{topic.topic}: {topic.layout.type_name} takes {copies} × {topic.layout.size} bytes "
                "in the PLC; check the size of the application's data area"
            )
        if topic.in_order and topic.direction == "read" and not options.fenced:
            notes.append(
                f"{topic.topic}: without a memory fence, the PLC reads at most one message every two scans; "
                "at a higher sustained rate, messages are lost and counted"
            )
    return notes


def plc_project(project: Project, options: ProjectOptions) -> PlcProject:
    """Return the PLC project of a configuration; PLC003 if it uses more tasks than the blocks support."""
    topics, tasks = plc_topics(project), plc_tasks(project)
    settings = project.config.settings
    options = replace(options, prefix=settings.prefix)
    return build_project(
        project.store, topics, tasks, options, calls=project.calls, parameters=project.parameters
    )


def plc_topics(project: Project) -> list[PlcTopic]:
    """Return a configuration's topics as seen by the PLC."""
    return [
        PlcTopic(
            topic=plan.topic,
            layout=plan.layout,
            direction="read" if plan.direction == Direction.TO_PLC else "write",
            task=plan.task,
            object_size=object_plans(project, plan)[Part.TOPIC].object_size if plan.port == "channel" else 0,
            stale_after_ns=plan.stale_after_ns,
            on_stale=plan.on_stale.action if plan.on_stale.action in ("zero", "value") else "hold",
            safe=plan.on_stale.value if plan.on_stale.action == "value" else None,
            in_order=plan.every,
            latched=plan.latched,
            classic=plan.classic,
            own="" if plan.own == "parameters" else plan.own,
            max_age_ns=plan.transform.max_age_ns if plan.transform else 0,
        )
        for plan in project.topics
    ]


def plc_tasks(project: Project) -> list[PlcTask]:
    """Return the tasks that a configuration's topics, services and actions use."""
    used = {plan.task for plan in project.plans}
    tasks = {name: task for name, task in project.config.settings.tasks.items() if name in used}
    same = ("interval_ns", "priority", "kind", "watchdog_sensitivity")
    return [
        PlcTask(name, **{each: getattr(task, each) for each in same}, watchdog_ns=task.watchdog_ns or 0)
        for name, task in tasks.items()
    ]
