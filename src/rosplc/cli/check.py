"""``rosplc check``: what a configuration means, in plain words, before anything runs."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from rosplc.cli.guard import guarded, print_json
from rosplc.cli.options import AsJson, ConfigFile, config_file
from rosplc.cli.text import columns, plural, say, terminal_width, warn, wrap
from rosplc.errors import RosplcError

if TYPE_CHECKING:
    from rosplc.config.plans import ClassicPlan
    from rosplc.config.resolve import Project, TopicPlan

__all__ = ["EPILOG", "command"]

EPILOG = """Examples:

rosplc check  —  explain rosplc.yaml, or report with line and key what is wrong in it

rosplc check rosplc.yaml --verbose  —  every detail of every topic

rosplc check rosplc.yaml --json  —  the same for programs

rosplc check --fix  —  rewrite keys that have new names since the file was written

rosplc check --schema > rosplc.schema.json  —  for an editor that completes keys
"""

_SCREEN = 24
"""Lines that are printed without --verbose."""
_WARNINGS = 6


@guarded
def command(
    config: ConfigFile = None,
    verbose: Annotated[
        bool,
        typer.Option("--verbose", "-v", help="Explain each topic: memory, QoS, what happens when silent."),
    ] = False,
    schema: Annotated[
        bool, typer.Option("--schema", help="Print the JSON Schema of configuration files.")
    ] = False,
    fix: Annotated[
        bool,
        typer.Option("--fix", help="Rewrite keys that have new names; comments and layout stay."),
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Explain a configuration: what is carried, in which direction, how, and who may open it."""
    if schema:
        from rosplc.config.file import json_schema

        print_json(json_schema())
        return
    from rosplc.config.resolve import load_project
    from rosplc.project import check

    path = config_file(config)
    if fix:
        _fix(path)
    project = load_project(path)
    if as_json:
        print_json(check(project))
    else:
        _explain(project, verbose=verbose)


def _fix(path: Path) -> None:
    """Give keys their present names, in place."""
    from rosplc.config.file import rename_keys
    from rosplc.config.yaml_source import read_text

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
    from rosplc.project import warnings

    head = [f"{project.config.path or 'The configuration'} is valid.", *_head(project)]
    total = list(_total(project))
    found = [f"Warning: {text}" for text in warnings(project)]
    unusable = project.store.problems()
    if unusable:
        what = plural(len(unusable), "custom type")
        more = "" if verbose else " (rosplc check -v)"
        total.append(f"{what} in types.paths cannot be used; the topics do not need them{more}.")
    if verbose:
        # A type that needs another has the other's mistake.
        listed = dict.fromkeys(f"  {error.where}: {error.what} [{error.code}]" for error in unusable)
        for line in (*head, *_details(project), *total, *listed, *found):
            say(line)
        return
    if len(found) > _WARNINGS:
        found[_WARNINGS - 1 :] = [f"{plural(len(found) - _WARNINGS + 1, 'more warning')}: rosplc check -v"]
    body = [*_table(project), *_limits(project)]
    width = terminal_width()
    around = sum(wrap(line, width).count("\n") + 1 for line in (*head, *total, *found))
    room = max(3, _SCREEN - around - 1)
    if len(body) > room:
        body[room - 1 :] = ["… (rosplc check -v prints every topic)"]
    for line in (*head, *body, *total, *found):
        say(line)


def _table(project: Project) -> Iterator[str]:
    """Yield a line for each topic."""
    from rosplc.config.quantities import format_duration
    from rosplc.project import plc_names

    found = plc_names(project)
    names = {} if isinstance(found, RosplcError) else found
    rows = []
    for plan in project.topics:
        stale = format_duration(plan.stale_after_ns) if plan.stale_after_ns else "never"
        instance = names[plan.topic][0] if plan.topic in names else "-"
        rows.append((plan.topic, _arrow(plan), plan.type_name, plan.layout.size, stale, instance))
    if rows:
        yield ""
    yield from columns(rows, header=("topic", "direction", "type", "bytes", "stale after", "in the PLC"))


