"""``rosplc replay``: a recording's messages again, into channels or onto ROS topics.

rosplc replay shift.mcap --list  —  list the contents of the file

rosplc replay shift.mcap --to plc  —  into channels, to test a PLC program with recorded data

rosplc replay shift.mcap --to plc --speed 0.5 --loop --start 30s --end 40s  —  ten seconds of the file, at
half speed, repeated until Ctrl-C

rosplc replay robot.bag --to ros --topic /odom --rename /odom:=/test/odom  —  onto a ROS topic

rosplc replay shift.mcap --to plc --config cell1.yaml --service /cell/start  —  also send a service's requests

The command plays ROS 2 MCAP files and folders, and ROS 1 bags, even if they are truncated. With --to plc,
it replaces the bridge, so no bridge may carry these topics at the same time. By default, messages are
stamped with the time of sending; `--stamps original` keeps the recorded stamps.
"""

from __future__ import annotations

import os
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Literal

import typer

from rosplc.bridge.run import pause, stop_on_signals
from rosplc.cli.options import Directory, duration, observed_config
from rosplc.cli.text import ProgressLine, print_json, say, table, warn
from rosplc.cli.verb import EXIT_FAILURE, verb
from rosplc.config.resolve import load_project
from rosplc.harmless import plural
from rosplc.model import DISTROS
from rosplc.recorder.inlet import Selection
from rosplc.recorder.replay import (
    Player,
    PlcTarget,
    ReplayOptions,
    RosTarget,
    Target,
    chosen_topics,
    wait_for_answers,
    wait_for_readers,
)
from rosplc.recorder.source import Source, SourceTopic, open_source
from rosplc.ros import BACKENDS
from rosplc.shm import Namespace

_WAYS = {"to_plc": "→ PLC", "to_ros": "→ ROS", "": ""}


@verb
def command(
    file: Path,
    /,
    *,
    to: Literal["plc", "ros"] | None = None,
    listing: bool = False,
    topic: list[str] | None = None,
    exclude: list[str] | None = None,
    service: list[str] | None = None,
    action: list[str] | None = None,
    rename: list[str] | None = None,
    speed: str = "1",
    loop: bool = False,
    start: str | None = None,
    end: str | None = None,
    stamps: Literal["now", "original"] = "now",
    wait: str = "2s",
    prefix: str | None = None,
    config: Path | None = None,
    backend: str = "auto",
    distro: str | None = None,
    quiet: bool = False,
    directory: Directory = "/dev/shm",
    as_json: bool = False,
) -> None:
    """Replay a recording into channels or onto ROS topics, with the recorded order and timing.

    Options:
        file: An .mcap or .bag file, or the folder of a ROS 2 recording.
        to plc|ros: Send messages to channels, or to ROS topics.
        listing: List the contents of the file, and play nothing.
        topic TOPIC: Play only this topic or pattern; may be repeated.
        exclude TOPIC: Leave out this topic or pattern; may be repeated.
        service SERVICE: Also send the recorded requests of this service; may be repeated.
        action ACTION: Also send the recorded goals of this action; may be repeated.
        rename OLD:=NEW: Play a topic under another name.
        speed FACTOR: The speed: 0.5 for half speed, 2 for double speed, or `max`.
        loop: Repeat until Ctrl-C.
        start TIME: Skip this much at the beginning, such as 30s.
        end TIME: Stop this long after the beginning of the recording.
        stamps now|original: Stamp messages with the current time, or with their recorded time.
        wait TIME: How long to wait for a reader of each topic before starting anyway.
        prefix NAME: With --to plc: the channels' prefix, instead of the configuration's.
        config FILE: With --to plc: the configuration for prefix, limits and slots; without --prefix,
            by default `./rosplc.yaml`.
        backend NAME: With --to ros: the ROS backend, as in `ros.backend`.
        distro NAME: The ROS distribution; by default the recording's, else ROS_DISTRO.
        quiet: Print no progress.
        as_json: Print the result as JSON.
    """
    if not listing and to is None:
        raise typer.BadParameter("choose --to plc or --to ros", param_hint="--to")
    options = _options(speed, loop, start, end, stamps)
    renames = _renames(rename or [])
    patience = duration(wait, "--wait") / 1e9 if wait != "0" else 0.0
    source = open_source(file, _distro(distro, None))
    try:
        if listing:
            _list(file, source, as_json=as_json)
            return
        selection = Selection(tuple(topic or ()), tuple(exclude or ()))
        topics, remarks = chosen_topics(
            source, selection, renames, to_plc=to == "plc", services=service or (), actions=action or ()
        )
        if not quiet:
            for text in (*source.notes, *remarks):
                warn(text)
        chosen = "noetic" if distro is None and backend == "rospy" else _distro(distro, topics)
        target = _target(to, topics, prefix, config, backend, chosen, directory)
        if not quiet:
            for text in target.notes:
                warn(text)
        _play(file, Player(source, target, topics, options), patience, quiet=quiet, as_json=as_json)
    finally:
        source.close()


def _options(
    speed: str, loop: bool, start: str | None, end: str | None, stamps: Literal["now", "original"]
) -> ReplayOptions:
    try:
        factor = 0.0 if speed == "max" else float(speed)
    except ValueError:
        factor = -1.0
    if speed != "max" and not 1e-3 <= factor <= 1e6:
        raise typer.BadParameter("must be max or a number from 0.001 to 1e6", param_hint="--speed")
    begin, finish = duration(start, "--start"), duration(end, "--end")
    if finish and finish <= begin:
        raise typer.BadParameter("must be after --start", param_hint="--end")
    return ReplayOptions(factor, loop, begin, finish, stamps)


