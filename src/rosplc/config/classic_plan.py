"""What the configuration decides about a classic topic: spec/classic-mode.md."""

from __future__ import annotations

from dataclasses import dataclass

from rosplc.config.file import Config
from rosplc.config.settings import TopicSettings
from rosplc.errors import ConfigError
from rosplc.shm.names import MAX_NAME

__all__ = ["ClassicPlan", "classic_name", "classic_plan", "passes_changes_only"]


@dataclass(frozen=True)
class ClassicPlan:
    """A topic whose record stands alone at offset 0 of a shared memory, guarded by a semaphore.

    Attributes:
        name: The memory's name, without a slash: ``/dev/shm/NAME``.
        semaphore: The semaphore's name, ``/dev/shm/sem.NAME``; empty if nothing guards the memory.
        wait_ns: How long a side tries to get the lock before it leaves it for the next time.
        recover_after_ns: How long the lock must be held, without any sign of life, before its
            holder counts as dead.
        poll_ns: Towards ROS: time between two looks at the memory.
    """

    name: str
    semaphore: str
    wait_ns: int
    recover_after_ns: int
    poll_ns: int = 1_000_000


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
    """Return what a topic's entry says about classic mode; None if it is carried over a channel.

    Raises:
        ConfigError: CFG004 for a name that cannot be had, or another directory than /dev/shm.
    """
    asked, settings = entry.classic, config.settings
    if asked is None:
        return None
    name = asked.name or classic_name(topic)
    where = config.source.place(("topics", topic, "classic"))
    if len(name) > MAX_NAME:
        what = f"the name {name!r} has {len(name)} characters; a PLC's STRING holds {MAX_NAME}"
        raise ConfigError("CFG004", what, where=where, remedy="Give a shorter one with classic: {name: …}.")
    if name.startswith(settings.prefix + "."):
        what = f"the name {name!r} begins with {settings.prefix}., as this bridge's own objects do"
        raise ConfigError("CFG004", what, where=where, remedy="Give another with classic: {name: …}.")
    if settings.shm.directory != "/dev/shm":
        what = (
            f"classic topics lie in /dev/shm, where semaphores are; shm.directory is {settings.shm.directory}"
        )
        raise ConfigError("CFG004", what, where=where)
    poll = settings.tick_ns
    if not passes_changes_only(entry) and entry.to == "ros":
        # Every look is a message here; a PLC has something new to say once per cycle at most.
        poll = entry.rate_limit_ns or entry.expected_rate_ns or settings.tasks[task].interval_ns
    return ClassicPlan(
        name=name,
        semaphore="" if asked.semaphore == "none" else asked.semaphore or name,
        wait_ns=asked.wait_ns,
        recover_after_ns=asked.recover_after_ns,
        poll_ns=poll,
    )
