"""What the configuration decides about a topic (classic memory, silence, slots), and each use of a call."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, Any, ClassVar, Literal, TypeAlias, TypeVar

from rosplc.config.file import Config
from rosplc.config.quantities import format_duration, parse_duration
from rosplc.config.yaml_source import KeyPath, Problems
from rosplc.errors import ConfigError, LayoutError, RosplcError
from rosplc.layout import Layout, Limits, compute_layout
from rosplc.model import TypeStore
from rosplc.ros import SERVICES, Qos
from rosplc.shm import ACTION, SERVICE, Part
from rosplc.shm.constants import MAX_NAME
from rosplc.shm.names import Call

if TYPE_CHECKING:
    from rosplc.config.settings import ActionSettings, ServiceSettings, TopicSettings


@dataclass(frozen=True)
class ClassicPlan:
    """A topic whose record stands alone at offset 0 of a shared memory, guarded by a semaphore."""

    name: str  # the memory's name, without a slash: ``/dev/shm/NAME``
    semaphore: str  # the semaphore's name, ``/dev/shm/sem.NAME``; empty if nothing guards the memory
    wait_ns: int = 5_000_000  # how long a side tries to get the lock before it leaves it for the next time
    # how long the lock must be held, without any sign of life, before its holder counts as dead
    recover_after_ns: int = 1_000_000_000
    poll_ns: int = 1_000_000  # to ROS: time between two looks at the memory


def classic_name(topic: str) -> str:
    """Return the name that a topic's memory has by default: ``/robot1/cmd_vel`` is ``robot1.cmd_vel``.

    A topic without a namespace keeps its name, as existing projects have it. A name in shared
    memory has no slash, and a topic no dot, so no two topics get one name.
    """
    return topic[1:].replace("/", ".")


def passes_changes_only(entry: TopicSettings) -> bool:
    """Return whether a topic passes on changes alone; nothing else tells of news in classic memory."""
    by_default = entry.classic is not None and entry.to == "ros" and "on_change" not in entry.model_fields_set
    return entry.on_change or by_default


def classic_plan(config: Config, topic: str, entry: TopicSettings, task: str) -> ClassicPlan | None:
    """Return a topic's classic mode, None if it has a channel; CFG004: an invalid name, or not /dev/shm."""
    asked, settings = entry.classic, config.settings
    if asked is None:
        return None
    name = asked.name or classic_name(topic)
    key = ("topics", topic, "classic")
    if len(name) > MAX_NAME:
        what = f"the name {name!r} has {len(name)} characters; a PLC's STRING is limited to {MAX_NAME}"
        raise config.source.wrong(key, what, "Set a shorter name with classic: {name: …}.")
    if name.startswith(settings.prefix + "."):
        what = f"the name {name!r} begins with {settings.prefix}., which is reserved for the bridge's objects"
        raise config.source.wrong(key, what, "Set another name with classic: {name: …}.")
    if settings.shm.directory != "/dev/shm":
        what = "classic topics and their semaphores must be in /dev/shm, but shm.directory is "
        raise config.source.wrong(key, what + settings.shm.directory)
    poll = settings.tick_ns
    if not passes_changes_only(entry) and entry.to == "ros":
        # Every look is a message here; a PLC has something new to say once per cycle at most.
        poll = entry.rate_limit_ns or entry.expected_rate_ns or settings.tasks[task].interval_ns
    semaphore = "" if asked.semaphore == "none" else asked.semaphore or name
    return ClassicPlan(name, semaphore, asked.wait_ns, asked.recover_after_ns, poll)


_SHORTEST_NS = parse_duration("1ms")


@dataclass(frozen=True)
class StalePlan:
    """What is there while a topic's source is silent."""

    # to the PLC ``hold`` the last message, ``zero``, or ``value``; to ROS ``stop`` or ``substitute``
    action: Literal["hold", "zero", "value", "stop", "substitute"] = "hold"
    # the fields of the message that takes the source's place; what it lacks is initial
    value: Mapping[str, Any] = field(default_factory=dict)
    record: bytes = b""  # the same as a record; empty unless there is such a message
    period_ns: int = 0  # to ROS: time between two substitutes


