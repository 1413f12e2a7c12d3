"""What a look may expect of a topic; a configuration knows, and the object does not say it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from rosplc.config.resolve import Project, load_project
from rosplc.layout import Layout
from rosplc.shm import Direction

_STALE_TO_PLC_NS = 1_000_000_000


@dataclass(frozen=True)
class Expectation:
    """What is expected of one topic.

    Attributes:
        stale_after_ns: How old its newest message may become; 0 for never.
        in_order: Whether each message counts, so that a loss is a fault. False where it is not known.
        configured: Whether a configuration says so.
    """

    stale_after_ns: int
    in_order: bool = False
    configured: bool = True


@dataclass(frozen=True)
class ClassicTopic:
    """A classic topic, whose memory cannot describe itself.

    Attributes:
        topic: As ROS writes it.
        direction: Where its messages go.
        memory: The memory's name.
        semaphore: The semaphore's name; empty if there is none.
        layout: The record's layout.
        stale_after_ns: How long its record may stay the same; 0 for never.
    """

    topic: str
    direction: Direction
    memory: str
    semaphore: str
    layout: Layout
    stale_after_ns: int = 0


@dataclass(frozen=True)
class Expected:
    """What configurations say.

    Attributes:
        topics: Per prefix and topic.
        classic: Classic topics, with the prefix of their bridge.
        stale_after_ns: For topics towards the PLC that no configuration names; 0 for never.
        prefixes: Of the configurations' bridges.
    """

    topics: Mapping[tuple[str, str], Expectation] = field(default_factory=dict)
    classic: tuple[tuple[str, ClassicTopic], ...] = ()
    stale_after_ns: int = _STALE_TO_PLC_NS
    prefixes: frozenset[str] = frozenset()

    def of(self, prefix: str, topic: str, direction: Direction) -> Expectation:
        """Return what is expected of a topic."""
        known = self.topics.get((prefix, topic))
        return known or default_expectation(direction, self.stale_after_ns)


def default_expectation(direction: Direction, stale_after_ns: int = _STALE_TO_PLC_NS) -> Expectation:
    """Return what a configuration says that says nothing: 1 s towards the PLC, never towards ROS."""
    return Expectation(stale_after_ns if direction is Direction.TO_PLC else 0, configured=False)


def expected_by(files: Iterable[Path]) -> Expected:
    """Read configurations and return what they say together; of none, what holds without any.

    Raises:
        ConfigErrors: A file is wrong.
    """
    topics: dict[tuple[str, str], Expectation] = {}
    classic: list[tuple[str, ClassicTopic]] = []
    prefixes: set[str] = set()
    for file in files:
        found = expected_of(load_project(file))
        topics.update(found.topics)
        classic += found.classic
        prefixes |= found.prefixes
    return Expected(topics, tuple(classic), prefixes=frozenset(prefixes))


def expected_of(project: Project) -> Expected:
    """Return what a resolved configuration says."""
    prefix = project.namespace.prefix
    topics: dict[tuple[str, str], Expectation] = {}
    classic: list[tuple[str, ClassicTopic]] = []
    for plan in project.topics:
        if plan.port == "channel":
            topics[prefix, plan.topic] = Expectation(plan.stale_after_ns, in_order=plan.every)
        elif (names := plan.classic) is not None:
            topic = ClassicTopic(
                plan.topic, plan.direction, names.name, names.semaphore, plan.layout, plan.stale_after_ns
            )
            classic.append((prefix, topic))
    return Expected(topics, tuple(classic), prefixes=frozenset({prefix}))
