"""The PLC project of a resolved configuration."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

from rosplc.config.objects import object_size
from rosplc.config.resolve import Project, TopicPlan
from rosplc.plc.build import PlcTask, PlcTopic, ProjectOptions, build_project
from rosplc.plc.classic import Classic
from rosplc.plc.project import PlcProject
from rosplc.shm import Direction

__all__ = ["plc_project"]


def plc_project(project: Project, options: ProjectOptions) -> PlcProject:
    """Return the PLC project of a configuration.

    Raises:
        GenerationError: PLC003, more tasks are used than the blocks serve.
    """
    topics, tasks = _topics(project), _tasks(project)
    settings = project.config.settings
    return build_project(project.store, topics, tasks, replace(options, prefix=settings.prefix))


def _topics(project: Project) -> list[PlcTopic]:
    return [
        PlcTopic(
            topic=plan.topic,
            layout=plan.layout,
            direction="read" if plan.direction == Direction.TO_PLC else "write",
            task=plan.task,
            object_size=object_size(project, plan) if plan.port == "channel" else 0,
            stale_after_ns=plan.stale_after_ns,
            on_stale=_on_stale(plan),
            safe=plan.on_stale.value if plan.on_stale.action == "value" else None,
            in_order=plan.every,
            latched=plan.latched,
            classic=None
            if plan.classic is None
            else Classic(plan.classic.name, plan.classic.semaphore, plan.classic.wait_ns),
        )
        for plan in project.topics
    ]


def _on_stale(plan: TopicPlan) -> Literal["hold", "zero", "value"]:
    action = plan.on_stale.action
    return "hold" if action == "stop" or action == "substitute" else action


def _tasks(project: Project) -> list[PlcTask]:
    used = {plan.task for plan in project.topics}
    return [
        PlcTask(
            name=name,
            interval_ns=task.interval_ns,
            priority=task.priority,
            kind=task.kind,
            watchdog_ns=task.watchdog_ns or 0,
            watchdog_sensitivity=task.watchdog_sensitivity,
        )
        for name, task in project.config.settings.tasks.items()
        if name in used
    ]