def flag_topic(topic: str) -> str:
    """Return the topic on which ROS sees whether substitutes are being published: std_msgs/msg/Bool."""
    return f"{topic}/substituted"


def stale_plan(config: Config, topic: str, entry: TopicSettings, layout: Layout, stale_ns: int) -> StalePlan:
    """Return what a source's silence of ``stale_ns`` (0: never) causes; CFG004 at the line that is wrong."""
    asked = entry.on_stale
    if asked is None:
        return StalePlan("hold" if entry.to == "plc" else "stop")
    key: tuple[str | int, ...] = ("topics", topic, "on_stale")

    def wrong(what: str, remedy: str = "", at: tuple[str | int, ...] = key) -> ConfigError:
        return config.source.wrong(at, what, remedy)

    if isinstance(asked, str):
        if (asked == "stop") != (entry.to == "ros"):
            right = "hold, zero or {value: …}" if entry.to == "plc" else "stop or {value: …, period: …}"
            raise wrong(f"{asked!r} cannot be used with to: {entry.to}", f"Write {right}.")
        if asked == "zero":
            _check_silence(entry, stale_ns, wrong)
        return StalePlan(asked)
    _check_silence(entry, stale_ns, wrong)
    record = checked_record(config, asked.value, layout, (*key, "value"))
    if entry.to == "plc":
        if asked.period_ns is not None:
            what = "a PLC block provides the value in every scan, so period has no effect"
            raise wrong(what, "Remove period.", (*key, "period"))
        return StalePlan("value", asked.value, record)
    if asked.period_ns is None:
        raise wrong("'period' is missing", "Add the interval between messages, such as period: 100ms.")
    if asked.period_ns < _SHORTEST_NS:
        raise wrong(f"{format_duration(asked.period_ns)} is below the minimum, 1ms", at=(*key, "period"))
    if flag_topic(topic) in config.settings.topics:
        what = f"{flag_topic(topic)} is reserved: it shows whether messages on {topic} are substitutes"
        raise wrong(what, "Rename that topic in the configuration.")
    return StalePlan("substitute", asked.value, record, asked.period_ns)


def _check_silence(entry: TopicSettings, stale_ns: int, wrong: Any) -> None:
    """Refuse what would take a source that speaks for silent, or never notice that it is."""
    if not stale_ns:
        default = "" if entry.stale_after_ns is not None else " (the default for to: ros)"
        raise wrong(f"stale_after is never{default}, so on_stale has no effect", "Add stale_after: 1s.")
    if entry.to == "ros":
        if entry.classic is not None:
            what = "in classic mode, a silent PLC looks like a PLC that repeats the same message"
            raise wrong(what, "Remove on_stale, or carry the topic without classic.")
    elif entry.classic is None and entry.on_change:
        what = "on_change drops equal messages, so a source that repeats a message would count as silent"
        raise wrong(what, "Remove on_change.")
    if (entry.rate_limit_ns or 0) >= stale_ns:
        what = f"the interval of rate_limit must be shorter than stale_after ({format_duration(stale_ns)})"
        raise wrong(what, "Raise stale_after, or remove rate_limit.")


def checked_record(
    config: Config, value: Mapping[str, Any], layout: Layout, key: tuple[str | int, ...]
) -> bytes:
    """Return the record of a message that the configuration writes at ``key``. Raises ConfigError there."""
    try:
        record = bytes(layout.pack(value))
    except LayoutError as error:
        at = (*key, *_parts(error.where))
        inner = f"{error.where}: " if error.where and error.where != layout.type_name else ""
        remedy = f"`rosplc types {layout.type_name}` shows the fields and their limits."
        raise config.source.wrong(at, inner + error.what, remedy) from None
    for path, item in _leaves(value, ()):
        # In Structured Text there is no way to write these.
        if isinstance(item, float) and not math.isfinite(item):
            raise config.source.wrong((*key, *path), f"{item} is not a finite number")
        if isinstance(item, str) and not item.isprintable():
            raise config.source.wrong((*key, *path), f"{item!r} contains non-printable characters")
    return record


