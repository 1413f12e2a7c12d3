"""``rosplc show``: the newest message of a channel, a classic topic, a service or an action, decoded.

rosplc show  —  every channel on this machine

rosplc show /cmd_vel  —  the newest message of a topic

rosplc show /cmd_vel --follow  —  every message from now on

rosplc show /gripper/close --header  —  the last request and response of a service or action

rosplc show /joint_states --count 10 --json  —  ten messages, one JSON document per line

rosplc show --config cell.yaml  —  also this file's classic topics, which do not describe themselves

Channels need no configuration. The command needs only read access (no ROS) and affects no other program.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Any

import typer

from rosplc.api import Channel, attach
from rosplc.cli.options import Directory, nothing_there, observed_config, settled
from rosplc.cli.text import print_json, say, table, warn
from rosplc.cli.verb import EXIT_FAILURE, Between, verb
from rosplc.config.resolve import TopicPlan, load_project
from rosplc.errors import ChannelError
from rosplc.harmless import in_bytes
from rosplc.layout import RecordView
from rosplc.layout.view import plain
from rosplc.monitor import ChannelView, Message, ObjectState, Picture, Watch, find_objects
from rosplc.monitor.classic import ClassicState, look_at
from rosplc.monitor.message import marks_of
from rosplc.monitor.picture import age_text, plc_text

_LEAST_S, _MOST_S = 0.1, 1.2
_WAYS = {"to_plc": "→ PLC", "to_ros": "→ ROS"}


@verb
def command(
    topic: str | None = None,
    /,
    *,
    prefix: str | None = None,
    follow: bool = False,
    count: Annotated[int | None, Between(1)] = None,
    header: bool = False,
    timeout: Annotated[float | None, Between(0.0)] = None,
    config: Path | None = None,
    as_json: bool = False,
    directory: Directory = "/dev/shm",
) -> None:
    """Show the message in a topic's shared memory, or list all channels on this machine.

    Options:
        topic: The ROS name of the topic, service or action, such as /cmd_vel; by default all channels.
        prefix NAME: The bridge's `prefix:`; by default the configuration's, else `rosplc`; without a
            topic, every prefix.
        follow: Print messages until Ctrl-C.
        count N: Print this many new messages, then exit.
        header: Also print the object's counters.
        timeout SECONDS: Give up if no message arrives within this time.
        config FILE: The configuration for prefix and classic topics; without --prefix,
            by default `./rosplc.yaml`.
        as_json: Print JSON.
    """
    classic, own = [], prefix
    if (file := observed_config(config, prefix)) is not None:
        project = load_project(file)
        classic = [plan for plan in project.topics if plan.classic is not None]
        own = prefix or project.namespace.prefix
    if topic is None:
        states = find_objects(directory, prefix=prefix, calls=True)
        if as_json:
            print_json(
                [state.to_dict() for state in states] + [_facts(plan, look_at(plan)) for plan in classic]
            )
        else:
            if states or not classic:
                _list(states, prefix, directory)
            _list_classic(classic)
        if states and all(state.error for state in states) and not classic:
            raise typer.Exit(EXIT_FAILURE)
        return
    if plan := next((plan for plan in classic if plan.topic == topic), None):
        _show_classic(plan, follow=follow, count=count, timeout=timeout, as_json=as_json)
        return
    try:
        channel = attach(topic, prefix=own or "rosplc", directory=directory)
    except ChannelError as error:
        own, most = own or "rosplc", count if follow or count is not None else 0
        if error.code != "SHM101" or not _show_calls(topic, own, directory, most, timeout, header, as_json):
            raise _with_hint(error, topic, own, directory) from None
        return
    with channel:
        live = follow or count is not None
        view = _view(topic, own or "rosplc", directory) if header or not live else None
        if header and not as_json:
            _print_header(channel, view)
        if live:
            _follow(channel, count, timeout, header=header, as_json=as_json)
        else:
            _print_message(channel, channel.current(), view, header=header, as_json=as_json)


def _facts(plan: TopicPlan, state: ClassicState) -> dict[str, Any]:
    return {
        "topic": plan.topic,
        "type": plan.type_name,
        "direction": "to_plc" if plan.direction == 1 else "to_ros",
        "memory": state.name,
        "semaphore": state.semaphore,
        "record_bytes": plan.layout.size,
        "memory_bytes": state.size,
        "owner": state.owner,
        "lock": state.lock,
        "error": state.error,
        "code": state.code,
        "message": None if state.record is None else plan.layout.to_dict(state.record),
    }


def _list_classic(plans: list[TopicPlan]) -> None:
    rows, errors = [], []
    for plan in plans:
        state = look_at(plan)
        arrow = _WAYS["to_plc" if plan.direction == 1 else "to_ros"]
        sizes = f"{plan.layout.size} of {state.size}" if state.size else f"{plan.layout.size}"
        rows.append((plan.topic, arrow, plan.type_name, sizes, state.name, state.owner or "-", state.lock))
        if state.error:
            errors.append(f"{plan.topic}: {state.name}: {state.error} [{state.code}]")
    if rows:
        say()
    table(rows, header=("classic topic", "way", "type", "bytes", "memory", "owner", "lock"))
    for text in errors:
        warn(text)


def _show_classic(
    plan: TopicPlan, *, follow: bool, count: int | None, timeout: float | None, as_json: bool
) -> None:
    """Print the message in a classic topic's memory; with ``follow`` or ``count`` each change seen."""
    first = look_at(plan)
    if not follow and count is None:
        _print_classic(plan, first, as_json=as_json, one_line=False)
        return
    last = first.record

    def news() -> int:
        nonlocal last
        state = look_at(plan)
        if state.record is None or state.record == last:
            return 0
        last = state.record
        _print_classic(plan, state, as_json=as_json, one_line=True)
        return 1

    _poll(news, count, timeout, "changes")


