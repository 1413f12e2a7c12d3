"""From settings to types, layouts and sizes: checks before anything is opened disturb no running system."""

from __future__ import annotations

import grp
import pwd
import stat
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Literal, TypeAlias

from rosplc.config.file import Config, read_config
from rosplc.config.parameters import CURRENT, TYPE, WANTED, ParametersPlan, parameters_plan
from rosplc.config.plans import (
    ActionPlan,
    CallPlan,
    ClassicPlan,
    ServicePlan,
    StalePlan,
    call_plans,
    classic_name,
    classic_plan,
    note_layout_error,
    passes_changes_only,
    slot_numbers,
    stale_plan,
)
from rosplc.config.quantities import format_duration
from rosplc.config.transforms import DEFINITION, FRAME_BYTES, TYPE_NAME
from rosplc.config.yaml_source import Absent, KeyPath, Problems
from rosplc.described import description_of
from rosplc.errors import ConfigError, LayoutError, RosplcError
from rosplc.layout import Layout, Limits, compute_layout
from rosplc.model import TypeStore
from rosplc.ros import PRESETS, ROS1, Qos
from rosplc.shm import Description, Direction, Identity, Namespace, Part
from rosplc.shm.constants import HEADER_SIZE, LINE_SIZE, MAX_DESCRIPTION_SIZE, MAX_OBJECT_SIZE, MIN_SLOTS
from rosplc.shm.files import Rights
from rosplc.shm.names import partnered

if TYPE_CHECKING:
    from rosplc.config.settings import TaskSettings, TopicSettings, TransformSettings

TIME_TYPE = "rosplc/msg/RosTime"  # what the PLC's block for ROS time reads
TIME_TEXT = "uint64 now\nuint32 transfer\nbool sim\n"  # both in ns; the most that a message took of late
OWN_SETTINGS = ("zenoh", "rclpy")  # backends that have a section
_ROS2 = ("dds", "rclpy", "zenoh")
_LARGEST_ID = 2**32 - 2
_TO_PLC = Qos(reliability="reliable", durability="volatile", depth=1000)
_TO_ROS = PRESETS["latched"]
_STALE_NS = {"plc": 1_000_000_000, "ros": 0}


Own: TypeAlias = Literal["", "log", "time", "pose", "parameters"]


@dataclass(frozen=True)
class TopicPlan:
    """One topic with everything decided."""

    topic: str  # the topic as ROS writes it
    type_name: str  # ``package/msg/Name``
    direction: Direction  # where its messages go
    layout: Layout  # the record's layout
    qos: Qos  # quality of service on the ROS side
    slots: int = 4  # slots of the object, a power of two
    every: bool = False  # every message counts, in order; otherwise the newest alone
    # a message from before counts: a PLC that starts takes it as new, a bridge that starts
    # publishes it again, and in classic memory it is a message
    latched: bool = False
    task: str = ""  # name of the PLC task
    min_interval_ns: int = 0  # shortest time between two messages passed on; 0 for no limit
    stale_after_ns: int = 0  # age at which the last message counts as stale; 0 for never
    on_stale: StalePlan = field(default_factory=StalePlan)  # what is there while the source is silent
    on_change: bool = False  # only messages that differ from the one before are passed on
    truncate: bool = False  # what does not fit is cut, not refused
    print: bool = False  # each message is logged
    classic: ClassicPlan | None = None  # set for a topic in classic mode: a bare record instead of a channel
    own: Own = ""  # what the bridge itself has it for; it is no topic of ROS then
    transform: TransformSettings | None = None  # set for a topic that no node publishes: the bridge fills it

    @property
    def name(self) -> str:
        """What people call it; no other topic or service of the configuration has it."""
        return self.topic

    @property
    def layouts(self) -> tuple[Layout, ...]:
        """The layouts of its messages."""
        return (self.layout,)

    @property
    def port(self) -> Literal["channel", "classic"]:
        """The kind of port that carries it: an object of the project's format, or classic memory."""
        return "channel" if self.classic is None else "classic"


