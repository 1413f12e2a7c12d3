"""A configuration without a running bridge: its consequences, its probable mistakes and its PLC code."""

from __future__ import annotations

import json
import os
import platform
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

from rosplc.bridge.realtime import contention
from rosplc.bridge.ros_side import choose_backend
from rosplc.config.plans import ActionPlan, CallPlan, ServicePlan, flag_topic
from rosplc.config.quantities import format_duration
from rosplc.config.resolve import Project, TopicPlan, load_project, object_plans, open_doors
from rosplc.errors import GenerationError, RosplcError
from rosplc.harmless import in_bytes
from rosplc.layout import Layout, compute_layout
from rosplc.layout.nodes import SequenceNode, StringNode
from rosplc.model import TypeStore
from rosplc.plc import build
from rosplc.plc.delivery import Delivery, project_files, write_files
from rosplc.plc.names import instance_names
from rosplc.plc.openplc import openplc_files, openplc_types
from rosplc.plc.plan import ProjectOptions, target_of
from rosplc.plc.project import PlcProject
from rosplc.ros import INSTALL, Choice
from rosplc.ros.choice import why_not_installed
from rosplc.shm import Part
from rosplc.shm.files import group_name, user_name

_SEMAPHORE = 32
_LARGE_RECORD = 64 * 1024
_MUCH_MEMORY = 32 * 1024 * 1024


def check(config: Path | str | Project) -> dict[str, Any]:
    """Return the consequences of a configuration, or of its file, as `rosplc check --json` prints them.

    Raises ConfigErrors with all errors, each with its file, line and key.
    """
    project = config if isinstance(config, Project) else load_project(config)
    settings = project.config.settings
    chosen = chosen_backend(project)
    found = plc_names(project)
    names = {} if isinstance(found, RosplcError) else found
    return {
        "bridge": settings.bridge,
        "prefix": settings.prefix,
        "backend": settings.ros.backend,
        "backend_here": None
        if isinstance(chosen, RosplcError)
        else {"name": chosen.name, "why": chosen.why, "passed_over": dict(chosen.passed_over)},
        "distro": settings.ros.distro,
        "access": access(project),
        "tasks": {
            name: {"kind": task.kind, "interval_ms": task.interval_ns / 1e6, "priority": task.priority}
            for name, task in settings.tasks.items()
        },
        "topics": {plan.topic: _topic_facts(project, plan, names) for plan in project.topics},
        "services": [_call_facts(project, plan, names) | _service_facts(plan) for plan in project.services],
        "actions": [_call_facts(project, plan, names) | _action_facts(plan) for plan in project.actions],
        "memory_bytes": total_memory(project),
        "unusable_types": [error.to_dict() for error in project.store.problems()],
        "warnings": warnings(project),
    }


def chosen_backend(project: Project) -> Choice | RosplcError:
    """Return the backend that the configuration selects on this machine, or the error if there is none."""
    try:
        return choose_backend(project.config)
    except RosplcError as error:
        return error


def plc_names(project: Project) -> dict[str, tuple[str, str]] | GenerationError:
    """Return the instance and block of each topic and call in the PLC code, or why it cannot be generated."""
    try:
        made = build.plc_project(project, ProjectOptions())
    except GenerationError as error:
        return error
    blocks = {
        (gvl.name, variable.name): variable.type
        for gvl in made.gvls
        for block in gvl.blocks
        for variable in block.variables
    }
    found = {}
    for gvl, direction in ((build.READ_GVL, 1), (build.WRITE_GVL, 2)):
        topics = [plan.topic for plan in project.topics if plan.direction == direction]
        for topic, instance in instance_names(topics).items():
            found[topic] = f"{gvl}.{instance}", blocks[gvl, instance]
    for gvl in (build.SERVICE_GVL, build.ACTION_GVL):
        for (_, plan), instance in build.use_names(gvl, project.calls):
            found[plan.name] = f"{gvl}.{instance}", blocks[gvl, instance]
    return found


