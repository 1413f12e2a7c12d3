"""``rosplc check``: what a configuration means, in plain words, before anything runs.

rosplc check  —  explain rosplc.yaml, or report its errors with line and key

rosplc check rosplc.yaml --verbose  —  every detail of every topic

rosplc check rosplc.yaml --json  —  the same information as JSON

rosplc check --fix  —  rename keys whose names have changed since the file was written

rosplc check --schema > rosplc.schema.json  —  write a schema that lets an editor complete keys
"""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from rosplc.cli.options import ConfigFile, config_file
from rosplc.cli.text import columns, print_json, say, terminal_width, warn, wrap
from rosplc.cli.verb import verb
from rosplc.config.file import json_schema, rename_keys
from rosplc.config.plans import ActionPlan, CallPlan, ClassicPlan, ServicePlan
from rosplc.config.quantities import format_duration
from rosplc.config.resolve import Project, TopicPlan, load_project
from rosplc.config.settings import TopicSettings
from rosplc.config.yaml_source import read_text
from rosplc.errors import RosplcError
from rosplc.harmless import plural
from rosplc.layout import Layout
from rosplc.project import (
    access,
    capacities,
    check,
    chosen_backend,
    memory,
    plc_names,
    total_memory,
    warnings,
    when_silent,
)

_SCREEN = 24  # lines that are printed without --verbose
_WARNINGS = 6
_CALLS = ("direction", "type", "bytes", "client", "task", "queue limit", "in the PLC")
_WAYS = {1: "ROS → PLC", 2: "PLC → ROS"}


@verb
def command(
    config: ConfigFile = None,
    *,
    verbose: bool = False,
    schema: bool = False,
    fix: bool = False,
    as_json: bool = False,
) -> None:
    """Check and explain a configuration: entries, directions, settings, and access to shared memory.

    Options:
        verbose: Show details of each topic, such as memory, QoS and fail-safe behavior.
        schema: Print the JSON Schema of configuration files.
        fix: Rename keys whose names have changed; comments and formatting are kept.
    """
    if schema:
        print_json(json_schema())
        return
    path = config_file(config)
    if fix:
        _fix(path)
    project = load_project(path)
    if as_json:
        print_json(check(project))
    else:
        _explain(project, verbose=verbose)


def _fix(path: Path) -> None:
    before = read_text(path)
    after, changes = rename_keys(before, name=str(path))
    if changes:
        mark = b"\xef\xbb\xbf" if path.read_bytes().startswith(b"\xef\xbb\xbf") else b""
        real = path.resolve()
        temporary = real.with_name(f".{real.name}.new")
        temporary.write_bytes(mark + after.encode())
        shutil.copymode(real, temporary)
        temporary.replace(real)
    for change in changes:
        warn(change)


def _explain(project: Project, *, verbose: bool) -> None:
    head = [f"{project.config.path or 'The configuration'} is valid.", *_head(project)]
    total = list(_total(project))
    found = [f"Warning: {text}" for text in warnings(project)]
    unusable = project.store.problems()
    if unusable:
        what = plural(len(unusable), "custom type")
        more = "" if verbose else " (rosplc check -v)"
        total.append(f"{what} in types.paths cannot be used, which does not affect this configuration{more}.")
    if verbose:
        # A type that needs another has the other's mistake.
        listed = dict.fromkeys(f"  {error.where}: {error.what} [{error.code}]" for error in unusable)
        for line in (*head, *_details(project), *total, *listed, *found):
            say(line)
        return
    if len(found) > _WARNINGS:
        found[_WARNINGS - 1 :] = [f"{plural(len(found) - _WARNINGS + 1, 'more warning')} (rosplc check -v)"]
    body = [*_table(project), *_calls(project), *_limits(project)]
    width = terminal_width()
    around = sum(wrap(line, width).count("\n") + 1 for line in (*head, *total, *found))
    room = max(3, _SCREEN - around - 1)
    if len(body) > room:
        body[room - 1 :] = ["… (rosplc check -v prints every topic)"]
    for line in (*head, *body, *total, *found):
        say(line)


def _names(project: Project) -> dict[str, tuple[str, str]]:
    found = plc_names(project)
    return {} if isinstance(found, RosplcError) else found


def _table(project: Project) -> Iterator[str]:
    names, rows = _names(project), []
    for plan in project.topics:
        stale = format_duration(plan.stale_after_ns) if plan.stale_after_ns else "never"
        instance = names[plan.topic][0] if plan.topic in names else "-"
        rows.append((plan.topic, _WAYS[plan.direction], plan.type_name, plan.layout.size, stale, instance))
    if rows:
        yield ""
    yield from columns(rows, header=("topic", "direction", "type", "bytes", "stale after", "in the PLC"))


def _calls(project: Project) -> Iterator[str]:
    names = _names(project) if project.calls else {}
    for plans in (project.services, project.actions):
        rows = []
        for plan in plans:
            way = "ROS calls PLC" if plan.server == "plc" else "PLC calls ROS"
            sizes = " + ".join(str(layout.size) for layout in plan.layouts)
            about = plan.client or "-", plan.task, _queue(plan), names.get(plan.name, "-")[0]
            rows.append((plan.called, way, plan.type_name, sizes, *about))
        if plans:
            yield ""
            yield from columns(rows, header=(plans[0].kind, *_CALLS))