def _parts(where: str) -> list[str | int]:
    """Return a field path such as ``points[3].x`` in its parts."""
    found = re.findall(r"([A-Za-z_][A-Za-z0-9_]*)|\[([0-9]+)\]", where) if "/" not in where else []
    return [name or int(index) for name, index in found]


def _leaves(value: Any, path: tuple[str | int, ...]) -> Iterator[tuple[tuple[str | int, ...], Any]]:
    if isinstance(value, Mapping):
        for name, item in value.items():
            yield from _leaves(item, (*path, name))
    elif isinstance(value, (list, tuple)):
        for index, item in enumerate(value):
            yield from _leaves(item, (*path, index))
    else:
        yield path, value


# Slots (spec/shm-format.md, section 7.3): a reader accepts a copy only if the writer has published at most
# N-2 messages meanwhile, so N-2 periods must outlast a copy plus a preemption. And where every message
# counts, N-1 messages must outlast the time between two visits of the reader.

_PREEMPTION_NS = 1_000_000
"""A PLC task or another process in between; a board without a real-time kernel has more."""

_COPY_NS_PER_BYTE = 5  # a 1 GHz Cortex-A8 copies 1 MiB in 4.7 ms; everything else is faster

_PAUSE_NS = 20_000_000  # how long a reader may be kept from running, for the usual number

_BRIDGE_PAUSE_NS = 200_000_000  # the same for the bridge, on a loaded machine without a real-time kernel

_MOST_BYTES = 1 << 20  # records beyond this are not worth the bridge's longer pause

_BURST = 16  # slots where every message counts and their rate is unknown

_MOST = 65536