def _poll(news: Callable[[], int], count: int | None, timeout: float | None, what: str) -> None:
    """Look until so many were printed, or none was for so long; ``news`` prints and returns how many."""
    printed, since = 0, time.monotonic()
    while count is None or printed < count:
        if new := news():
            printed, since = printed + new, time.monotonic()
        elif timeout is not None and time.monotonic() - since > timeout:
            break
        time.sleep(0.005)
    _require(printed, count, what)


def _require(printed: int, count: int | None, what: str) -> None:
    if count is not None and printed < count:
        warn(f"rosplc: only {printed} of {count} {what} arrived before the timeout")
        raise typer.Exit(EXIT_FAILURE)


def _print_classic(plan: TopicPlan, state: ClassicState, *, as_json: bool, one_line: bool) -> None:
    document = _facts(plan, state)
    if as_json:
        print_json(document, one_line=one_line)
        return
    if state.record is None:
        raise ChannelError(state.code, state.error, where=f"/dev/shm/{state.name}")
    say(f"{plan.topic}  {plan.type_name}  classic memory {state.name}, lock: {state.lock}")
    _print_fields(document["message"])


def _print_fields(message: Any) -> None:
    for line in lines_of(message):
        say("  " + line)


def _view(topic: str, prefix: str, directory: str) -> ChannelView | None:
    """Return how a channel is, after a look or two; None if it is gone."""
    with Watch(prefix, directory=directory, topic=topic) as watch:
        return next(iter(settled(watch, _LEAST_S, _MOST_S).channels), None)


def _with_hint(error: ChannelError, topic: str, prefix: str | None, directory: str) -> ChannelError:
    """Return the error, naming prefixes under which the topic exists, or a plain memory of its name."""
    if error.code != "SHM101":
        return error
    others = sorted(
        {
            state.prefix
            for state in find_objects(directory, seconds=0.0, calls=True)
            if state.topic == topic and not state.error
        }
    )
    if not others:
        name = topic[1:].replace("/", ".")
        if not name or "/" in name or not (Path("/dev/shm") / name).is_file():
            return error
        what = f"{topic} has no channel, but /dev/shm/{name} exists and may belong to a classic topic"
        remedy = "A classic topic does not describe itself: specify its configuration with --config FILE."
        return ChannelError(error.code, what, where=error.where, remedy=remedy)
    what = f"there is no channel {topic} with the prefix {prefix or 'rosplc'}"
    remedy = f"This channel exists with the prefix {', '.join(others)}: add --prefix {others[0]}."
    return ChannelError(error.code, what, where=error.where, remedy=remedy)


