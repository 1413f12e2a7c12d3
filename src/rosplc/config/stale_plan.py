"""What the configuration decides about a source that falls silent: ``on_stale``."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from rosplc.config.file import Config
from rosplc.config.quantities import format_duration, parse_duration
from rosplc.config.settings import OnStaleSettings, TopicSettings
from rosplc.errors import ConfigError, LayoutError
from rosplc.layout import Layout

__all__ = ["StalePlan", "flag_topic", "stale_plan"]

_SHORTEST_NS = parse_duration("1ms")


@dataclass(frozen=True)
class StalePlan:
    """What is there while a topic's source is silent.

    Attributes:
        action: Towards the PLC ``hold`` the last message, ``zero``, or ``value``; towards ROS ``stop`` or
            ``substitute``.
        value: The fields of the message that takes the source's place; what it lacks is initial.
        record: The same as a record; empty unless there is such a message.
        period_ns: Towards ROS: time between two substitutes.
    """

    action: Literal["hold", "zero", "value", "stop", "substitute"] = "hold"
    value: Mapping[str, Any] = field(default_factory=dict)
    record: bytes = b""
    period_ns: int = 0


def flag_topic(topic: str) -> str:
    """Return the topic on which ROS sees whether substitutes are being published: std_msgs/msg/Bool."""
    return f"{topic}/substituted"


def stale_plan(config: Config, topic: str, entry: TopicSettings, layout: Layout, stale_ns: int) -> StalePlan:
    """Return what a topic's entry says about its silent source.

    Args:
        config: The configuration.
        topic: The topic's name.
        entry: Its entry.
        layout: Its message's layout.
        stale_ns: The time after which the source counts as silent; 0 for never.

    Raises:
        ConfigError: CFG004, at the line of what is wrong.
    """
    asked = entry.on_stale
    if asked is None:
        return StalePlan("hold" if entry.to == "plc" else "stop")
    key: tuple[str | int, ...] = ("topics", topic, "on_stale")

    def wrong(what: str, remedy: str = "", at: tuple[str | int, ...] = key) -> ConfigError:
        return ConfigError("CFG004", what, where=config.source.place(at), remedy=remedy)

    if isinstance(asked, str):
        if (asked == "stop") != (entry.to == "ros"):
            right = "hold, zero or {value: …}" if entry.to == "plc" else "stop or {value: …, period: …}"
            raise wrong(f"{asked!r} is not for to: {entry.to}", f"Write {right}.")
        if asked == "zero":
            _check_silence(entry, stale_ns, wrong)
        return StalePlan(asked)
    _check_silence(entry, stale_ns, wrong)
    record = _record(config, asked, layout, (*key, "value"))
    if entry.to == "plc":
        if asked.period_ns is not None:
            what = "a PLC's block has its value at every scan; there is no period"
            raise wrong(what, "Remove it.", (*key, "period"))
        return StalePlan("value", asked.value, record)
    if asked.period_ns is None:
        raise wrong("'period' is missing", "Add how often the message is published, such as period: 100ms.")
    if asked.period_ns < _SHORTEST_NS:
        raise wrong(f"{format_duration(asked.period_ns)} is shorter than 1ms", at=(*key, "period"))
    if flag_topic(topic) in config.settings.topics:
        what = f"{flag_topic(topic)} tells ROS that {topic} is substituted, and is a topic of this file"
        raise wrong(what, "Rename that topic.")
    return StalePlan("substitute", asked.value, record, asked.period_ns)


def _check_silence(entry: TopicSettings, stale_ns: int, wrong: Any) -> None:
    """Refuse what would take a source that speaks for silent, or never notice that it is."""
    if not stale_ns:
        default = "" if entry.stale_after_ns is not None else " (the default of to: ros)"
        raise wrong(f"stale_after is never{default}: no silence would count", "Add stale_after: 1s.")
    if entry.to == "ros":
        if entry.classic is not None:
            what = "a classic memory does not tell a silent PLC from one that writes the same message again"
            raise wrong(what, "Remove it, or carry the topic without classic.")
    elif entry.classic is None and entry.on_change:
        what = "on_change holds equal messages back, so that a steady source would count as silent"
        raise wrong(what, "Remove on_change.")
    if (entry.rate_limit_ns or 0) >= stale_ns:
        what = (
            f"rate_limit leaves more time between two messages than stale_after: {format_duration(stale_ns)}"
        )
        raise wrong(what, "Raise stale_after, or remove rate_limit.")


def _record(config: Config, asked: OnStaleSettings, layout: Layout, key: tuple[str | int, ...]) -> bytes:
    try:
        record = bytes(layout.pack(asked.value))
    except LayoutError as error:
        at = (*key, *_parts(error.where))
        inner = f"{error.where}: " if error.where and error.where != layout.type_name else ""
        raise ConfigError(
            "CFG004",
            inner + error.what,
            where=config.source.place(at),
            remedy=f"`rosplc types {layout.type_name}` shows the fields and their limits.",
        ) from None
    for path, value in _leaves(asked.value, ()):
        # In Structured Text there is no way to write these.
        if isinstance(value, float) and not math.isfinite(value):
            raise ConfigError("CFG004", f"{value} is no number", where=config.source.place((*key, *path)))
        if isinstance(value, str) and not value.isprintable():
            what = f"{value!r} has characters that cannot be printed"
            raise ConfigError("CFG004", what, where=config.source.place((*key, *path)))
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
