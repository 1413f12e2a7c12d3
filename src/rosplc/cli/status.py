"""``rosplc status``: every channel of every bridge on this machine, once, and whether anything is wrong."""

from __future__ import annotations

import json
import time
from collections.abc import Collection, Iterator
from datetime import datetime
from typing import TYPE_CHECKING, Annotated

import typer

from rosplc.cli.guard import EXIT_FAILURE, finite, guarded, print_json
from rosplc.cli.text import columns, plural, say
from rosplc.cli.watching import Configs, Directory, Prefix, StaleAfter, nothing_there, open_watch, settled

if TYPE_CHECKING:
    from rosplc.monitor import ChannelView, Event, Picture, Watch

__all__ = ["EPILOG", "command"]

EPILOG = """Examples:

rosplc status  —  every channel, and what is wrong; in a folder with rosplc.yaml, the channels of its bridge

rosplc status --config cell.yaml  —  the bridge of a configuration, judged by what it allows

rosplc status --json | jq '.channels[] | select(.state != "ok") | .topic'

rosplc status --follow  —  then what happens, line by line, until Ctrl-C

It looks for about a second, and where nobody beats for three of the beats that are promised: three seconds,
as a rule, and longer for a bridge that is starting. It needs no configuration, no ROS and no right to write,
and nobody notices it. The exit status is 0 only if there are channels and nothing is wrong with any of them,
and 1 otherwise: it can guard a script. In JSON, `worst` is null where there are no channels.
"""

_LEAST_SECONDS = 1.0
_MOST_SECONDS = 31.0
"""A beat is never promised for more than ten seconds, and three are waited for."""
_FOLLOW_SECONDS = 0.5
_NAMED = 3


@guarded
def command(
    prefix: Prefix = None,
    config: Configs = None,
    stale_after: StaleAfter = "1s",
    follow: Annotated[
        bool, typer.Option("--follow", "-f", help="Go on and print what happens until Ctrl-C.")
    ] = False,
    directory: Directory = "/dev/shm",
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Print one table of every channel of every bridge on this machine, and what is wrong."""
    with open_watch(prefix, config, stale_after, directory) as watch:
        picture = settled(watch, _LEAST_SECONDS, _MOST_SECONDS)
        if as_json and follow:
            typer.echo(json.dumps(finite(picture.as_json())))
        elif as_json:
            print_json(picture.as_json())
        else:
            _print(picture, watch.prefixes, directory)
        if follow:
            _follow(watch, as_json=as_json)
    if picture.wrong or not picture.channels:
        raise typer.Exit(EXIT_FAILURE)


def _print(picture: Picture, prefixes: Collection[str], directory: str) -> None:
    from rosplc.monitor.picture import plc_text, state_text, way_text

    if not picture.channels:
        say(nothing_there(prefixes, directory))
        return
    for bridge in picture.bridges:
        alive = "alive" if bridge.alive else "dead" if bridge.pid else "ended"
        alive = "starting" if bridge.alive is None else alive
        process = f", process {bridge.pid}" if bridge.pid else ""
        alive += f" ({bridge.process})" if bridge.process else ""
        channels = plural(bridge.channels, "channel")
        say(f"bridge {bridge.name}, prefix {bridge.prefix}{process}: {alive}, {channels}")
    say()
    several = len({view.prefix for view in picture.channels}) > 1
    rows = []
    for view in picture.channels:
        figures = ("-", "-", "-", "-") if not view.direction else _figures(view)
        row = [state_text(view), view.topic, way_text(view), *figures, plc_text(view)]
        rows.append([*row, view.prefix] if several else row)
    header = ["  state", "topic", "way", "per s", "age", "lost", "refused", "PLC"]
    for line in columns(rows, header=[*header, "prefix"] if several else header):
        say(line)
    if picture.wrong:
        say()
    for line in _troubles(picture.wrong, several=several):
        say(line)
    for note in picture.notes:
        say(note)


def _troubles(wrong: tuple[ChannelView, ...], *, several: bool) -> Iterator[str]:
    """Yield what is wrong, a line for all channels with which the same is."""
    groups: dict[str, list[str]] = {}
    for view in wrong:
        code = f" [{view.code}]" if view.code else ""
        name = f"{view.topic} ({view.prefix})" if several else view.topic
        groups.setdefault(f"{view.state.value}: {view.words}{code}", []).append(name)
    for words, names in groups.items():
        more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
        yield f"{', '.join(names[:_NAMED])}{more}: {words}"


def _figures(view: ChannelView) -> tuple[str, str, str, str]:
    from rosplc.monitor.picture import age_text, count_text, rate_text

    lost, refused = count_text(view.lost), count_text(view.refused)
    return rate_text(view.rate_hz), age_text(view.age_ns), lost, refused


def _follow(watch: Watch, *, as_json: bool) -> None:
    from rosplc.monitor.events import grouped

    while True:
        time.sleep(_FOLLOW_SECONDS)
        events = watch.look().events
        for event in events if as_json else grouped(events):
            typer.echo(json.dumps(event.as_json())) if as_json else say(_line(event))


def _line(event: Event) -> str:
    from rosplc.monitor.picture import event_text

    clock = datetime.fromtimestamp(event.time_ns / 1e9).strftime("%H:%M:%S")
    return f"{clock} {event_text(event)}"