def _list(states: list[ObjectState], prefix: str | None, directory: str) -> None:
    if not states:
        say(nothing_there([prefix] if prefix else [], directory))
        return
    for calls in (False, True):
        rows = []
        for state in states:
            if state.error or (state.kind != "topic") is not calls:
                continue
            who = "alive" if state.writer_alive else "silent", ", ".join(state.readers) or "none"
            name = (state.topic, f"{state.part} {state.client}".rstrip()) if calls else (state.topic,)
            way = _WAYS.get(state.direction, "→ ROS")
            rows.append((state.prefix, *name, way, state.type_name, state.record_size, state.head, *who))
        names = ("service, action", "part") if calls else ("topic",)
        if rows:
            table(rows, header=("prefix", *names, "way", "type", "bytes", "newest", "writer", "read by"))
    for state in states:
        if state.error:
            warn(f"{state.path}: {state.error} [{state.code}]")


def _show_calls(
    name: str,
    prefix: str,
    directory: str,
    most: int | None,
    timeout: float | None,
    header: bool,
    as_json: bool,
) -> bool:
    """Print what the objects of a service or action hold; return False if there are none.

    Then print at ``most`` so many new messages; None: until Ctrl-C.
    """
    seen: dict[str, int] = {}

    def read(picture: Picture) -> list[tuple[ChannelView, Message | None]]:
        found = []
        for view in picture.channels:
            message = None
            with suppress(ChannelError):  # its state tells why
                message = watch.message(view)
            found.append((view, message))
        new = [each for each in found if each[1] is not None and seen.get(each[0].id) != each[1].sequence]
        seen.update({view.id: message.sequence for view, message in new if message is not None})
        return new if most != 0 else found

    def news() -> int:
        new = read(watch.look())
        for each in new:
            if as_json:
                print_json(_call_facts(*each, header=header), one_line=True)
            else:
                _print_call(*each, header=header)
        return len(new)

    with Watch(prefix, directory=directory, topic=name, calls=True) as watch:
        picture = settled(watch, _LEAST_S, _MOST_S)
        found = read(picture)
        if found and as_json and most == 0:
            print_json([_call_facts(*each, header=header) for each in found])
        elif most == 0:
            for each in found:
                _print_call(*each, header=header)
        elif picture.channels:
            _poll(news, most, timeout, "messages")
    return bool(picture.channels)


def _call_facts(view: ChannelView, message: Message | None, *, header: bool) -> dict[str, Any]:
    """Return an object of a service or action as plain data; the same keys as a topic's where they fit."""
    document = {
        "topic": view.topic,
        **{name: getattr(view, name) for name in ("kind", "part", "client")},
        "type": view.type_name,
        "sequence": message.sequence if message else 0,
        "stamp_ns": message.stamp_ns if message else 0,
        "call": view.call and dataclasses.asdict(view.call),
        "message": message and message.values,
        "state": view.state.value,
        "age_ns": view.age_ns,
    }
    return document | ({"object": view.as_json()} if header else {})


def _print_call(view: ChannelView, message: Message | None, *, header: bool) -> None:
    marks = f"message {message.sequence} ({', '.join(message.marks)})" if message else "no message yet"
    old = "" if view.age_ns is None else f", {age_text(view.age_ns)} old"
    say(f"{view.label}  {view.type_name}  {marks}  {view.state.value}{old}: {view.words}")
    if header and view.call is not None:
        ended = ", ".join(f"{count} {words}" for words, count in view.call.ended.items())
        rows: list[tuple[str, object]] = [
            ("way", _WAYS[view.direction]),
            ("carried out in", "the PLC" if view.call.server == "plc" else "ROS"),
            ("correlation", view.call.correlation or "none"),
            ("ended", ended or "none"),
            ("layout id", view.layout_id),
            ("bridge", view.bridge),
            ("PLC", plc_text(view)),
            ("messages", f"{view.received}, {view.refused} refused, {view.truncated} truncated"),
        ]
        table(rows, indent=2)
    if message is not None:
        _print_fields(message.values)


