"""What a look may expect of a topic; a configuration knows it, and the object does not."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from rosplc.config.resolve import Project, load_project
from rosplc.layout import Layout
from rosplc.shm import Direction, Part


@dataclass(frozen=True)
class Expectation:
    """What is expected of one topic.

    Its newest message may be ``stale_after_ns`` old, 0 for any age; ``in_order``: each message counts, so
    that a loss is a fault, False where it is not known; ``configured``: this is from a configuration.
    """

    stale_after_ns: int
    in_order: bool = False
    configured: bool = True


@dataclass(frozen=True)
class ClassicTopic:
    """A classic topic, whose memory cannot describe itself.

    ``semaphore`` is empty if there is none; ``stale_after_ns`` is how long its record may stay the same, 0
    for ever.
    """

    topic: str
    direction: Direction
    memory: str
    semaphore: str
    layout: Layout
    stale_after_ns: int = 0


@dataclass(frozen=True)
class Expected:
    """What configurations expect: per prefix and topic, and of classic topics with their bridge's prefix.

    ``calls`` are the objects of services and actions: prefix, name, part and client.
    ``stale_after_ns`` is for topics towards the PLC that no configuration names; 0 for never.
    """

    topics: Mapping[tuple[str, str], Expectation] = field(default_factory=dict)
    classic: tuple[tuple[str, ClassicTopic], ...] = ()
    calls: tuple[tuple[str, str, Part, str], ...] = ()
    stale_after_ns: int = 1_000_000_000
    prefixes: frozenset[str] = frozenset()

    def of(self, prefix: str, topic: str, direction: Direction, part: Part = Part.TOPIC) -> Expectation:
        """Return what is expected of a topic; calls may come at any time, or never."""
        if part is not Part.TOPIC:
            return Expectation(0, configured=any(call[:2] == (prefix, topic) for call in self.calls))
        # Without a configuration silence towards ROS is never stale.
        default = Expectation(self.stale_after_ns if direction is Direction.TO_PLC else 0, configured=False)
        return self.topics.get((prefix, topic)) or default


def expected_by(files: Iterable[Path]) -> Expected:
    """Read configurations and return what they expect together. Raises ConfigErrors if a file is wrong."""
    found = [expected_of(load_project(file)) for file in files]
    return Expected(
        {key: topic for each in found for key, topic in each.topics.items()},
        tuple(classic for each in found for classic in each.classic),
        tuple(call for each in found for call in each.calls),
        prefixes=frozenset().union(*(each.prefixes for each in found)),
    )


def expected_of(project: Project) -> Expected:
    """Return what a resolved configuration expects."""
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
    calls = [(prefix, plan.called, part, plan.client) for plan in project.calls for part in plan.parts]
    return Expected(topics, tuple(classic), tuple(calls), prefixes=frozenset({prefix}))
