"""What the configuration decides about a service: one plan for each use of it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar, Literal

from rosplc.config.file import Config
from rosplc.config.plans import checked_record
from rosplc.config.problems import Problems, relocated
from rosplc.config.settings import ServiceSettings
from rosplc.errors import LayoutError, RosplcError
from rosplc.layout import Layout, Limits, compute_layout
from rosplc.model import TypeStore
from rosplc.ros import SERVICES, Qos

__all__ = ["ServicePlan", "service_plans"]

_OF_SERVER = {"depth", "per_client", "rate_limit_ns", "expire_after_ns", "fallback"}
_PARTS = ("request", "response")
_RESERVED = ("_action", "_service_event")
"""Last parts but one, and last parts, of names that ROS itself makes."""


@dataclass(frozen=True)
class ServicePlan:
    """One use of a service with everything decided; a service that the PLC carries out has one.

    Attributes:
        service: The service as ROS writes it.
        type_name: ``package/srv/Name``.
        server: Who carries the calls out.
        client: The use's name; empty if it has none.
        request: The layout of its requests.
        response: The layout of its responses.
        task: Name of the PLC task.
        depth: Calls that wait or are carried out at most.
        per_client: The same for each caller.
        min_interval_ns: Shortest time between two calls that the PLC is given; 0 for no limit.
        expire_ns: A call that has waited for longer is not given to the PLC.
        fallback: The response of a call that the PLC does not answer, as a record; None: there is none.
        truncate: What comes from ROS and does not fit is cut, not refused.
        qos: Quality of service on the ROS side.
    """

    service: str
    type_name: str
    server: Literal["plc", "ros"]
    client: str
    request: Layout
    response: Layout
    task: str
    depth: int = 16
    per_client: int = 4
    min_interval_ns: int = 0
    expire_ns: int = 5_000_000_000
    fallback: bytes | None = None
    truncate: bool = False
    qos: Qos = SERVICES

    port: ClassVar[Literal["channel"]] = "channel"

    @property
    def name(self) -> str:
        """What people call it; no other topic or service of the configuration has it."""
        return f"service {self.service} {self.client}".rstrip()

    @property
    def layouts(self) -> tuple[Layout, ...]:
        """The layouts of its messages."""
        return (self.request, self.response)


def service_plans(config: Config, store: TypeStore, problems: Problems) -> tuple[ServicePlan, ...]:
    """Return the plans of all services that can be used, in the order of the file; note what is wrong."""
    plans: list[ServicePlan] = []
    for service, entry in config.settings.services.items():
        found = len(problems)
        _contradictions(config, service, entry, problems)
        if len(problems) == found and (layouts := _layouts(config, store, service, entry, problems)):
            plans.extend(_uses(config, service, entry, layouts, problems))
    return tuple(plans)


def _contradictions(config: Config, service: str, entry: ServiceSettings, problems: Problems) -> None:
    tasks = config.settings.tasks

    def refuse(key: tuple[str, ...], what: str, remedy: str = "", code: str = "CFG004") -> None:
        path = ("services", service, *key)
        problems.add(config.source.wrong(path, what, remedy, code), config.source.line(path))

    if any(part in _RESERVED for part in service.split("/")):
        refuse((), f"names with {' or '.join(_RESERVED)} are ROS' own", "Choose another name.")
    uses: dict[tuple[str, ...], str | None] = {("task",): entry.task}
    uses |= {("clients", client, "task"): use.task for client, use in entry.clients.items()}
    for path, task in uses.items():
        if task is not None and task not in tasks:
            refuse(path, f"there is no task {task!r}; tasks has: {', '.join(tasks)}")
    if entry.server == "plc" and entry.clients:
        what = "the callers of a service of the PLC are in ROS"
        refuse(("clients",), what, "Remove it, or write `server: ros`.")
    if entry.server == "ros":
        for name in sorted(_OF_SERVER & entry.model_fields_set):
            key = name.removesuffix("_ns")
            refuse((key,), f"{key} is for `server: plc`; a server in ROS has its own queue", "Remove it.")
    if entry.per_client is not None and entry.per_client > entry.depth:
        refuse(("per_client",), f"{entry.per_client} is more than depth, {entry.depth}")
    seen: dict[str, str] = {}
    for client in entry.clients:
        if (before := seen.setdefault(client.lower(), client)) != client:
            what = f"{client} and {before} are one name in the PLC, where capitals do not count"
            refuse(("clients", client), what, code="CFG007")


def _layouts(
    config: Config, store: TypeStore, service: str, entry: ServiceSettings, problems: Problems
) -> tuple[Layout, Layout] | None:
    defaults, found = config.settings.limits, len(problems)
    key: tuple[str, ...] = ("services", service, "type")
    try:
        kind = store.service(entry.type)
    except RosplcError as error:
        problems.add(relocated(error, config.source.place(key)), config.source.line(key))
        return None
    own: dict[str, dict[str, int]] = {part: {} for part in _PARTS}
    for path, capacity in entry.limits.items():
        part, _, inner = path.partition(".")
        if part in own and inner:
            own[part][inner] = capacity
        elif path not in ("string", "sequence"):
            key = ("services", service, "limits", path)
            what = f"{path!r} is no field of a request or response"
            remedy = "Write request.FIELD or response.FIELD, or string or sequence."
            problems.add(config.source.wrong(key, what, remedy), config.source.line(key))
    layouts = []
    for part, message in zip(_PARTS, (kind.request, kind.response), strict=True):
        try:
            limits = Limits(
                entry.limits.get("string", defaults.string),
                entry.limits.get("sequence", defaults.sequence),
                own[part],
            )
            layouts.append(compute_layout(store, message.name, limits))
        except RosplcError as error:
            key = ("services", service, "limits" if isinstance(error, LayoutError) else "type")
            for path in (f"{part}.{error.where}", error.where):
                if (*key, path) in config.source.lines:
                    key = (*key, path)
                    error = LayoutError(error.code, error.what, remedy=error.remedy)
            problems.add(relocated(error, config.source.place(key)), config.source.line(key))
            return None
    return (layouts[0], layouts[1]) if len(problems) == found else None


def _uses(
    config: Config, service: str, entry: ServiceSettings, layouts: tuple[Layout, Layout], problems: Problems
) -> Iterator[ServicePlan]:
    request, response = layouts
    fallback = None
    if entry.fallback is not None:
        key = ("services", service, "fallback")
        try:
            fallback = checked_record(config, entry.fallback, response, key)
        except RosplcError as error:
            problems.add(error, config.source.line(key))
            return
    task = entry.task or next(iter(config.settings.tasks))
    for client, use in entry.clients.items() or (("", None),):
        yield ServicePlan(
            service=service,
            type_name=request.type_name.removesuffix("_Request"),
            server=entry.server,
            client=client,
            request=request,
            response=response,
            task=(use.task if use is not None else None) or task,
            depth=entry.depth,
            per_client=entry.per_client or max(1, entry.depth // 4),
            min_interval_ns=entry.rate_limit_ns or 0,
            expire_ns=entry.expire_after_ns,
            fallback=fallback,
            truncate=entry.on_overflow == "truncate",
        )