def _follow(
    channel: Channel, count: int | None, timeout: float | None, *, header: bool, as_json: bool
) -> None:
    printed = 0
    for message in channel.every(timeout, poll=0.002):
        _print_message(channel, message, header=header, as_json=as_json, one_line=True)
        printed += 1
        if count is not None and printed >= count:
            return
    _require(printed, count, "messages")


def _print_header(channel: Channel, view: ChannelView | None) -> None:
    description, writer = channel.description, channel.snapshot().writer
    who = f"process {writer.pid}" if writer.pid else "a PLC program"
    dead = ", dead" if view is not None and view.writer_alive is False else ""
    rows: list[tuple[str, object]] = [
        ("topic", f"{channel.topic}, {'ROS → PLC' if channel.direction == 1 else 'PLC → ROS'}"),
        ("type", f"{description.type} ({description.distro}), {in_bytes(channel.layout.size)}"),
        ("layout id", channel.layout.layout_id),
        ("bridge", description.bridge),
        ("newest", f"message {writer.head}, {writer.refused} refused, {writer.truncated} truncated"),
        ("writer", who + dead if writer.epoch else "none"),
    ]
    for line in view.readers if view is not None else ():
        who = f"{line.task or 'process'} {line.pid}: taken {line.taken}, lost {line.lost}"
        rows.append((f"reader {line.index}", who + (", dead" if line.alive is False else "")))
    table(rows)
    say()


def _print_message(
    channel: Channel,
    message: RecordView | None,
    view: ChannelView | None = None,
    *,
    header: bool,
    as_json: bool,
    one_line: bool = False,
) -> None:
    info = channel.info if message is not None else None
    if as_json:
        counters = {name: getattr(info, name, 0) for name in ("sequence", "stamp_ns", "flags", "lost")}
        document: dict[str, Any] = {"topic": channel.topic, "type": channel.type_name, **counters}
        document["message"] = None if message is None else plain(message)
        if view is not None:
            document |= {"state": view.state.value, "age_ns": view.age_ns}
        if header:
            snapshot = channel.snapshot()
            document["writer"] = dataclasses.asdict(snapshot.writer)
            document["readers"] = [dataclasses.asdict(line) for line in snapshot.readers if line.claim]
        print_json(document, one_line=one_line)
        return
    if message is None or info is None:
        say(f"{channel.topic}: no message yet" + (f"; {view.state.value}: {view.words}" if view else ""))
        return
    marks = [*marks_of(info.flags), *([f"{info.lost} lost before it"] if info.lost else [])]
    remarks = f"  ({', '.join(marks)})" if marks else ""
    age = "" if view is None or view.age_ns is None else f", {age_text(view.age_ns)} old"
    state = "" if view is None else f"  {view.state.value}{age}"
    say(f"{channel.topic}  {channel.type_name}  message {info.sequence}{remarks}{state}")
    _print_fields(plain(message))


def lines_of(value: Any) -> list[str]:
    """Return nested dicts and lists as indented lines, as ``ros2 topic echo`` does."""
    lines: list[str] = []
    items: list[tuple[str, Any]]
    if isinstance(value, dict):
        items = [(f"{key}:", item) for key, item in value.items()]
    else:
        items = [("-", item) for item in value]
    for label, item in items:
        if isinstance(item, dict) or (isinstance(item, list) and item and isinstance(item[0], dict)):
            inner = lines_of(item)
            if label == "-":
                lines += [f"- {inner[0]}" if inner else "- {}", *(f"  {line}" for line in inner[1:])]
            else:
                lines += [label, *(f"  {line}" for line in inner)]
        else:
            lines.append(f"{label} {_text(item)}")
    return lines


def _text(value: Any) -> str:
    if isinstance(value, list):
        return "[" + ", ".join(_text(item) for item in value) + "]"
    if isinstance(value, bool):
        return "true" if value else "false"
    return repr(value) if isinstance(value, str) else str(value)
