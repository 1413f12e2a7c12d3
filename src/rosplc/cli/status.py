"""``rosplc status``: every channel of every bridge on this machine, once, and whether anything is wrong.

rosplc status  —  every channel, and any problems; in a folder with rosplc.yaml, the channels of its bridge

rosplc status --config cell.yaml  —  the bridge of a configuration, checked against its settings

rosplc status --json | jq '.channels[] | select(.state != "ok") | .topic'

rosplc status --follow  —  also print events, one per line, until Ctrl-C

The command watches for about a second; if a heartbeat is missing, for three heartbeat periods (usually three
seconds), and longer if a bridge is starting. It requires only read access (no configuration, no ROS) and
affects no other program. The exit status is 0 if there are channels and none has a problem, and 1 otherwise.
In JSON, `worst` is null if there are no channels.
"""

from __future__ import annotations

import time
from collections.abc import Collection
from datetime import datetime

import typer

from rosplc.cli.options import Configs, Directory, Prefix, StaleAfter, nothing_there, open_watch, settled
from rosplc.cli.text import print_json, say, table
from rosplc.cli.verb import EXIT_FAILURE, verb
from rosplc.harmless import listed, plural
from rosplc.monitor import Picture, Watch
from rosplc.monitor.picture import (
    ASKS,
    age_text,
    count_text,
    event_text,
    grouped,
    plc_text,
    rate_text,
    state_text,
    way_text,
)

_LEAST_SECONDS = 1.0
_MOST_SECONDS = 31.0  # a beat is never promised for more than ten seconds, and three are waited for
_FOLLOW_SECONDS = 0.5


@verb
def command(
    *,
    prefix: Prefix = None,
    config: Configs = None,
    stale_after: StaleAfter = "1s",
    follow: bool = False,
    directory: Directory = "/dev/shm",
    as_json: bool = False,
) -> None:
    """Print a table of all channels on this machine, and any problems.

    Options:
        follow: Keep running and print events until Ctrl-C.
        as_json: Print JSON.
    """
    with open_watch(prefix, config, stale_after, directory) as watch:
        picture = settled(watch, _LEAST_SECONDS, _MOST_SECONDS)
        if as_json:
            print_json(picture.as_json(), one_line=follow)
        else:
            _print(picture, watch.prefixes, directory)
        if follow:
            _follow(watch, as_json=as_json)
    if picture.wrong or not picture.channels:
        raise typer.Exit(EXIT_FAILURE)


def _print(picture: Picture, prefixes: Collection[str], directory: str) -> None:
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
    several = len({view.prefix for view in picture.channels}) > 1
    rows = []
    for view in picture.channels:
        if view.kind != "topic":
            continue
        figures = [rate_text(view.rate_hz), age_text(view.age_ns)]
        figures += [count_text(view.lost), count_text(view.refused)]
        figures = figures if view.direction else ["-"] * 4
        rows.append([state_text(view), view.topic, way_text(view), *figures, plc_text(view), view.prefix])
    _table(rows, ["  state", "topic", "way", "per s", "age", "lost", "refused", "PLC", "prefix"], several)
    _print_calls(picture, several)
    if picture.wrong:
        say()
    groups: dict[str, list[str]] = {}  # one line for all channels with which the same is wrong
    for view in picture.wrong:
        code = f" [{view.code}]" if view.code else ""
        name = f"{view.label} ({view.prefix})" if several else view.label
        groups.setdefault(f"{view.state.value}: {view.words}{code}", []).append(name)
    for words, names in groups.items():
        say(f"{listed(names, 3)}: {words}")
    for note in picture.notes:
        say(note)


def _print_calls(picture: Picture, several: bool) -> None:
    rows = []
    for view in picture.channels:
        if view.part not in ASKS:
            continue
        same = (view.prefix, view.kind, view.topic, view.client)
        parts = [
            each for each in picture.channels if (each.prefix, each.kind, each.topic, each.client) == same
        ]
        worst = max(parts, key=lambda each: each.state.severity)
        way = newest = "-"
        calls, ended = 0, ""
        if (call := view.call) is not None:
            way = "ROS calls PLC" if call.server == "plc" else "PLC calls ROS"
            calls = call.number
            newest = f"{'open, ' if call.open else ''}{call.status}" if calls else "none"
            ended = ", ".join(f"{count} {words}" for words, count in call.ended.items())
        name = f"{view.topic} {view.client}".rstrip()
        row = [state_text(worst), view.kind, name, way, count_text(calls), newest, ended or "-"]
        rows.append([*row, plc_text(view), view.prefix])
    header = ["  state", "kind", "name", "way", "calls", "newest call", "recently ended", "PLC", "prefix"]
    _table(rows, header, several)


def _table(rows: list[list[str]], header: list[str], several: bool) -> None:
    if rows:
        say()
    table((row if several else row[:-1] for row in rows), header=header if several else header[:-1])


def _follow(watch: Watch, *, as_json: bool) -> None:
    while True:
        time.sleep(_FOLLOW_SECONDS)
        events = watch.look().events
        for event in events if as_json else grouped(events):
            if as_json:
                print_json(event.as_json(), one_line=True)
            else:
                clock = datetime.fromtimestamp(event.time_ns / 1e9).strftime("%H:%M:%S")
                say(f"{clock} {event_text(event)}")