def slot_numbers(
    period_ns: int, visit_ns: int, record_size: int, every: bool, *, by_bridge: bool = False
) -> tuple[int, int]:
    """Return below how many slots messages are certain to be lost or copies refused, and the usual number.

    ``period_ns`` is the shortest time between two messages (0: unknown), ``visit_ns`` that between two visits
    of the reader, which with ``by_bridge`` is the bridge; with ``every`` each message counts.
    """

    def lasting(pause_ns: int) -> int:
        if not period_ns:
            return 4
        copy_ns = record_size * _COPY_NS_PER_BYTE + _PREEMPTION_NS
        needed = 2 - -copy_ns // period_ns
        if every:
            needed = max(needed, 1 - -(visit_ns + pause_ns) // period_ns)
        return min(_MOST, max(4, 1 << (needed - 1).bit_length()))

    least, usual = lasting(_PREEMPTION_NS), lasting(_PAUSE_NS)
    if every and not period_ns:
        usual = _BURST
    elif every and by_bridge:
        most = _MOST_BYTES // record_size
        power = 1 << (most.bit_length() - 1) if most else 0  # the largest that is not above
        usual = max(usual, min(lasting(_BRIDGE_PAUSE_NS), power))
    return least, usual


_Settings: TypeAlias = "ServiceSettings | ActionSettings"
_RESERVED = ("_action", "_service_event")
"""Last parts but one, and last parts, of names that ROS itself makes."""


@dataclass(frozen=True, kw_only=True)
class CallPlan(Call):
    """One use of a service or action with everything decided; one that the PLC carries out has one use."""

    type_name: str  # ``package/srv/Name`` or ``package/action/Name``
    server: Literal["plc", "ros"]  # who carries it out
    client: str  # the use's name; empty if it has none
    task: str  # name of the PLC task
    truncate: bool = False  # what comes from ROS and does not fit is cut, not refused

    parts: ClassVar[tuple[Part, ...]]
    only: ClassVar[dict[str, frozenset[str]]]  # settings that only one value of ``server`` has
    port: ClassVar[Literal["channel"]] = "channel"

    def layout(self, part: Part) -> Layout:
        """Return the layout of the records of one of its objects."""
        found: Layout = getattr(self, part.word)
        return found

    @property
    def layouts(self) -> tuple[Layout, ...]:
        """The layouts of its objects, in the order of ``parts``."""
        return tuple(map(self.layout, self.parts))


@dataclass(frozen=True, kw_only=True)
class ServicePlan(CallPlan):
    """One use of a service."""

    service: str  # the service as ROS writes it
    request: Layout  # the layout of its requests
    response: Layout  # the layout of its responses
    depth: int = 16  # calls that wait or are carried out at most
    per_client: int = 4  # the same for each caller
    min_interval_ns: int = 0  # shortest time between two calls that the PLC is given; 0 for no limit
    expire_after_ns: int = 5_000_000_000  # a call that has waited for longer is not given to the PLC
    # the response of a call that the PLC does not answer, as a record; None: there is none
    fallback: bytes | None = None
    qos: Qos = SERVICES  # quality of service on the ROS side

    kind = "service"
    parts = SERVICE
    only: ClassVar = {
        "plc": frozenset({"depth", "per_client", "rate_limit_ns", "expire_after_ns", "fallback"}),
        "ros": frozenset(),
    }


@dataclass(frozen=True, kw_only=True)
class ActionPlan(CallPlan):
    """One use of an action."""

    action: str  # the action as ROS writes it
    goal: Layout  # the layout of its goals
    result: Layout  # the layout of its results
    feedback: Layout  # the layout of its feedback
    # what becomes of a goal that comes while the PLC has one
    on_new_goal: Literal["reject", "abort", "buffer"] = "reject"
    queue: int = 0  # goals that wait at most; 0 unless ``on_new_goal`` is ``buffer``
    accept_within_ns: int = 5_000_000_000  # how long the PLC may take to decide on a goal
    keep_result_ns: int = 10_000_000_000  # how long a goal and its result are kept after its end
    when_plc_down: Literal["cancel", "keep"] = "cancel"  # what becomes of a goal in ROS whose PLC has gone

    kind = "action"
    parts = ACTION
    only: ClassVar = {
        "plc": frozenset({"on_new_goal", "queue", "accept_within_ns", "keep_result_ns"}),
        "ros": frozenset({"when_plc_down"}),
    }


_C = TypeVar("_C", bound=CallPlan)


def call_plans(config: Config, plan: type[_C], store: TypeStore, problems: Problems) -> Iterator[_C]:
    """Yield the plans of services or actions that can be used, in the file's order; note what is wrong."""
    tasks = config.settings.tasks
    entries: Mapping[str, _Settings] = getattr(config.settings, f"{plan.kind}s")
    for name, entry in entries.items():
        path, found = (f"{plan.kind}s", name), len(problems)
        _contradictions(config, plan, entry, path, problems)
        if len(problems) > found:
            continue
        try:
            kind = getattr(store, plan.kind)(entry.type)
        except RosplcError as error:
            problems.move(error, config.source, (*path, "type"))
            continue
        messages = {part.word: getattr(kind, part.word).name for part in plan.parts}
        layouts = _layouts(config, store, messages, entry, path, problems)
        if len(problems) > found:
            continue
        try:
            values = _values(config, plan, entry, layouts, path)
        except RosplcError as error:
            problems.add(error, config.source.line((*path, "fallback")))
            continue
        for client, use in entry.clients.items() or (("", None),):
            values |= {plan.kind: name, "type_name": kind.name, "client": client, **layouts}
            values["task"] = (use.task if use is not None else None) or entry.task or next(iter(tasks))
            yield plan(**values, truncate=entry.on_overflow == "truncate")


def _contradictions(
    config: Config, plan: type[CallPlan], entry: _Settings, path: KeyPath, problems: Problems
) -> None:
    from rosplc.config.settings import ServiceSettings

    other = "ros" if entry.server == "plc" else "plc"

    def wrong(key: KeyPath, *what: str) -> None:
        problems.wrong(config.source, (*path, *key), *what)

    if any(part in _RESERVED for part in str(path[1]).split("/")):
        what = f"names that contain {' or '.join(_RESERVED)} are reserved by ROS"
        wrong((), what, "Choose another name.")
    config.task(entry.task, (*path, "task"), problems)
    for client, use in entry.clients.items():
        config.task(use.task, (*path, "clients", client, "task"), problems)
    if entry.server == "plc" and entry.clients:
        what = "with `server: plc`, the clients are in ROS"
        wrong(("clients",), what, "Remove clients, or write `server: ros`.")
    for name in sorted(plan.only[other] & entry.model_fields_set):
        name = name.removesuffix("_ns")
        wrong((name,), f"{name} applies only to `server: {other}`", f"Remove {name}.")
    if isinstance(entry, ServiceSettings):
        if entry.per_client is not None and entry.per_client > entry.depth:
            wrong(("per_client",), f"per_client exceeds depth, which is {entry.depth}")
    elif entry.queue is not None and entry.server == "plc" and entry.on_new_goal != "buffer":
        what = f"queue has no effect with `on_new_goal: {entry.on_new_goal}`"
        wrong(("queue",), what, "Remove queue, or write `on_new_goal: buffer`.")
    seen: dict[str, str] = {}
    for client in entry.clients:
        if (before := seen.setdefault(client.lower(), client)) != client:
            what = f"{client} and {before} are the same name in the PLC, which ignores case"
            wrong(("clients", client), what, "Rename one of the clients.", "CFG007")


def _layouts(
    config: Config,
    store: TypeStore,
    messages: Mapping[str, str],
    entry: _Settings,
    path: KeyPath,
    problems: Problems,
) -> dict[str, Layout]:
    """Return the layout of each part's message, as far as they can be used; what is wrong is noted."""
    defaults, words = config.settings.limits, tuple(messages)
    own: dict[str, dict[str, int]] = {word: {} for word in words}
    for name, capacity in entry.limits.items():
        word, _, inner = name.partition(".")
        if word in own and inner:
            own[word][inner] = capacity
        elif name not in ("string", "sequence"):
            what = f"{name!r} is not a field of the {', '.join(words[:-1])} or {words[-1]}"
            remedy = f"Write {', '.join(f'{word}.FIELD' for word in words)}, string or sequence."
            problems.wrong(config.source, (*path, "limits", name), what, remedy)
    found = {}
    for word, message in messages.items():
        string, sequence = (
            entry.limits.get(name, getattr(defaults, name)) for name in ("string", "sequence")
        )
        try:
            found[word] = compute_layout(store, message, Limits(string, sequence, own[word]))
        except RosplcError as error:
            note_layout_error(error, config, path, problems, f"{word}.")
            break
    return found


def note_layout_error(
    error: RosplcError, config: Config, path: KeyPath, problems: Problems, prefix: str = ""
) -> None:
    """Note why an entry's layout cannot be computed, at its type or at the limit that is wrong."""
    key = (*path, "limits" if isinstance(error, LayoutError) else "type")
    for name in (prefix + error.where, error.where):
        if isinstance(error, LayoutError) and (*key, name) in config.source.lines:
            key, error = (*key, name), LayoutError(error.code, error.what, remedy=error.remedy)
    problems.move(error, config.source, key)


def _values(
    config: Config, plan: type[CallPlan], entry: _Settings, layouts: Mapping[str, Layout], path: KeyPath
) -> dict[str, Any]:
    """Return what a plan has of settings that do not contradict each other."""
    from rosplc.config.settings import ActionSettings

    known = type(entry).model_fields
    values = {each.name: getattr(entry, each.name) for each in fields(plan) if each.name in known}
    if isinstance(entry, ActionSettings):
        return values | {"queue": (entry.queue or 4) * (entry.on_new_goal == "buffer")}
    if entry.fallback is not None:
        record = checked_record(config, entry.fallback, layouts["response"], (*path, "fallback"))
        values["fallback"] = record
    values["min_interval_ns"] = entry.rate_limit_ns or 0
    return values | {"per_client": entry.per_client or max(1, entry.depth // 4)}