Plan: TypeAlias = "TopicPlan | CallPlan"  # what a bridge carries: a topic, or one use of a service or action


@dataclass(frozen=True)
class Project:
    """A configuration with its types and layouts."""

    config: Config  # the settings and their file
    store: TypeStore  # the message types
    namespace: Namespace  # the names of the objects
    topics: tuple[TopicPlan, ...]  # one plan per topic, in the file's order
    services: tuple[ServicePlan, ...] = ()  # one plan per use
    actions: tuple[ActionPlan, ...] = ()  # one plan per use
    parameters: ParametersPlan | None = None  # the last two of ``topics`` belong to them

    @property
    def calls(self) -> tuple[CallPlan, ...]:
        """The plans of services, then actions."""
        return (*self.services, *self.actions)

    @property
    def plans(self) -> tuple[Plan, ...]:
        """The plans of topics, services and actions, in this order."""
        return (*self.topics, *self.calls)

    def topic(self, name: str) -> TopicPlan:
        """Return a topic's plan; KeyError if the topic is not configured."""
        for plan in self.topics:
            if plan.topic == name:
                return plan
        raise KeyError(name)

    def object_name(self, plan: TopicPlan) -> str:
        """Return the name of a topic's object or classic memory, without its directory."""
        return object_name(self.namespace, plan)

    @property
    def tasks(self) -> dict[str, TaskSettings]:
        """The PLC's tasks by name."""
        return self.config.settings.tasks


def object_name(namespace: Namespace, plan: Plan) -> str:
    """Return the name of a topic's object or memory, or of the caller's object, without its directory."""
    if isinstance(plan, CallPlan):
        return namespace.object_name(plan.called, plan.parts[0], plan.client)
    return namespace.object_name(plan.topic) if plan.classic is None else plan.classic.name


def load_config(path: Path | str) -> Config:
    """Read a file and check it, types and sizes included; ConfigErrors have file, line and key each."""
    return load_project(path).config


def load_project(path: Path | str) -> Project:
    """Read and check a configuration file, including its types and sizes.

    Raises ConfigErrors: As :func:`~rosplc.check`.
    """
    return resolve(read_config(path))


def resolve(config: Config) -> Project:
    """Find types, compute layouts and sizes.

    ConfigErrors: CFG001 (folders), CFG004, CFG007, CFG008, SHM118; TYP001 … 008, LAY001 … 006 at the topic.
    """
    problems = Problems()
    settings = config.settings
    check_ros(config, problems)
    store = _store(config, problems)
    problems.check()
    if settings.transforms:
        store = store.with_definition(TYPE_NAME, DEFINITION)
    namespace = Namespace(settings.prefix, settings.shm.directory)
    plans = []
    names: dict[str, str] = {}
    parameters = parameters_plan(config, store, problems)
    if parameters is not None:
        store = parameters.layout.store
    for where, topic, entry, own in _topics_of(config, parameters):
        name = namespace.object_name(topic)
        if entry.classic is not None:
            name = entry.classic.name or classic_name(topic)
        if name in names:
            key, what = where, f"{topic} and {names[name]} have the same object name, {name}"
            if own and topic in settings.topics:
                key, what = ("topics", topic), f"the bridge itself already carries {topic} for the PLC"
            problems.wrong(config.source, key, what, "", "CFG007")
        names[name] = topic
        task = config.task(entry.task, (*where, "task"), problems)
        layout = _layout(config, store, topic, entry, problems)
        if layout is None or task not in settings.tasks:
            continue
        try:
            transform = settings.transforms[str(where[1])] if own == "pose" else None
            made = _plan(config, topic, entry, task, layout)
            plans.append(replace(made, own=own, transform=transform))
        except (ConfigError, LayoutError) as error:
            wrong = "slots" if entry.classic is None else "classic"
            problems.add(error, config.source.line((*where, wrong)))
    services = tuple(call_plans(config, ServicePlan, store, problems))
    actions = tuple(call_plans(config, ActionPlan, store, problems))
    problems.check()
    return Project(config, store, namespace, tuple(plans), services, actions, parameters)