def _queue(plan: ServicePlan | ActionPlan) -> str:
    if plan.server == "ros":
        return "-"
    if isinstance(plan, ServicePlan):
        return f"{plan.depth} calls, {format_duration(plan.expire_after_ns)}"
    return f"{plan.queue} goals" if plan.queue else "1 goal" if plan.on_new_goal == "abort" else "none"


def _limits(project: Project) -> Iterator[str]:
    rows = [(plan.topic, limits) for plan in project.topics if (limits := _capacities(plan.layout))]
    # All uses of a service or action have the same.
    for plan in {(plan.kind, plan.called): plan for plan in project.calls}.values():
        rows += [
            (f"{plan.called} {part.word}", limits)
            for part in plan.parts
            if (limits := _capacities(plan.layout(part)))
        ]
    if rows:
        yield "\nLimits (strings in bytes, sequences in elements):"
    yield from columns(rows, indent=2)


def _capacities(layout: Layout) -> str:
    return ", ".join(f"{path} {capacity}" for path, capacity in capacities(layout).items())


def _details(project: Project) -> Iterator[str]:
    names = _names(project)
    for plan in project.topics:
        yield f"\n{plan.topic}  {_WAYS[plan.direction]}  {plan.type_name}"
        yield from columns(_rows(project, plan, names.get(plan.topic)), indent=2)
    for call in (*project.services, *project.actions):
        way = "provided by the PLC" if call.server == "plc" else "called by the PLC"
        yield f"\n{call.name}  {way}  {call.type_name}"
        in_plc = [("in the PLC", "{} (block {})".format(*names[call.name]))] if call.name in names else []
        yield from columns((*_call_rows(call), *in_plc), indent=2)


def _call_rows(plan: CallPlan) -> Iterator[tuple[str, str]]:
    for part, layout in zip(plan.parts, plan.layouts, strict=True):
        yield part.word, f"{plural(layout.size, 'byte')}, layout id {layout.layout_id}"
        if limits := _capacities(layout):
            yield "limits", limits
    yield "task", plan.task
    yield "too large", "truncated" if plan.truncate else "refused and counted"
    if isinstance(plan, ServicePlan) and plan.server == "plc":
        yield "waiting", f"at most {plan.depth} calls, {plan.per_client} per caller"
        yield "expires", f"a call that is still waiting after {format_duration(plan.expire_after_ns)}"
        if plan.min_interval_ns:
            yield "passes on", f"at most one call per {plan.min_interval_ns / 1e6:g} ms"
        fallback = "nothing" if plan.fallback is None else str(plan.response.to_dict(plan.fallback))
        yield "unanswered", f"the caller gets {fallback}"
    elif isinstance(plan, ActionPlan) and plan.server == "plc":
        also = {"reject": "rejected", "abort": "replaces the first", "buffer": f"waits, at most {plan.queue}"}
        yield "another goal", also[plan.on_new_goal]
        yield "undecided", f"rejected after {format_duration(plan.accept_within_ns)}"
        yield "result", f"kept for {format_duration(plan.keep_result_ns)}"
    elif isinstance(plan, ActionPlan):
        down = {"cancel": "the goal is canceled", "keep": "the goal continues"}
        yield "without a PLC", down[plan.when_plc_down]


def _head(project: Project) -> Iterator[str]:
    settings = project.config.settings
    ros = settings.ros
    yield (
        f"Bridge {settings.bridge}: {_amount(project)}, ROS backend {ros.backend}, "
        f"definitions of {ros.distro}, objects named {settings.prefix}.t.… in {settings.shm.directory}."
    )
    if ros.backend == "auto" and not isinstance(chosen := chosen_backend(project), RosplcError):
        yield f"ROS backend auto selects {chosen}."
    if ros.distro == "noetic":
        yield "ROS master: from ROS_MASTER_URI, else http://localhost:11311."
    else:
        yield "ROS domain: from ROS_DOMAIN_ID, else 0." if ros.domain is None else f"ROS domain {ros.domain}."
    yield f"Access to the objects: {_access_words(access(project))}."


def _amount(project: Project) -> str:
    counts = [(len({plan.called for plan in plans}), plans) for plans in (project.services, project.actions)]
    words = [plural(count, plans[0].kind) for count, plans in counts if count]
    *rest, last = [plural(len(project.topics), "topic"), *words]
    return f"{', '.join(rest)} and {last}" if rest else last


def _access_words(given: dict[str, Any]) -> str:
    mode = int(given["mode"], 8)
    owner = f"user {given['owner']}" if given["owner"] else "the user who starts the bridge"
    group = f"group {given['group']}" if given["group"] else "that user's group"
    verbs = {0: "without access", 2: "write-only", 4: "read-only", 6: "read-write"}
    everybody = "no other user" if not mode & 0o006 else f"other users {verbs[mode & 0o006]}"
    who = f"{owner} and {group}"
    if mode & 0o060 != 0o060:
        who = f"{owner}; {group} {verbs[mode >> 3 & 0o006]}"
    return f"{who}, {everybody} (mode {given['mode']}); the PLC runtime needs read-write access"