def _limits(project: Project) -> Iterator[str]:
    """Yield the effective capacity of each string and sequence."""
    from rosplc.project import capacities

    rows = [(plan.topic, _listed(capacities(plan.layout))) for plan in project.topics]
    rows = [row for row in rows if row[1]]
    if rows:
        yield "\nLimits (strings in bytes, sequences in elements):"
    yield from columns(rows, indent=2)


def _listed(capacities: dict[str, int]) -> str:
    return ", ".join(f"{path} {capacity}" for path, capacity in capacities.items())


def _arrow(plan: TopicPlan) -> str:
    return "ROS → PLC" if plan.direction == 1 else "PLC → ROS"


def _details(project: Project) -> Iterator[str]:
    """Yield everything about each topic."""
    from rosplc.project import plc_names

    found = plc_names(project)
    names = {} if isinstance(found, RosplcError) else found
    for plan in project.topics:
        yield f"\n{plan.topic}  {_arrow(plan)}  {plan.type_name}"
        yield from columns(_rows(project, plan, names.get(plan.topic)), indent=2)


def _head(project: Project) -> Iterator[str]:
    from rosplc.project import chosen_backend

    settings = project.config.settings
    topics = project.topics
    yield (
        f"Bridge {settings.bridge}: {plural(len(topics), 'topic')}, "
        f"ROS backend {settings.ros.backend}, definitions of {settings.ros.distro}, "
        f"objects named {settings.prefix}.t.… in {settings.shm.directory}."
    )
    if settings.ros.backend == "auto" and not isinstance(chosen := chosen_backend(project), RosplcError):
        yield f"ROS backend auto is {chosen}."
    domain = settings.ros.domain
    if settings.ros.distro == "noetic":
        yield "ROS master: ROS_MASTER_URI's, else http://localhost:11311."
    else:
        yield f"ROS domain {domain}." if domain is not None else "ROS domain: ROS_DOMAIN_ID's, else 0."
    yield f"Who may open the objects: {_access_words(project)}."


def _access_words(project: Project) -> str:
    from rosplc.project import access

    given = access(project)
    mode = int(given["mode"], 8)
    owner = f"user {given['owner']}" if given["owner"] else "the user who starts the bridge"
    group = f"group {given['group']}" if given["group"] else "that user's group"
    verbs = {0: "not at all", 2: "writing", 4: "reading only", 6: "reading and writing"}
    everybody = "nobody else" if not mode & 0o006 else f"everybody else {verbs[mode & 0o006]}"
    words = f"{owner} and {group}, {everybody} (mode {given['mode']})"
    if mode & 0o060 != 0o060:
        words = f"{owner}; {group} {verbs[mode >> 3 & 0o006]}, {everybody} (mode {given['mode']})"
    return f"{words}; the PLC's runtime must be one of them"