def _topics_of(
    config: Config, parameters: ParametersPlan | None
) -> Iterator[tuple[KeyPath, str, TopicSettings, Own]]:
    """Yield where each topic is configured, its name and settings, and what the bridge itself has it for."""
    from rosplc.config.settings import TopicSettings

    settings = config.settings
    for topic, entry in settings.topics.items():
        yield ("topics", topic), topic, entry, ""
    if settings.rosout.plc:
        log = "rosgraph_msgs/msg/Log" if settings.ros.distro == ROS1 else "rcl_interfaces/msg/Log"
        limits = {"string": 1, "sequence": 1, "msg": 200}  # the bridge fills in the other texts
        entry = TopicSettings(type=log, to="ros", task=settings.rosout.task, limits=limits)
        yield ("rosout",), "/rosout", entry, "log"
    if settings.time.plc:
        yield (
            ("time",),
            "/ros_time",
            TopicSettings(type=TIME_TYPE, to="plc", task=settings.time.task),
            "time",
        )
    for name, wanted in settings.transforms.items():
        shared = {"type": TYPE_NAME, "to": "plc", "task": wanted.task, "limits": {"frame": FRAME_BYTES}}
        times = {"expected_rate": wanted.rate_ns, "stale_after": max(10**9, 3 * wanted.rate_ns)}
        entry = TopicSettings.model_validate(shared | {key: f"{ns}ns" for key, ns in times.items()})
        yield ("transforms", name), f"/transforms/{name}", entry, "pose"
    if parameters is not None:
        limits = dict(parameters.layout.limits.fields)
        usual = {"type": TYPE, "task": parameters.task, "limits": limits, "every": False}
        # A PLC that starts takes what was wanted last, unless its own values count.
        for topic, to, latched in ((WANTED, "plc", parameters.initial == "file"), (CURRENT, "ros", True)):
            entry = TopicSettings.model_validate(
                {**usual, "to": to, "latched": latched, "stale_after": "never"}
            )
            yield ("parameters",), topic, entry, "parameters"


def _store(config: Config, problems: Problems) -> TypeStore:
    store = TypeStore.bundled(config.settings.ros.distro)
    if config.settings.time.plc:
        store = store.with_definition(TIME_TYPE, TIME_TEXT)
    paths = {folder: index for index, folder in enumerate(config.type_folders)}
    while True:
        try:
            return store.with_paths(paths)
        except RosplcError as error:
            wrong = next((path for path in paths if str(path) == error.where), None)
            if wrong is None:
                problems.add(error)
                return store
            key = ("types", "paths", paths.pop(wrong))
            if wrong.exists():
                problems.move(error, config.source, key)
            else:
                absent = Absent("CFG001", f"{wrong} does not exist", where=config.source.place(key))
                problems.add(absent, config.source.line(key))


def _layout(
    config: Config, store: TypeStore, topic: str, entry: TopicSettings, problems: Problems
) -> Layout | None:
    defaults, fields = config.settings.limits, dict(entry.limits)
    try:
        own = {field.name for field in store[entry.type].fields}
        # A type's own field `string` or `sequence` wins over the topic's default of that name.
        string = fields.pop("string", defaults.string) if "string" not in own else defaults.string
        sequence = fields.pop("sequence", defaults.sequence) if "sequence" not in own else defaults.sequence
        return compute_layout(store, entry.type, Limits(string, sequence, fields))
    except RosplcError as error:
        note_layout_error(error, config, ("topics", topic), problems)
        return None