def generate(
    config: Path | str | Project,
    folder: Path | str = "plc",
    *,
    plc: Literal["codesys", "openplc", "matiec"] = "codesys",
    target: Literal["x86", "arm"] | None = None,
    fences: bool = False,
    programs: str | None = None,
    pins: bool = False,
    force: bool = False,
) -> Delivery:
    """Write the PLC code of a configuration: Structured Text, PLCopenXML, import script, C header.

    Args:
        config: The file, or the result of :func:`load_project`.
        folder: The output folder; created if missing.
        plc: ``"openplc"``: for OpenPLC Runtime 4.1; ``"matiec"``: for OpenPLC v3 and Beremiz. Both ignore
            the next four arguments.
        target: The PLC's processor; None: that of this machine.
        fences: On ``"arm"``: the device enables the MemoryBarrier library.
        programs: The prefix of the generated programs' names; None: the configuration's ``programs``.
        pins: Give blocks one pin per top-level field, for Ladder and Function Block Diagram.
        force: Overwrite files that were edited.

    Raises:
        ConfigErrors: The configuration is wrong.
        GenerationError: The code cannot be generated, or a file was edited (PLC001).
    """
    project = config if isinstance(config, Project) else load_project(config)
    if plc != "codesys":
        return _write(*openplc_files(project, plc), folder, force)
    options = _options(target, fences, programs or project.config.settings.programs, pins)
    made = build.plc_project(project, options)
    topics = sorted(project.topics, key=lambda plan: plan.topic)  # as the PLC's objects are ordered
    layouts = [plan.layout for plan in topics]
    layouts += [layout for plan in project.calls for layout in plan.layouts]
    return _deliver(made, layouts, folder, force=force)


def generate_types(
    distro: str,
    folder: Path | str = "plc",
    *,
    plc: Literal["codesys", "openplc", "matiec"] = "codesys",
    target: Literal["x86", "arm"] | None = None,
    fences: bool = False,
    programs: str = "SharedMemory",
    pins: bool = False,
    force: bool = False,
) -> Delivery:
    """Write both blocks for each message type of a distribution; arguments and errors as :func:`generate`."""
    if plc != "codesys":
        return _write(*openplc_types(distro, plc), folder, force)
    store = TypeStore.bundled(distro)
    layouts = [compute_layout(store, name) for name in store.names()]
    options = _options(target, fences, programs, pins)
    return _deliver(build.build_type_library(store, layouts, options), layouts, folder, force=force)


def _options(target: Literal["x86", "arm"] | None, fences: bool, programs: str, pins: bool) -> ProjectOptions:
    processor = target or target_of(platform.machine())
    return ProjectOptions(target=processor, fenced=processor == "x86" or fences, programs=programs, pins=pins)


def _deliver(project: PlcProject, layouts: list[Layout], folder: Path | str, *, force: bool) -> Delivery:
    return _write(project_files(project, layouts, "rosplc"), project.notes, folder, force)


def _write(files: dict[str, bytes], notes: tuple[str, ...], folder: Path | str, force: bool) -> Delivery:
    return replace(write_files(Path(folder), files, force=force), notes=notes)


def expected_files(project: Project, options: ProjectOptions) -> Mapping[str, bytes]:
    """Return the files that would be generated for a project: path below the folder → content."""
    return project_files(build.plc_project(project, options), [], "rosplc")


def access(project: Project) -> dict[str, Any]:
    """Return who may open the objects: mode, owner and group, by name if this machine knows the name."""
    shm = project.config.settings.shm
    return {
        "mode": f"{shm.mode:04o}",
        "owner": user_name(shm.owner) if isinstance(shm.owner, int) else shm.owner,
        "group": group_name(shm.group) if isinstance(shm.group, int) else shm.group,
    }


def memory(project: Project, plan: TopicPlan) -> dict[str, int]:
    """Return the shared memory that a topic needs, and its parts, in bytes.

    ``memory_bytes`` is the memory used on the machine, in whole pages; the other parts add up to
    ``object_bytes``.
    """
    if plan.classic is not None:
        lock = _SEMAPHORE if plan.classic.semaphore else 0
        return {
            "memory_bytes": _pages(plan.layout.size) + _pages(lock),
            "object_bytes": plan.layout.size,
            "semaphore_bytes": lock,
        }
    made = object_plans(project, plan)[Part.TOPIC]
    return {
        "memory_bytes": _pages(made.object_size),
        "object_bytes": made.object_size,
        "header_bytes": made.description_offset,
        "description_bytes": made.slots_offset - made.description_offset,
        "slots": made.slot_count,
        "slot_bytes": made.slot_stride,
    }