def _rows(project: Project, plan: TopicPlan, names: tuple[str, str] | None) -> Iterator[tuple[str, str]]:
    def chosen(configured: bool) -> str:
        return "as configured" if configured else "default"

    # Those of parameters and transforms have every default.
    usual = TopicSettings(type=plan.type_name, to="ros")
    entry, to_plc = project.config.settings.topics.get(plan.topic, usual), plan.direction == 1
    yield "record", f"{plural(plan.layout.size, 'byte')}, layout id {plan.layout.layout_id}"
    if plan.port == "channel":
        parts = memory(project, plan)
        taken = plural(parts["memory_bytes"], "byte")
        yield "slots", f"{plan.slots} ({chosen(entry.slots is not None)}), {taken} of shared memory"
        ends = f"header {parts['header_bytes']} + self-description {parts['description_bytes']}"
        slots = f"{parts['slots']} slots × {parts['slot_bytes']}"
        yield "", f"{ends} + {slots} = {parts['object_bytes']} bytes, in whole pages"
    elif plan.classic is not None:
        yield from _classic_rows(plan, plan.classic)
    if limits := _capacities(plan.layout):
        yield "limits", limits
    how, task = "every message, in order" if plan.every else "the newest message", project.tasks[plan.task]
    cycle = f"every {format_duration(task.interval_ns)}" if task.kind == "cyclic" else "freewheeling"
    yield "delivers", f"{how}; PLC task {plan.task}, {cycle}"
    if names is not None:
        yield "in the PLC", f"{'read' if to_plc else 'written'} with {names[0]} (block {names[1]})"
    if (wanted := plan.transform) is not None:
        yield "transform", f"{wanted.source} in {wanted.target}, every {format_duration(wanted.rate_ns)}"
    else:
        yield from _qos_rows(plan, chosen(bool(entry.qos.model_fields_set) or entry.latched is not None))
    yield "stale after", f"{plan.stale_after_ns / 1e6:g} ms" if plan.stale_after_ns else "never"
    yield "when silent", when_silent(project, plan)
    if to_plc:
        yield "too large", "truncated and counted" if plan.truncate else "refused and counted"
    sieve = ["only changed messages"] if plan.on_change else []
    if plan.min_interval_ns:
        sieve.append(f"at most one message per {plan.min_interval_ns / 1e6:g} ms")
    if sieve:
        yield "passes on", ", ".join(sieve)
    if plan.print:
        yield "print", "each message is logged"


def _qos_rows(plan: TopicPlan, chosen: str) -> Iterator[tuple[str, str]]:
    qos = plan.qos
    times = (("deadline", qos.deadline_ns), ("lease", qos.lease_ns))
    words = [f"{word} {format_duration(ns)}" for word, ns in times if ns]
    yield "QoS", f"{', '.join([qos.reliability, qos.durability, f'depth {qos.depth}', *words])} ({chosen})"
    lost = "are sent again" if qos.reliability == "reliable" else "are not sent again"
    way = f"lost messages {lost}"
    if plan.layout.store.ros_version == 1:
        way = "over TCP: nothing is lost while the connection lasts"
    waiting = f"at most {qos.depth} messages are queued; a full queue drops its oldest message"
    yield "", f"{way}; {'only the newest message is queued' if qos.depth == 1 else waiting}"
    kept = qos.durability == "transient_local"
    if plan.direction != 1:
        yield (
            "",
            f"a late subscriber gets {'the stored messages' if kept else 'no earlier messages'}",
        )
    elif kept:
        yield "", "messages from before the bridge started are received if their publishers stored them"
    else:
        yield "", "messages from before the bridge started are not received"


def _total(project: Project) -> Iterator[str]:
    sizes = {1: 0, 2: 0}
    for plan in project.topics:
        sizes[plan.direction] += memory(project, plan)["memory_bytes"]
    total = total_memory(project)
    parts = [f"ROS → PLC {sizes[1]}", f"PLC → ROS {sizes[2]}"]
    if services := total - sum(sizes.values()):
        parts.append(f"services and actions {services}")
    ways = f" ({', '.join(parts)})" if all(sizes.values()) else ""
    yield f"\nTotal shared memory: {plural(total, 'byte')}{ways}."


def _classic_rows(plan: TopicPlan, classic: ClassicPlan) -> Iterator[tuple[str, str]]:
    yield "classic", f"shared memory {classic.name} with the bare record"
    lock = "none: a record can be read while it is being written"
    if classic.semaphore:
        tried, held = format_duration(classic.wait_ns), format_duration(classic.recover_after_ns)
        freed = f"freed after {held} without a sign of life"
        lock = f"semaphore {classic.semaphore}, wait limit {tried}, {freed}"
    yield "lock", lock
    if plan.direction != 1:
        what = "each changed record is a message" if plan.on_change else "each poll is a message"
        yield "polled", f"every {format_duration(classic.poll_ns)}; {what}"
