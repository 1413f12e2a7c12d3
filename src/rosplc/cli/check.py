"""``rosplc check``: what a configuration means, in plain words, before anything runs."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from rosplc.cli.guard import guarded, print_json
from rosplc.cli.text import columns, in_bytes, say
from rosplc.errors import RosplcError

if TYPE_CHECKING:
    from rosplc.bridge.classic_plan import ClassicPlan
    from rosplc.bridge.resolve import Project, TopicPlan
    from rosplc.ros import Choice

__all__ = ["EPILOG", "command"]

EPILOG = """Examples:

rosplc check rosplc.yaml  —  explain the file, or say with line and key what is wrong in it

rosplc check rosplc.yaml --json  —  the same for programs

rosplc check --schema > rosplc.schema.json  —  for an editor that completes keys
"""

_OVERHEAD = 512 + 64
_PAGE = 4096


@guarded
def command(
    config: Annotated[
        Path | None, typer.Argument(help="The configuration file, such as rosplc.yaml.")
    ] = None,
    schema: Annotated[
        bool, typer.Option("--schema", help="Print the JSON Schema of configuration files.")
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Explain a configuration: per topic direction, type, sizes, memory and quality of service."""
    if schema:
        from rosplc.bridge.config import json_schema

        print_json(json_schema())
        return
    if config is None:
        raise typer.BadParameter("name a configuration file, or ask for --schema", param_hint="CONFIG")
    from rosplc.bridge.resolve import load_project

    project = load_project(config)
    if as_json:
        print_json(facts(project))
    else:
        _explain(project)


def facts(project: Project) -> dict[str, Any]:
    """Return what a configuration leads to, as plain data."""
    settings = project.config.settings
    chosen = chosen_backend(project)
    return {
        "bridge": settings.bridge,
        "prefix": settings.prefix,
        "backend": settings.ros.backend,
        "backend_here": None
        if isinstance(chosen, RosplcError)
        else {"name": chosen.name, "why": chosen.why, "passed_over": dict(chosen.passed_over)},
        "distro": settings.ros.distro,
        "topics": {plan.topic: _topic_facts(project, plan) for plan in project.topics},
        "memory_bytes": sum(_memory(plan) for plan in project.topics),
        "warnings": warnings(project),
    }


def chosen_backend(project: Project) -> Choice | RosplcError:
    """Return the backend that the configuration leads to on this machine, or why there is none."""
    from rosplc.bridge.ros_side import choose_backend

    try:
        return choose_backend(project.config)
    except RosplcError as error:
        return error


def _topic_facts(project: Project, plan: TopicPlan) -> dict[str, Any]:
    return {
        "object": plan.classic.name if plan.classic else project.namespace.object_name(plan.topic),
        "classic": None if plan.classic is None else _classic_facts(plan.classic),
        "type": plan.type_name,
        "to": "plc" if plan.direction == 1 else "ros",
        "task": plan.task,
        "layout_id": plan.layout.layout_id,
        "record_bytes": plan.layout.size,
        "slots": plan.slots,
        "memory_bytes": _memory(plan),
        "every": plan.every,
        "qos": {
            "reliability": plan.qos.reliability,
            "durability": plan.qos.durability,
            "depth": plan.qos.depth,
            "deadline_ms": plan.qos.deadline_ns / 1e6,
            "lease_ms": plan.qos.lease_ns / 1e6,
        },
        "stale_after_ms": plan.stale_after_ns / 1e6,
        "on_stale": _stale_facts(plan),
        "when_silent": _when_silent(project, plan),
        "min_interval_ms": plan.min_interval_ns / 1e6,
        "on_change": plan.on_change,
        "print": plan.print,
        "on_overflow": "truncate" if plan.truncate else "refuse",
    }


def _stale_facts(plan: TopicPlan) -> dict[str, Any]:
    from rosplc.bridge.stale_plan import flag_topic

    safe = plan.on_stale
    substituted = safe.action == "substitute"
    return {
        "action": safe.action,
        "value": dict(safe.value) if safe.record else None,
        "period_ms": safe.period_ns / 1e6 if substituted else None,
        "flag_topic": flag_topic(plan.topic) if substituted else None,
    }