def _plan(config: Config, topic: str, entry: TopicSettings, task: str, layout: Layout) -> TopicPlan:
    to_plc = entry.to == "plc"
    qos = _qos(entry)
    backend = config.settings.ros.backend
    if qos.promises and (backend not in ("auto", "dds") or layout.store.ros_version == 1):
        what = f"only the dds backend (ROS 2) supports deadline and lease; ros.backend is {backend}"
        raise config.source.wrong(("topics", topic, "qos"), what, "Remove both; stale_after still works.")
    classic = classic_plan(config, topic, entry, task)
    every = entry.every if entry.every is not None else not to_plc and classic is None
    stale = entry.stale_after_ns if entry.stale_after_ns is not None else _STALE_NS[entry.to]
    slots = 1 if classic else _slots(config, topic, entry, task, layout.size, every)
    if slots * (layout.size + 2 * LINE_SIZE) + HEADER_SIZE + MAX_DESCRIPTION_SIZE > MAX_OBJECT_SIZE:
        raise LayoutError(
            "LAY003",
            f"{slots} slots of {layout.size} bytes exceed the maximum object size of 2 GiB",
            where=config.source.place(("topics", topic, "slots")),
            remedy="Lower the limits of the largest fields, or the number of slots.",
        )
    return TopicPlan(
        topic=topic,
        type_name=layout.type_name,
        direction=Direction.TO_PLC if to_plc else Direction.TO_ROS,
        layout=layout,
        qos=qos,
        slots=slots,
        every=every,
        latched=_latched(entry),
        task=task,
        min_interval_ns=entry.rate_limit_ns or 0,
        stale_after_ns=stale,
        on_stale=stale_plan(config, topic, entry, layout, stale),
        on_change=passes_changes_only(entry),
        truncate=entry.on_overflow == "truncate",
        print=entry.print,
        classic=classic,
    )


def _latched(entry: TopicSettings) -> bool:
    if entry.latched is not None:
        return entry.latched
    # Only where it is written: for messages to ROS, transient local is the default.
    preset = PRESETS[entry.qos.preset].durability if entry.qos.preset else "volatile"
    return (entry.qos.durability or preset) == "transient_local"


def _qos(entry: TopicSettings) -> Qos:
    asked = entry.qos
    base = PRESETS[asked.preset] if asked.preset else _TO_PLC if entry.to == "plc" else _TO_ROS
    usual = {None: base.durability, True: "transient_local", False: "volatile"}[entry.latched]
    return Qos(
        asked.reliability or base.reliability,
        asked.durability or usual,
        asked.depth or base.depth,
        deadline_ns=asked.deadline_ns or 0,
        lease_ns=asked.lease_ns or 0,
    )


def _slots(config: Config, topic: str, entry: TopicSettings, task: str, record_size: int, every: bool) -> int:
    settings = config.settings
    cycle = settings.tasks[task].interval_ns
    if entry.to == "ros":
        # A PLC publishes a topic at most once per scan; how long a freewheeling scan takes, nobody knows.
        period = cycle if settings.tasks[task].kind == "cyclic" else 0
        fastest = max(entry.expected_rate_ns or 0, period)
        least, usual = slot_numbers(fastest, settings.tick_ns, record_size, every, by_bridge=True)
    else:
        # Where neither is given nothing is known, and the usual number stands.
        fastest = max(entry.expected_rate_ns or 0, entry.rate_limit_ns or 0)
        least, usual = slot_numbers(fastest, cycle, record_size, every)
    if entry.slots is None:
        return usual
    slots = 1 << (entry.slots - 1).bit_length()
    if slots < least:
        what = (
            f"{entry.slots} slots are too few for a message of {record_size} bytes "
            f"every {format_duration(fastest)}; at least {least} are needed"
        )
        raise config.source.wrong(("topics", topic, "slots"), what, code="CFG008")
    return slots


