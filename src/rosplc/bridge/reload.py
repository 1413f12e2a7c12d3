"""Applying another configuration to a running bridge: what changes, and the exchange of streams."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

from rosplc.bridge.carrier import Carried, Carriers
from rosplc.bridge.port import log
from rosplc.bridge.use import Use
from rosplc.clock import Clock
from rosplc.config.plans import CallPlan
from rosplc.config.resolve import Plan, Project, object_name
from rosplc.config.yaml_source import Problems
from rosplc.errors import BackendError, RosplcError
from rosplc.shm import Namespace


@dataclass(frozen=True)
class Changes:
    """The plans of a new configuration, compared with the carried ones; ``changed`` has pairs (old, new)."""

    added: tuple[Plan, ...] = ()
    removed: tuple[Plan, ...] = ()
    changed: tuple[tuple[Plan, Plan], ...] = ()
    kept: tuple[Plan, ...] = ()

    def __bool__(self) -> bool:
        return bool(self.added or self.removed or self.changed)

    def __str__(self) -> str:
        changed = tuple(new for _, new in self.changed)
        named = (("added", self.added), ("removed", self.removed), ("changed", changed))
        parts = [f"{word} {', '.join(plan.name for plan in plans)}" for word, plans in named if plans]
        kinds = {plan.kind for plan in self.kept if isinstance(plan, CallPlan)}
        what = " and ".join(("topics", *(f"{kind}s" for kind in ("service", "action") if kind in kinds)))
        return "; ".join([*parts, f"{what} unchanged: {len(self.kept)}"])


def compare(old: Project, new: Project, used: Mapping[str, str]) -> Changes:
    """Return what changes; ``used`` has the definitions that the ROS side already uses, by type name.

    Raises ConfigErrors (CFG012) for keys that cannot change in a running bridge and for redefined types.
    """
    problems = Problems()
    _refuse_fixed(old, new, problems)
    _refuse_redefined(new, used, problems)
    problems.check()
    before = {plan.name: plan for plan in old.plans}
    after = {plan.name: plan for plan in new.plans}
    both = [(before[name], plan) for name, plan in after.items() if name in before]
    return Changes(
        added=tuple(plan for name, plan in after.items() if name not in before),
        removed=tuple(plan for name, plan in before.items() if name not in after),
        changed=tuple((was, now) for was, now in both if was != now),
        kept=tuple(was for was, now in both if was == now),
    )


def _refuse_fixed(old: Project, new: Project, problems: Problems) -> None:
    source = new.config.source
    for path in _differing((), old.config.fixed, new.config.fixed):
        what = f"the value cannot change from {_written(old, path)} to {_written(new, path)}"
        problems.add(source.wrong(path, what, code="CFG012"), source.line(path))
    if old.parameters != new.parameters and not problems:
        what = "the layout of the parameters in the PLC cannot change at run time"
        problems.wrong(source, ("parameters",), what, "", "CFG012")


def _differing(path: tuple[str, ...], was: Any, now: Any) -> list[tuple[str, ...]]:
    if was == now:
        return []
    if isinstance(was, dict) and isinstance(now, dict) and was.keys() == now.keys():
        return [found for key in was for found in _differing((*path, key), was[key], now[key])]
    return [path]


def _written(project: Project, path: tuple[str, ...]) -> str:
    data: Any = project.config.source.data
    for key in path:
        if not isinstance(data, dict) or key not in data:
            return "the default"
        data = data[key]
    return "a group of keys" if isinstance(data, (dict, list)) else repr(data)


def _refuse_redefined(new: Project, used: Mapping[str, str], problems: Problems) -> None:
    # A middleware keeps a type's first definition for as long as the node lives.
    for plan in new.plans:
        for name in (layout.type_name for layout in plan.layouts):
            if used.get(name) in (None, new.store.definition_text(name)):
                continue
            key = ("topics", plan.name, "type")
            if isinstance(plan, CallPlan):
                key = (f"{plan.kind}s", plan.called, "type")
            source = new.config.source
            what = f"the definition of {name} differs from the one in use"
            problems.add(source.wrong(key, what, code="CFG012"), source.line(key))


@dataclass
class Exchange:
    """Exchanges streams without touching kept ones; after a failure, ``running`` has the restored streams.

    Everything takes effect, or nothing does: new streams are opened beside the running ones, which are
    closed only after that. If a later step fails, the former streams are opened again.
    """

    changes: Changes
    running: tuple[Carried, ...]
    carriers: Carriers
    connect: Callable[[Carried], None]
    namespace: Namespace
    clock: Clock
    _new: list[Carried] = field(default_factory=list)

    def __post_init__(self) -> None:
        changes = self.changes
        # A channel that becomes something else leaves its object, like a topic that is no more.
        became = {was.name for was, now in changes.changed if was.port == "channel" != now.port}
        self._retiring = {plan.name for plan in changes.removed} | became
        left = self._retiring | {was.name for was, _ in changes.changed}
        # Objects with other contents take the place of theirs.
        others = {was.name for was, now in changes.changed if _contents(was) != _contents(now)}
        self._ending = self._retiring | others
        self._leaving = tuple(stream for stream in self.running if stream.plan.name in left)
        self._kept = tuple(stream for stream in self.running if stream.plan.name not in left)

    def run(self) -> tuple[Carried, ...]:
        """Return the streams carried now; after a RosplcError (SHM116, SHM117 …), the former ones are."""
        taken = {self._name(stream.plan) for stream in self._leaving}
        first = [plan for plan in self.changes.added if self._name(plan) not in taken]
        rest = [plan for plan in self.changes.added if self._name(plan) in taken]
        rest += [now for _, now in self.changes.changed]
        needed = {self._name(plan) for plan in rest}
        try:
            self._open(first)
            self._replace(self._leaving, self._new)
        except BaseException:
            self._drop_new()
            raise
        self._give_up(stream for stream in self._leaving if stream.plan.name in self._ending)
        begun = tuple(self._new)
        try:
            for stream in self._leaving:
                stream.disconnect()
                # A name that is given up stays held until all has succeeded, unless another needs it.
                if self._name(stream.plan) in needed or stream.plan.name not in self._retiring:
                    stream.port.close()
            self._open(rest)
            self._replace((), self._new[len(begun) :])
        except BaseException:
            self._restore(begun)
            raise
        for stream in self._leaving:
            if stream.plan.name in self._retiring:
                _retire(stream)
        return (*self._kept, *self._new)

    def _open(self, plans: Iterable[Plan]) -> None:
        for plan in plans:
            stream = self.carriers.make(plan)
            stream.port.open()
            self._new.append(stream)
            self.connect(stream)

    def _replace(self, leaving: Collection[Carried], coming: Collection[Carried]) -> None:
        if not self.carriers.replace(leaving, coming):
            raise BackendError("ROS018", "publishing to ROS is blocked")

    def _give_up(self, streams: Iterable[Carried]) -> None:
        """End the calls in objects that no bridge will use again."""
        for stream in streams:
            if isinstance(stream, Use):
                stream.give_up(self.clock.monotonic_ns())

    def _drop_new(self) -> None:
        """Close what was opened; retire an object that was created for it."""
        adopted = {stream for stream in self._new if stream.port.adopted}
        self._give_up(stream for stream in self._new if stream not in adopted)
        for stream in self._new:
            stream.disconnect()
            if stream in adopted:
                stream.port.close()
            else:
                _retire(stream)

    def _restore(self, begun: tuple[Carried, ...]) -> None:
        """Carry the former streams again after a failure."""
        self.carriers.replace(begun, ())
        self._drop_new()
        again = []
        for stream in self._leaving:
            stream.port.close()
            renewed = self.carriers.make(stream.plan)
            try:
                renewed.port.open()
            except (RosplcError, OSError) as error:  # as after a removed object: the next check opens it
                renewed.fail(self.clock.monotonic_ns(), error)
            try:
                self.connect(renewed)
            except RosplcError as error:
                log.error("%s: %s; restart the bridge", stream.plan.name, error)
            again.append(renewed)
        self.carriers.replace((), again)
        order = [stream.plan.name for stream in self.running]
        self.running = tuple(sorted((*self._kept, *again), key=lambda stream: order.index(stream.plan.name)))

    def _name(self, plan: Plan) -> str:
        return object_name(self.namespace, plan)


def _contents(plan: Plan) -> tuple[Any, ...]:
    server = plan.server if isinstance(plan, CallPlan) else ""
    return (server, *(layout.layout_id for layout in plan.layouts))


def _retire(stream: Carried) -> None:
    try:
        stream.port.retire()
    except (RosplcError, OSError, ValueError) as error:
        log.warning("%s: the object could not be retired: %s", stream.plan.name, error)
