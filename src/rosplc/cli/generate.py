"""``rosplc generate``: the PLC half of a configuration, ready for CODESYS."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from rosplc.cli.guard import guarded, print_json
from rosplc.cli.text import say

if TYPE_CHECKING:
    from rosplc.bridge.resolve import Project, TopicPlan
    from rosplc.layout import Layout
    from rosplc.plc.build import PlcTask, PlcTopic, ProjectOptions
    from rosplc.plc.project import PlcProject

__all__ = ["EPILOG", "command", "plc_project"]

EPILOG = """Examples:

rosplc generate rosplc.yaml --out plc  —  types, blocks, variable lists, programs, tasks of a configuration

rosplc generate --all-types jazzy --out plc  —  both blocks of every message type of a distribution

In CODESYS: Tools > Scripting > Execute Script File, and choose plc/rosplc_import.py.
"""

_TARGETS = ("x86", "arm")


@guarded
def command(
    config: Annotated[
        Path | None, typer.Argument(help="The configuration file, such as rosplc.yaml.")
    ] = None,
    out: Annotated[Path, typer.Option("--out", "-o", metavar="FOLDER", help="The folder to write.")] = Path(
        "plc"
    ),
    all_types: Annotated[
        str | None,
        typer.Option("--all-types", metavar="DISTRO", help="Every type of a ROS distribution, no topics."),
    ] = None,
    target: Annotated[
        str,
        typer.Option(
            metavar="PROCESSOR",
            help="Processor of the PLC: x86, or arm. On arm messages take longer, because no memory "
            "fence is proven there; see --fences.",
        ),
    ] = "x86",
    fences: Annotated[
        bool,
        typer.Option(
            "--fences", help="With --target arm: the device enables the MemoryBarrier library; trust it."
        ),
    ] = False,
    pins: Annotated[
        bool,
        typer.Option("--pins", help="Give blocks a pin per top-level field, for Ladder and Function Blocks."),
    ] = False,
    force: Annotated[bool, typer.Option("--force", help="Overwrite files that somebody edited.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Write the PLC half: Structured Text, PLCopenXML, an import script for CODESYS, a C header."""
    from rosplc.plc.build import ProjectOptions
    from rosplc.plc.delivery import project_files, write_files

    if (config is None) == (all_types is None):
        raise typer.BadParameter("name a configuration file, or ask for --all-types", param_hint="CONFIG")
    if target not in _TARGETS:
        raise typer.BadParameter(f"there are: {', '.join(_TARGETS)}", param_hint="--target")
    options = ProjectOptions(fenced=target == "x86" or fences, pins=pins)
    if config is not None:
        project, layouts = _from_config(config, options)
    else:
        project, layouts = _from_distro(str(all_types), options)
    delivery = write_files(out, project_files(project, layouts, "rosplc"), force=force)
    facts: dict[str, Any] = {
        "folder": str(out),
        "written": list(delivery.written),
        "unchanged": list(delivery.unchanged),
        "removed": list(delivery.removed),
        "notes": list(project.notes),
    }
    if as_json:
        print_json(facts)
        return
    say(
        f"{out}: {len(delivery.written)} files written, {len(delivery.unchanged)} unchanged, "
        f"{len(delivery.removed)} removed"
    )
    for note in project.notes:
        say(f"note: {note}")
    say(f"In CODESYS: Tools > Scripting > Execute Script File, and choose {out / 'rosplc_import.py'}")


def _from_config(config: Path, options: ProjectOptions) -> tuple[PlcProject, list[Layout]]:
    from rosplc.bridge.resolve import load_project

    project = load_project(config)
    topics = sorted(project.topics, key=lambda plan: plan.topic)  # as the PLC's objects are ordered
    return plc_project(project, options), [plan.layout for plan in topics]


def plc_project(project: Project, options: ProjectOptions) -> PlcProject:
    """Return the PLC project of a configuration.

    Raises:
        GenerationError: PLC003, more tasks are used than the blocks serve.
    """
    from dataclasses import replace

    from rosplc.plc.build import build_project

    topics, tasks = _topics(project), _tasks(project)
    slowest = max((task.interval_ns for task in tasks), default=0)
    settings = project.config.settings
    chosen = replace(
        options, prefix=settings.prefix, beat_ms=max(options.beat_ms, -(-slowest * 3 // 1_000_000))
    )
    return build_project(project.store, topics, tasks, chosen)


def _topics(project: Project) -> list[PlcTopic]:
    from rosplc.bridge.describe import object_size
    from rosplc.plc.build import PlcTopic
    from rosplc.plc.classic import Classic
    from rosplc.shm import Direction

    return [
        PlcTopic(
            topic=plan.topic,
            layout=plan.layout,
            direction="read" if plan.direction == Direction.TO_PLC else "write",
            task=plan.task,
            object_size=object_size(project, plan) if plan.classic is None else 0,
            stale_after_ns=plan.stale_after_ns,
            on_stale=_on_stale(plan),
            safe=plan.on_stale.value if plan.on_stale.action == "value" else None,
            in_order=plan.every,
            latched=plan.latched if plan.classic is None else plan.classic.retained,
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
    from rosplc.plc.build import PlcTask

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


def _from_distro(distro: str, options: ProjectOptions) -> tuple[PlcProject, list[Layout]]:
    from rosplc.layout import compute_layout
    from rosplc.model import TypeStore
    from rosplc.plc.build import build_type_library

    store = TypeStore.bundled(distro)
    layouts = [compute_layout(store, name) for name in store.names()]
    return build_type_library(store, layouts, options), layouts