def check_ros(config: Config, problems: Problems) -> None:
    """Note what contradicts itself in the section ``ros``."""
    ros, refuse = config.settings.ros, partial(problems.wrong, config.source)
    if ros.backend in _ROS2 and ros.distro == ROS1:
        what = f"the {ros.backend} backend is for ROS 2, but {ROS1} is ROS 1"
        refuse(("ros", "backend"), what, "Write `backend: rospy` (or auto), or choose a ROS 2 distro.")
    if ros.backend == "rospy" and ros.distro != ROS1:
        known = "" if "distro" in ros.model_fields_set else " (the default)"
        what = f"the rospy backend is for ROS 1, but {ros.distro}{known} is ROS 2"
        refuse(("ros", "backend"), what, f"Write `distro: {ROS1}`, or `backend: auto`.")
    for name in OWN_SETTINGS:
        if getattr(ros, name) is None:
            continue
        if ros.backend not in ("auto", name):
            what = f"these settings are for the {name} backend, but ros.backend is {ros.backend}"
            refuse(("ros", name), what, f"Write `backend: {name}`, or remove them.")
        elif ros.distro == ROS1:
            what = f"these settings are for the {name} backend, which is for ROS 2; {ROS1} is ROS 1"
            refuse(("ros", name), what, "Remove them, or choose a ROS 2 distro.")
    if ros.zenoh is not None and ros.zenoh.config is not None:
        path = config.base / ros.zenoh.config
        if not path.is_file():
            refuse(("ros", "zenoh", "config"), f"{path} is not a file", "Correct the path.", "CFG001")


def describe(plan: Plan, part: Part = Part.TOPIC, *, distro: str, bridge: str) -> Description:
    """Return an object's self-description (spec/shm-format.md, section 6), without a call's partners."""
    if isinstance(plan, TopicPlan):
        return description_of(plan.layout, plan.topic, plan.direction, bridge=bridge, distro=distro)
    names, way = {"bridge": bridge, "distro": distro, "client": plan.client}, part.direction(plan.server)
    return description_of(plan.layout(part), plan.called, way, part=part, **names)


def object_plans(project: Project, plan: Plan) -> dict[Part, Identity]:
    """Return the geometry of the objects that the bridge will make; who made them is left open."""
    settings = project.config.settings
    parts, sizes = (Part.TOPIC,) if isinstance(plan, TopicPlan) else plan.parts, plan.layouts
    about = [describe(plan, each, distro=settings.ros.distro, bridge=settings.bridge) for each in parts]
    slots = plan.slots if isinstance(plan, TopicPlan) else MIN_SLOTS
    return {
        each.part: each.plan(size.size, slots) for each, size in zip(partnered(about), sizes, strict=True)
    }


def open_doors(config: Config) -> list[str]:
    """Return a sentence for each way in which every user of the machine may read or write the objects."""
    shm = config.settings.shm
    found = []
    if shm.mode & 0o006:
        verbs = {0o2: "write", 0o4: "read", 0o6: "read and write"}[shm.mode & 0o006]
        found.append(
            f"shm.mode {shm.mode:04o} lets every user of this machine {verbs} the objects; "
            'use "0660" and a group in shm.group'
        )
    try:
        mode = Path(shm.directory).stat().st_mode
    except OSError:
        return found  # opening it says so
    if mode & stat.S_IWOTH and not mode & stat.S_ISVTX:
        found.append(
            f"{shm.directory} has mode {stat.S_IMODE(mode):04o}: every user of this machine may remove and "
            f"replace the objects there; `chmod +t {shm.directory}` prevents this"
        )
    return found


def rights(config: Config) -> Rights:
    """Return mode, owner and group of the objects. Raises CFG004 for an unknown user or group."""
    uid = _id(config, "owner", "user", lambda name: pwd.getpwnam(name).pw_uid)
    gid = _id(config, "group", "group", lambda name: grp.getgrnam(name).gr_gid)
    return Rights(config.settings.shm.mode, uid, gid)


def _id(config: Config, key: str, kind: str, find: Callable[[str], int]) -> int | None:
    given: str | int | None = getattr(config.settings.shm, key)
    place = config.source.place(("shm", key))
    if isinstance(given, str):
        try:
            return find(given)
        except KeyError:
            what = f"there is no {kind} {given!r} on this machine"
            remedy = "Create it, or choose another; `getent passwd` and `getent group` list users and groups."
            raise Absent("CFG004", what, where=place, remedy=remedy) from None
    # -1 and its unsigned twin would mean "leave it as it is" to the kernel.
    if given is not None and not 0 <= given <= _LARGEST_ID:
        raise ConfigError("CFG004", f"{given} is not between 0 and {_LARGEST_ID}", where=place)
    return given
