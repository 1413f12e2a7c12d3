"""What a configuration says about channels, for those who look at them from outside."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from rosplc.bridge.resolve import Project, load_project
from rosplc.monitor.expected import ClassicTopic, Expectation, Expected

__all__ = ["expected_by", "expected_of"]


def expected_by(files: Iterable[Path]) -> Expected:
    """Read configurations and return what they say together; of none, what holds without any.

    Raises:
        ConfigErrors: A file is wrong.
    """
    topics: dict[tuple[str, str], Expectation] = {}
    classic: list[tuple[str, ClassicTopic]] = []
    for file in files:
        found = expected_of(load_project(file))
        topics.update(found.topics)
        classic += found.classic
    return Expected(topics, tuple(classic))


def expected_of(project: Project) -> Expected:
    """Return what a resolved configuration says."""
    prefix = project.namespace.prefix
    topics: dict[tuple[str, str], Expectation] = {}
    classic: list[tuple[str, ClassicTopic]] = []
    for plan in project.topics:
        if plan.classic is None:
            topics[prefix, plan.topic] = Expectation(plan.stale_after_ns, in_order=plan.every)
            continue
        names = plan.classic
        topic = ClassicTopic(
            plan.topic, plan.direction, names.name, names.semaphore, plan.layout, plan.stale_after_ns
        )
        classic.append((prefix, topic))
    return Expected(topics, tuple(classic))