def _rows(project: Project, plan: TopicPlan, names: tuple[str, str] | None) -> list[tuple[str, str]]:
    from rosplc.project import capacities, memory, when_silent

    entry = project.config.settings.topics[plan.topic]
    how = "every message, in order" if plan.every else "the newest message"
    qos = "as configured" if entry.qos.model_fields_set or entry.latched is not None else "default"
    slots = "as configured" if entry.slots is not None else "default"
    stale = f"{plan.stale_after_ns / 1e6:g} ms" if plan.stale_after_ns else "never"
    rows = [("record", f"{plural(plan.layout.size, 'byte')}, layout id {plan.layout.layout_id}")]
    if plan.port == "channel":
        taken = plural(memory(project, plan)["memory_bytes"], "byte")
        rows.append(("slots", f"{plan.slots} ({slots}), {taken} of shared memory"))
        rows.append(("", _memory_words(project, plan)))
    elif plan.classic is not None:
        rows += _classic_rows(plan, plan.classic)
    if limits := _listed(capacities(plan.layout)):
        rows.append(("limits", limits))
    rows.append(("takes", f"{how}; PLC task {plan.task}{_cycle_words(project, plan)}"))
    if names is not None:
        verb = "read" if plan.direction == 1 else "written"
        rows.append(("in the PLC", f"{verb} with {names[0]} (block {names[1]})"))
    rows.append(("QoS", f"{_qos_words(plan)} ({qos})"))
    rows += [("", words) for words in _qos_meaning(plan)]
    rows += [("stale after", stale), ("when silent", when_silent(project, plan))]
    if plan.direction == 1:
        rows.append(("too large", "cut and counted" if plan.truncate else "refused and counted"))
    if sieve := _sieve(plan):
        rows.append(("passes on", sieve))
    if plan.print:
        rows.append(("print", "each message is logged"))
    return rows


def _memory_words(project: Project, plan: TopicPlan) -> str:
    from rosplc.project import memory

    parts = memory(project, plan)
    return (
        f"header {parts['header_bytes']} + self-description {parts['description_bytes']} + "
        f"{parts['slots']} slots × {parts['slot_bytes']} = {parts['object_bytes']} bytes, in whole pages"
    )


def _cycle_words(project: Project, plan: TopicPlan) -> str:
    from rosplc.config.quantities import format_duration

    task = project.tasks[plan.task]
    return f", every {format_duration(task.interval_ns)}" if task.kind == "cyclic" else ", freewheeling"


def _qos_meaning(plan: TopicPlan) -> Iterator[str]:
    """Yield what the quality of service means for the messages, without its own words."""
    qos, to_plc = plan.qos, plan.direction == 1
    if plan.layout.store.ros_version == 1:
        yield f"over TCP: nothing is lost on the way while the connection stands; {_waiting(qos.depth)}"
    elif qos.reliability == "reliable":
        yield f"what is lost on the way is sent again; {_waiting(qos.depth)}"
    else:
        yield f"what is lost on the way stays lost; {_waiting(qos.depth)}"
    kept = qos.durability == "transient_local"
    if to_plc:
        yield (
            "what publishers kept from before the start of the bridge comes, too"
            if kept
            else "what was published before the start of the bridge does not come"
        )
    else:
        yield f"who subscribes later gets {'the messages that were kept' if kept else 'nothing from before'}"


def _waiting(depth: int) -> str:
    return (
        "one message waits, the newest"
        if depth == 1
        else f"at most {depth} messages wait, the oldest give way"
    )


def _total(project: Project) -> Iterator[str]:
    from rosplc.project import memory

    sizes = {1: 0, 2: 0}
    for plan in project.topics:
        sizes[plan.direction] += memory(project, plan)["memory_bytes"]
    total = sum(sizes.values())
    ways = f" ({sizes[1]} towards the PLC, {sizes[2]} towards ROS)" if all(sizes.values()) else ""
    yield f"\nShared memory in total: {plural(total, 'byte')}{ways}."


def _classic_rows(plan: TopicPlan, classic: ClassicPlan) -> list[tuple[str, str]]:
    from rosplc.config.quantities import format_duration

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


def _sieve(plan: TopicPlan) -> str:
    words = ["only what changed"] if plan.on_change else []
    if plan.min_interval_ns:
        words.append(f"one message per {plan.min_interval_ns / 1e6:g} ms at most")
    return ", ".join(words)


def _qos_words(plan: TopicPlan) -> str:
    from rosplc.config.quantities import format_duration

    qos = plan.qos
    words = [qos.reliability, qos.durability, f"depth {qos.depth}"]
    times = (("deadline", qos.deadline_ns), ("lease", qos.lease_ns))
    return ", ".join([*words, *(f"{word} {format_duration(ns)}" for word, ns in times if ns)])