def _classic_facts(plan: ClassicPlan) -> dict[str, Any]:
    return {
        "memory": plan.name,
        "semaphore": plan.semaphore or None,
        "wait_ms": plan.wait_ns / 1e6,
        "recover_after_ms": plan.recover_after_ns / 1e6,
        "poll_ms": plan.poll_ns / 1e6,
    }


def _classic_rows(plan: TopicPlan, classic: ClassicPlan) -> list[tuple[str, str]]:
    from rosplc.bridge.quantities import format_duration

    lock = "none: a record may be read while it is written"
    if classic.semaphore:
        lock = (
            f"semaphore {classic.semaphore}, tried for {format_duration(classic.wait_ns)}, freed when it is "
            f"held for {format_duration(classic.recover_after_ns)} without a sign of life"
        )
    rows = [("classic", f"memory {classic.name} with the bare record"), ("lock", lock)]
    if plan.direction != 1:
        what = "a changed record is a message" if plan.on_change else "every look is a message"
        rows.append(("looks", f"every {format_duration(classic.poll_ns)}; {what}"))
    return rows


def _memory(plan: TopicPlan) -> int:
    if plan.classic is not None:
        return -(-plan.layout.size // _PAGE) * _PAGE
    # The self-description's length is not known before the object is made; its text dominates.
    description = len(plan.layout.store.definition_text(plan.type_name)) + 512
    stride = -(-(plan.layout.size + 64) // 64) * 64
    return -(-(_OVERHEAD + description + plan.slots * stride) // _PAGE) * _PAGE


def warnings(project: Project) -> list[str]:
    """Return what is allowed but probably not meant."""
    from rosplc.bridge.access import open_doors
    from rosplc.bridge.realtime import contention
    from rosplc.ros import INSTALL
    from rosplc.ros.choice import why_not_installed

    found = []
    if isinstance(chosen := chosen_backend(project), RosplcError):
        found.append(f"on this machine the bridge would not start: {chosen.what}. {chosen.remedy}")
    elif missing := why_not_installed(chosen.name):
        found.append(
            f"on this machine the bridge would not start: the package of backend {chosen.name} is not "
            f"installed: {missing}. For {chosen.name}: {INSTALL.get(chosen.name, 'a complete rosplc')}."
        )
    found += [*open_doors(project.config), *contention(project.config)]
    if not project.topics:
        found.append("the file names no topics: a bridge would carry nothing")
    for plan in project.topics:
        if plan.layout.size > 64 * 1024:
            found.append(
                f"{plan.topic}: a record has {in_bytes(plan.layout.size)}; copying it takes part of a scan. "
                "Lower the limits of its largest fields (rosplc types shows them)."
            )
        if plan.truncate:
            found.append(
                f"{plan.topic}: on_overflow is truncate, so the PLC may see shortened data (xTruncated)."
            )
        if plan.classic is not None and plan.on_stale.action in ("zero", "value"):
            found.append(
                f"{plan.topic}: on_stale with classic: the same message sent again and again counts as "
                "silent, because nothing in a bare record tells of it; let the source change a field."
            )
        if plan.classic is not None and not plan.classic.semaphore:
            found.append(
                f"{plan.topic}: nothing guards the classic memory {plan.classic.name}; a record larger than "
                "a word can be read half written."
            )
    total = sum(_memory(plan) for plan in project.topics)
    if total > 32 * 1024 * 1024:
        found.append(
            f"all objects together take {in_bytes(total)} of shared memory; "
            "containers often have 64 MiB of it (--shm-size)."
        )
    return found


def _sieve(plan: TopicPlan) -> str:
    words = ["only what changed"] if plan.on_change else []
    if plan.min_interval_ns:
        words.append(f"one message per {plan.min_interval_ns / 1e6:g} ms at most")
    return ", ".join(words)


def _qos_words(plan: TopicPlan) -> str:
    from rosplc.bridge.quantities import format_duration

    qos = plan.qos
    words = [qos.reliability, qos.durability, f"depth {qos.depth}"]
    times = (("deadline", qos.deadline_ns), ("lease", qos.lease_ns))
    return ", ".join([*words, *(f"{word} {format_duration(ns)}" for word, ns in times if ns)])


def _when_silent(project: Project, plan: TopicPlan) -> str:
    """Say in plain words what happens while the topic's source says nothing."""
    from rosplc.bridge.quantities import format_duration
    from rosplc.bridge.stale_plan import flag_topic

    safe, after = plan.on_stale, format_duration(plan.stale_after_ns)
    if plan.direction == 1:
        if not plan.stale_after_ns:
            return "the PLC keeps the last message, and xStale never comes"
        value = {
            "hold": "the PLC keeps the last message",
            "zero": "every byte of the PLC's msg is zero, with xSubstituted",
        }.get(safe.action, f"the PLC's msg is {_shown(safe.value)}, with xSubstituted")
        lives = "" if safe.action == "hold" else ", whether or not the bridge lives"
        unchanged = "; a record that does not change counts as silent" if plan.classic else ""
        return f"after {after} {value} and xStale{lives}{unchanged}"
    diagnostics = project.config.settings.diagnostics
    report = ""
    if plan.stale_after_ns and diagnostics.enabled:
        report = f"; {format_duration(diagnostics.debounce_ns)} later /diagnostics says STALE"
    if safe.action == "substitute":
        return (
            f"after {after} ROS gets {_shown(safe.value)} every {format_duration(safe.period_ns)}, "
            f"and {flag_topic(plan.topic)} says so{report}"
        )
    return f"ROS gets nothing{report}"


def _shown(value: Mapping[str, Any]) -> str:
    """Return a message's fields as a configuration writes them, shortened."""
    import json

    text = json.dumps(value, ensure_ascii=False)
    return "the type's initial message" if not value else text if len(text) <= 60 else text[:57] + "…"


def _explain(project: Project) -> None:
    settings = project.config.settings
    topics = project.topics
    name = project.config.path or "the configuration"
    say(f"{name} is valid.")
    say(
        f"Bridge {settings.bridge}: {len(topics)} topic{'s' if len(topics) != 1 else ''}, "
        f"ROS backend {settings.ros.backend}, definitions of {settings.ros.distro}, "
        f"objects named {settings.prefix}.t.… in {settings.shm.directory}."
    )
    if settings.ros.backend == "auto" and not isinstance(chosen := chosen_backend(project), RosplcError):
        say(f"ROS backend auto is {chosen}.")
    domain = settings.ros.domain
    if settings.ros.distro == "noetic":
        say("ROS master: ROS_MASTER_URI's, else http://localhost:11311.")
    else:
        say(f"ROS domain {domain}." if domain is not None else "ROS domain: ROS_DOMAIN_ID's, else 0.")
    given = settings.topics
    for plan in topics:
        arrow = "ROS → PLC" if plan.direction == 1 else "PLC → ROS"
        entry = given[plan.topic]
        how = "every message, in order" if plan.every else "the newest message"
        qos = "as configured" if entry.qos.model_fields_set else "default"
        slots = "as configured" if entry.depth is not None else "default"
        stale = f"{plan.stale_after_ns / 1e6:g} ms" if plan.stale_after_ns else "never"
        say(f"\n{plan.topic}  {arrow}  {plan.type_name}")
        rows = [
            ("record", f"{in_bytes(plan.layout.size)}, layout id {plan.layout.layout_id}"),
            *(
                [("slots", f"{plan.slots} ({slots}), {in_bytes(_memory(plan))} of shared memory")]
                if plan.classic is None
                else []
            ),
            *([] if plan.classic is None else _classic_rows(plan, plan.classic)),
            ("takes", f"{how}; PLC task {plan.task}"),
            ("QoS", f"{_qos_words(plan)} ({qos})"),
            ("stale after", stale),
            ("when silent", _when_silent(project, plan)),
        ]
        if plan.direction == 1:
            rows.append(("too large", "cut and counted" if plan.truncate else "refused and counted"))
        if sieve := _sieve(plan):
            rows.append(("passes on", sieve))
        if plan.print:
            rows.append(("print", "each message is logged"))
        for line in columns(rows, indent=2):
            say(line)
    say(f"\nShared memory in all: {in_bytes(sum(_memory(plan) for plan in topics))}.")
    for text in warnings(project):
        say(f"Warning: {text}")
