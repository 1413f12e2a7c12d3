"""What differs between the configuration that runs and a new one, and what of it cannot change."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from rosplc.config.problems import Problems
from rosplc.config.resolve import Project, TopicPlan
from rosplc.errors import ConfigError

__all__ = ["Changes", "compare"]

_MAY_CHANGE = frozenset({"topics", "limits", "types", "tasks"})


@dataclass(frozen=True)
class Changes:
    """A new configuration's topics, beside those that are carried.

    Attributes:
        added: New topics.
        removed: Topics that are no more.
        changed: Topics that are carried otherwise, old and new.
        kept: Topics of which nothing changes.
    """

    added: tuple[TopicPlan, ...] = ()
    removed: tuple[TopicPlan, ...] = ()
    changed: tuple[tuple[TopicPlan, TopicPlan], ...] = ()
    kept: tuple[TopicPlan, ...] = ()

    def __bool__(self) -> bool:
        return bool(self.added or self.removed or self.changed)

    def __str__(self) -> str:
        named = (
            ("added", self.added),
            ("removed", self.removed),
            ("changed", tuple(new for _, new in self.changed)),
        )
        parts = [f"{word} {', '.join(plan.topic for plan in plans)}" for word, plans in named if plans]
        return "; ".join([*parts, f"{len(self.kept)} topics stay as they are"])


def compare(old: Project, new: Project, used: Mapping[str, str]) -> Changes:
    """Return what changes.

    Args:
        old: What runs.
        new: What should.
        used: Definitions by type name that the ROS side has been given.

    Raises:
        ConfigErrors: CFG012, for each key that cannot change while the bridge runs, and for each type
            with another definition.
    """
    problems = Problems()
    _refuse_fixed(old, new, problems)
    _refuse_redefined(new, used, problems)
    problems.check()
    before = {plan.topic: plan for plan in old.topics}
    after = {plan.topic: plan for plan in new.topics}
    both = [(before[topic], plan) for topic, plan in after.items() if topic in before]
    return Changes(
        added=tuple(plan for topic, plan in after.items() if topic not in before),
        removed=tuple(plan for topic, plan in before.items() if topic not in after),
        changed=tuple((was, now) for was, now in both if was != now),
        kept=tuple(was for was, now in both if was == now),
    )


def _refuse_fixed(old: Project, new: Project, problems: Problems) -> None:
    was, now = (p.config.settings.model_dump(mode="json", by_alias=True) for p in (old, new))
    source = new.config.source
    for key in sorted(set(was) - _MAY_CHANGE):
        for path in _differing((key,), was[key], now[key]):
            what = f"it was {_written(old, path)} and would be {_written(new, path)}"
            problems.add(ConfigError("CFG012", what, where=source.place(path)), source.line(path))


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
    for plan in new.topics:
        known = used.get(plan.type_name)
        if known is not None and known != new.store.definition_text(plan.type_name):
            key = ("topics", plan.topic, "type")
            source = new.config.source
            what = f"the definition of {plan.type_name} is another than the one in use"
            problems.add(ConfigError("CFG012", what, where=source.place(key)), source.line(key))