def _renames(texts: list[str]) -> dict[str, str]:
    renames = {}
    for text in texts:
        old, colon, new = text.partition(":=")
        if not colon or not old.startswith("/") or not new.startswith("/"):
            raise typer.BadParameter(f"{text!r} does not have the form /old:=/new", param_hint="--rename")
        renames[old] = new
    return renames


def _distro(given: str | None, topics: dict[str, SourceTopic] | None) -> str:
    """Return the distribution: the one asked for, the recording's if it is one, the environment's, jazzy."""
    if given is not None:
        if given not in DISTROS:
            raise typer.BadParameter(f"{given!r} is not one of {', '.join(DISTROS)}", param_hint="--distro")
        return given
    # A ROS 1 bag is most often wanted in ROS 2: what it goes to decides.
    recorded = {one.distro for one in (topics or {}).values() if one.distro in DISTROS and not one.ros1}
    if len(recorded) == 1:
        return recorded.pop()
    environment = os.environ.get("ROS_DISTRO", "")
    return environment if environment in DISTROS else "jazzy"


def _target(
    to: str | None,
    topics: dict[str, SourceTopic],
    prefix: str | None,
    config: Path | None,
    backend: str,
    distro: str,
    directory: str,
) -> Target:
    if to == "ros":
        known = ("auto", *(name for name in BACKENDS if name != "memory"))
        if backend not in known:
            raise typer.BadParameter(f"{backend!r} is not one of {', '.join(known)}", param_hint="--backend")
        return RosTarget(topics, backend=backend, distro=distro)
    file = observed_config(config, prefix)
    project = None if file is None else load_project(file)
    own = Namespace(prefix or "rosplc", directory)
    if project is not None and prefix is None:
        own = project.namespace
    return PlcTarget(topics, own, project=project, distro=distro)


def _play(file: Path, player: Player, patience: float, *, quiet: bool, as_json: bool) -> None:
    source, target, options = player.source, player.target, player.options
    line = ProgressLine(quiet=quiet)
    length = (source.end_ns - source.start_ns) / 1e9

    def progress() -> str:
        sent = sum(count.sent for count in target.counts.values())
        again = f", round {player.rounds}" if options.loop else ""
        return f"{player.position_ns / 1e9:.1f} of {length:.1f} s: {plural(sent, 'message')} sent{again}"

    try:
        with stop_on_signals(lambda _: None) as stop:
            missing = wait_for_readers(target, patience, partial(pause, stop))
            if missing and patience and not quiet:
                warn(f"no reader was found for {', '.join(missing)}; starting anyway")
            if not quiet:
                pace = "as fast as possible"
                if options.speed:
                    pace = f"at {options.speed:g}× the recorded speed"
                kind = "the current time" if options.stamps == "now" else "their recorded time"
                warn(f"playing {file}, {pace}; messages are stamped with {kind}")
            try:
                player.play(partial(pause, stop), lambda: line.show(progress))
                wait_for_answers(target, partial(pause, stop))
                pause(stop, target.linger_s)
            finally:
                line.clear()
    finally:
        target.close()
    _report(player, as_json=as_json)


def _report(player: Player, *, as_json: bool) -> None:
    counts = player.target.counts
    sent = sum(count.sent for count in counts.values())
    if as_json:
        keys = ("sent", "refused", "lost", "reason")
        print_json(
            {
                "sent": sent,
                "rounds": player.rounds,
                "latest_ns": player.latest_ns,
                "out_of_order": player.disordered,
                "stamps": player.options.stamps,
                "topics": {name: {key: getattr(one, key) for key in keys} for name, one in counts.items()},
            }
        )
    else:
        rounds = f" in {plural(player.rounds, 'round')}" if player.options.loop else ""
        say(f"{plural(sent, 'message')} of {plural(len(counts), 'topic')} sent{rounds}")
        rows = [(name, one.sent, one.refused, one.lost) for name, one in counts.items()]
        table(rows, header=("topic", "sent", "refused", "lost"), indent=2)
        for name, one in counts.items():
            if one.reason:
                warn(f"{name}: {one.reason}")
        if player.options.speed:
            say(f"the longest delay was {player.latest_ns / 1e6:.1f} ms")
        if player.disordered:
            warn(f"sent immediately, because out of order: {plural(player.disordered, 'message')}")
    if any(one.refused or one.lost for one in counts.values()) or not sent:
        raise typer.Exit(EXIT_FAILURE)


def _list(file: Path, source: Source, *, as_json: bool) -> None:
    topics = sorted(source.topics.items())
    if as_json:
        keys = {"type": "type_name", "messages": "count", "direction": "direction", "distro": "distro"}
        print_json(
            {
                "start_ns": source.start_ns,
                "end_ns": source.end_ns,
                "topics": {
                    name: {key: getattr(one, field) for key, field in keys.items()} for name, one in topics
                },
                "unusable": source.unusable,
                "notes": list(source.notes),
            }
        )
        return
    if source.end_ns:
        seconds = max(0, source.end_ns - source.start_ns) / 1e9 if topics else 0.0
        try:
            when = datetime.fromtimestamp(source.start_ns / 1e9).astimezone().isoformat(" ", "seconds")
        except (OverflowError, ValueError, OSError):
            when = f"{source.start_ns} ns"  # no time of any calendar
        say(f"{file}: {seconds:.1f} s from {when}")
    else:
        say(f"{file}: no messages")
    rows = [(name, one.type_name, one.count, _WAYS[one.direction]) for name, one in topics]
    table(rows, header=("topic", "type", "messages", "way"), indent=2)
    for name, why in sorted(source.unusable.items()):
        warn(f"{name} cannot be replayed: {why}")
    for text in source.notes:
        warn(text)
