"""What the configuration decides about services and actions: one plan for each use of one."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, TypeVar

from rosplc.config.file import Config
from rosplc.config.plans import checked_record
from rosplc.config.problems import Problems, relocated
from rosplc.config.settings import ActionSettings, ServiceSettings
from rosplc.config.yaml_source import KeyPath
from rosplc.errors import ConfigError, LayoutError, RosplcError
from rosplc.layout import Layout, Limits, compute_layout
from rosplc.model import TypeStore
from rosplc.ros import SERVICES, Qos
from rosplc.shm import ACTION, SERVICE, Part

__all__ = ["ActionPlan", "CallPlan", "ServicePlan", "action_plans", "service_plans"]

_Settings = ServiceSettings | ActionSettings
_RESERVED = ("_action", "_service_event")
"""Last parts but one, and last parts, of names that ROS itself makes."""


@dataclass(frozen=True, kw_only=True)
class CallPlan:
    """One use of a service or action with everything decided; one that the PLC carries out has one use."""

    type_name: str  # ``package/srv/Name`` or ``package/action/Name``
    server: Literal["plc", "ros"]  # who carries it out
    client: str  # the use's name; empty if it has none
    task: str  # name of the PLC task
    truncate: bool = False  # what comes from ROS and does not fit is cut, not refused

    kind: ClassVar[Literal["service", "action"]]
    parts: ClassVar[tuple[Part, ...]]
    only: ClassVar[dict[str, frozenset[str]]]  # settings that only one value of ``server`` has
    port: ClassVar[Literal["channel"]] = "channel"

    @property
    def called(self) -> str:
        """The service or action as ROS writes it."""
        return str(getattr(self, self.kind))

    @property
    def name(self) -> str:
        """What people call it; nothing else in the configuration has this name."""
        return f"{self.kind} {self.called} {self.client}".rstrip()

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
    expire_ns: int = 5_000_000_000  # a call that has waited for longer is not given to the PLC
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
    accept_ns: int = 5_000_000_000  # how long the PLC may take to decide on a goal
    keep_result_ns: int = 10_000_000_000  # how long a goal and its result are kept after its end
    when_plc_down: Literal["cancel", "keep"] = "cancel"  # what becomes of a goal in ROS whose PLC has gone

    kind = "action"
    parts = ACTION
    only: ClassVar = {
        "plc": frozenset({"on_new_goal", "queue", "accept_within_ns", "keep_result_ns"}),
        "ros": frozenset({"when_plc_down"}),
    }


_C = TypeVar("_C", bound=CallPlan)


def service_plans(config: Config, store: TypeStore, problems: Problems) -> tuple[ServicePlan, ...]:
    """Return the plans of all services that can be used, in the order of the file; note what is wrong."""
    return tuple(_plans(config, ServicePlan, store, problems))


def action_plans(config: Config, store: TypeStore, problems: Problems) -> tuple[ActionPlan, ...]:
    """Return the plans of all actions, as :func:`service_plans` does."""
    return tuple(_plans(config, ActionPlan, store, problems))


def _plans(config: Config, plan: type[_C], store: TypeStore, problems: Problems) -> Iterator[_C]:
    tasks = config.settings.tasks
    entries: Mapping[str, _Settings] = getattr(config.settings, f"{plan.kind}s")
    for name, entry in entries.items():
        path, found = (f"{plan.kind}s", name), len(problems)
        for key, error in _contradictions(config, plan, entry, path):
            problems.add(error, config.source.line(key))
        if len(problems) > found:
            continue
        try:
            kind = getattr(store, plan.kind)(entry.type)
        except RosplcError as error:
            key = (*path, "type")
            problems.add(relocated(error, config.source.place(key)), config.source.line(key))
            continue
        messages = {part.word: getattr(kind, part.word).name for part in plan.parts}
        layouts = _layouts(config, store, messages, entry, path, problems)
        if len(problems) > found:
            continue
        try:
            values = _values(config, entry, layouts, path)
        except RosplcError as error:
            problems.add(error, config.source.line((*path, "fallback")))
            continue
        for client, use in entry.clients.items() or (("", None),):
            yield plan(
                **{plan.kind: name},
                type_name=kind.name,
                server=entry.server,
                client=client,
                task=(use.task if use is not None else None) or entry.task or next(iter(tasks)),
                truncate=entry.on_overflow == "truncate",
                **layouts,
                **values,
            )


def _contradictions(
    config: Config, plan: type[CallPlan], entry: _Settings, path: KeyPath
) -> Iterator[tuple[KeyPath, ConfigError]]:
    tasks, other = config.settings.tasks, "ros" if entry.server == "plc" else "plc"

    def wrong(key: KeyPath, what: str, remedy: str = "", code: str = "CFG004") -> tuple[KeyPath, ConfigError]:
        return (*path, *key), config.source.wrong((*path, *key), what, remedy, code)

    if any(part in _RESERVED for part in str(path[1]).split("/")):
        what = f"names with {' or '.join(_RESERVED)} are ROS' own"
        yield wrong((), what, "Choose another name.")
    uses: dict[KeyPath, str | None] = {("task",): entry.task}
    uses |= {("clients", client, "task"): use.task for client, use in entry.clients.items()}
    for key, task in uses.items():
        if task is not None and task not in tasks:
            yield wrong(key, f"there is no task {task!r}; tasks has: {', '.join(tasks)}")
    if entry.server == "plc" and entry.clients:
        what = "what the PLC carries out has its clients in ROS"
        yield wrong(("clients",), what, "Remove it, or write `server: ros`.")
    for name in sorted(plan.only[other] & entry.model_fields_set):
        name = name.removesuffix("_ns")
        yield wrong((name,), f"{name} is for `server: {other}`", "Remove it.")
    if isinstance(entry, ServiceSettings):
        if entry.per_client is not None and entry.per_client > entry.depth:
            yield wrong(("per_client",), f"{entry.per_client} is more than depth, {entry.depth}")
    elif entry.queue is not None and entry.server == "plc" and entry.on_new_goal != "buffer":
        what = f"no goal waits with `on_new_goal: {entry.on_new_goal}`"
        yield wrong(("queue",), what, "Remove it, or write `on_new_goal: buffer`.")
    seen: dict[str, str] = {}
    for client in entry.clients:
        if (before := seen.setdefault(client.lower(), client)) != client:
            what = f"{client} and {before} are one name in the PLC, where capitals do not count"
            yield wrong(("clients", client), what, code="CFG007")


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
    for field, capacity in entry.limits.items():
        word, _, inner = field.partition(".")
        if word in own and inner:
            own[word][inner] = capacity
        elif field not in ("string", "sequence"):
            key = (*path, "limits", field)
            what = f"{field!r} is no field of a {' or '.join(words)}"
            remedy = f"Write {' or '.join(f'{word}.FIELD' for word in words)}, or string or sequence."
            problems.add(config.source.wrong(key, what, remedy), config.source.line(key))
    found = {}
    for word, message in messages.items():
        try:
            limits = Limits(
                entry.limits.get("string", defaults.string),
                entry.limits.get("sequence", defaults.sequence),
                own[word],
            )
            found[word] = compute_layout(store, message, limits)
        except RosplcError as error:
            key = (*path, "limits" if isinstance(error, LayoutError) else "type")
            for field in (f"{word}.{error.where}", error.where):
                if (*key, field) in config.source.lines:
                    key = (*key, field)
                    error = LayoutError(error.code, error.what, remedy=error.remedy)
            problems.add(relocated(error, config.source.place(key)), config.source.line(key))
            break
    return found


def _values(config: Config, entry: _Settings, layouts: Mapping[str, Layout], path: KeyPath) -> dict[str, Any]:
    """Return what a plan has besides, from settings that do not contradict each other."""
    if isinstance(entry, ActionSettings):
        return {
            "on_new_goal": entry.on_new_goal,
            "queue": (entry.queue or 4) * (entry.on_new_goal == "buffer"),
            "accept_ns": entry.accept_within_ns,
            "keep_result_ns": entry.keep_result_ns,
            "when_plc_down": entry.when_plc_down,
        }
    fallback = None
    if entry.fallback is not None:
        fallback = checked_record(config, entry.fallback, layouts["response"], (*path, "fallback"))
    return {
        "depth": entry.depth,
        "per_client": entry.per_client or max(1, entry.depth // 4),
        "min_interval_ns": entry.rate_limit_ns or 0,
        "expire_ns": entry.expire_after_ns,
        "fallback": fallback,
    }