def call_memory(project: Project, plan: CallPlan) -> int:
    """Return the shared memory that one use of a service or action needs: whole pages, in bytes."""
    return sum(_pages(made.object_size) for made in object_plans(project, plan).values())


def total_memory(project: Project) -> int:
    """Return the shared memory that a configuration needs, in bytes."""
    topics = sum(memory(project, plan)["memory_bytes"] for plan in project.topics)
    return topics + sum(call_memory(project, plan) for plan in project.calls)


def _pages(count: int) -> int:
    page = os.sysconf("SC_PAGESIZE")
    return -(-count // page) * page


def _topic_facts(project: Project, plan: TopicPlan, names: dict[str, tuple[str, str]]) -> dict[str, Any]:
    instance, block = names.get(plan.topic, (None, None))
    parts, safe, classic = memory(project, plan), plan.on_stale, None
    if plan.classic is not None:
        classic = {
            "memory": plan.classic.name,
            "semaphore": plan.classic.semaphore or None,
            "wait_ms": plan.classic.wait_ns / 1e6,
            "recover_after_ms": plan.classic.recover_after_ns / 1e6,
            "poll_ms": plan.classic.poll_ns / 1e6,
        }
    return {
        "object": project.object_name(plan),
        "classic": classic,
        "type": plan.type_name,
        "to": "plc" if plan.direction == 1 else "ros",
        "task": plan.task,
        "instance": instance,
        "block": block,
        "layout_id": plan.layout.layout_id,
        "record_bytes": plan.layout.size,
        "limits": capacities(plan.layout),
        "slots": plan.slots,
        "memory_bytes": parts["memory_bytes"],
        "memory": parts,
        "every": plan.every,
        "qos": {
            "reliability": plan.qos.reliability,
            "durability": plan.qos.durability,
            "depth": plan.qos.depth,
            "deadline_ms": plan.qos.deadline_ns / 1e6,
            "lease_ms": plan.qos.lease_ns / 1e6,
        },
        "stale_after_ms": plan.stale_after_ns / 1e6,
        "on_stale": {
            "action": safe.action,
            "value": dict(safe.value) if safe.record else None,
            "period_ms": safe.period_ns / 1e6 if safe.action == "substitute" else None,
            "flag_topic": flag_topic(plan.topic) if safe.action == "substitute" else None,
        },
        "when_silent": when_silent(project, plan),
        "min_interval_ms": plan.min_interval_ns / 1e6,
        "on_change": plan.on_change,
        "print": plan.print,
        "on_overflow": "truncate" if plan.truncate else "refuse",
    }


def _call_facts(project: Project, plan: CallPlan, names: dict[str, tuple[str, str]]) -> dict[str, Any]:
    instance, block = names.get(plan.name, (None, None))
    return {
        plan.kind: plan.called,
        "type": plan.type_name,
        "server": plan.server,
        "client": plan.client,
        "task": plan.task,
        "instance": instance,
        "block": block,
        "objects": {
            part.word: {
                "name": project.namespace.object_name(plan.called, part, plan.client),
                "layout_id": layout.layout_id,
                "record_bytes": layout.size,
                "limits": capacities(layout),
            }
            for part, layout in zip(plan.parts, plan.layouts, strict=True)
        },
        "memory_bytes": call_memory(project, plan),
        "on_overflow": "truncate" if plan.truncate else "refuse",
    }


def _service_facts(plan: ServicePlan) -> dict[str, Any]:
    at_plc = plan.server == "plc"
    return {
        "depth": plan.depth if at_plc else None,
        "per_client": plan.per_client if at_plc else None,
        "min_interval_ms": plan.min_interval_ns / 1e6,
        "expire_after_ms": plan.expire_after_ns / 1e6 if at_plc else None,
        "fallback": None if plan.fallback is None else plan.response.to_dict(plan.fallback),
    }


def _action_facts(plan: ActionPlan) -> dict[str, Any]:
    at_plc = plan.server == "plc"
    return {
        "on_new_goal": plan.on_new_goal if at_plc else None,
        "queue": plan.queue if at_plc else None,
        "accept_within_ms": plan.accept_within_ns / 1e6 if at_plc else None,
        "keep_result_ms": plan.keep_result_ns / 1e6 if at_plc else None,
        "when_plc_down": None if at_plc else plan.when_plc_down,
    }


def capacities(layout: Layout) -> dict[str, int]:
    """Return the effective capacity of every string (bytes) and sequence (elements), by path."""
    return {
        path: node.capacity
        for path, _, node in layout.fields()
        if isinstance(node, StringNode | SequenceNode)
    }


def when_silent(project: Project, plan: TopicPlan) -> str:
    """Describe in plain words what happens while the topic's source is silent."""
    safe, after = plan.on_stale, format_duration(plan.stale_after_ns)
    if plan.direction == 1:
        if not plan.stale_after_ns:
            return "the PLC keeps the last message, and xStale is never set"
        value = {
            "hold": "the PLC keeps the last message and sets xStale",
            "zero": "every byte of the PLC's msg is zero, with xSubstituted and xStale set",
        }.get(safe.action, f"the PLC's msg is {_shown(safe.value)}, with xSubstituted and xStale set")
        lives = "" if safe.action == "hold" else ", whether or not the bridge runs"
        unchanged = "; a source whose record does not change counts as silent" if plan.classic else ""
        return f"after {after} {value}{lives}{unchanged}"
    diagnostics = project.config.settings.diagnostics
    report = ""
    if plan.stale_after_ns and diagnostics.enabled:
        report = f"; {format_duration(diagnostics.debounce_ns)} later /diagnostics shows STALE"
    if safe.action == "substitute":
        return (
            f"after {after} ROS receives {_shown(safe.value)} every {format_duration(safe.period_ns)}, "
            f"and {flag_topic(plan.topic)} is true{report}"
        )
    return f"ROS receives nothing{report}"


def _shown(value: Mapping[str, Any]) -> str:
    """Return a message's fields as in a configuration, shortened."""
    text = json.dumps(value, ensure_ascii=False)
    return "the type's initial message" if not value else text if len(text) <= 60 else text[:57] + "…"


def warnings(project: Project) -> list[str]:
    """Return warnings about settings that are valid but probably not intended."""
    found = []
    if isinstance(chosen := chosen_backend(project), RosplcError):
        found.append(f"the bridge would not start on this machine: {chosen.what}. {chosen.remedy}")
    elif missing := why_not_installed(chosen.name):
        found.append(
            f"the bridge would not start on this machine: the package for the {chosen.name} backend cannot "
            f"be imported: {missing}. For {chosen.name}: {INSTALL.get(chosen.name, 'a complete rosplc')}."
        )
    if (here := os.environ.get("ROS_DISTRO")) and here != project.config.settings.ros.distro:
        found.append(
            f"ROS_DISTRO is {here}, but ros.distro is {project.config.settings.ros.distro}: message "
            "definitions may differ. Set ros.distro to the installed distribution, unless this is intended."
        )
    found += [*open_doors(project.config), *contention(project.config)]
    if isinstance(names := plc_names(project), RosplcError):
        found.append(f"rosplc generate would fail: {names.what} [{names.code}]. {names.remedy}")
    if not project.plans:
        found.append("the file has no topics, services or actions, so a bridge would carry nothing")
    for plan in project.topics:
        if plan.layout.size > _LARGE_RECORD:
            found.append(
                f"{plan.topic}: a record is {in_bytes(plan.layout.size)} long; copying it takes a noticeable "
                "part of a scan. Lower the topic's largest limits (rosplc types shows them)."
            )
        if plan.truncate:
            found.append(
                f"{plan.topic}: on_overflow is truncate, so the PLC may receive truncated data (xTruncated)."
            )
        if plan.classic is not None and plan.on_stale.action in ("zero", "value"):
            found.append(
                f"{plan.topic}: in classic memory, only a changed record indicates a new message, so "
                "on_stale treats unchanged messages as silence. Let the source change a field every time."
            )
        if plan.classic is not None and not plan.classic.semaphore:
            found.append(
                f"{plan.topic}: no lock guards the classic memory {plan.classic.name}, so a record larger "
                "than a machine word may be read while it is being written."
            )
    total = sum(memory(project, plan)["memory_bytes"] for plan in project.topics)
    if total > _MUCH_MEMORY:
        found.append(
            f"all topics together need {in_bytes(total)} of shared memory; "
            "containers often have only 64 MiB (--shm-size)."
        )
    return found
