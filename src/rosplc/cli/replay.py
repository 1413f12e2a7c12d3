"""``rosplc replay``: a recording's messages again, into channels or onto ROS topics."""

from __future__ import annotations

from datetime import datetime
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from rosplc.cli.guard import EXIT_FAILURE, guarded, print_json
from rosplc.cli.progress import ProgressLine
from rosplc.cli.record import duration
from rosplc.cli.text import columns, plural, say, warn
from rosplc.cli.watching import Directory

if TYPE_CHECKING:
    from rosplc.recorder.replay import Player, ReplayOptions, Target
    from rosplc.recorder.source import Source, SourceTopic

__all__ = ["EPILOG", "command"]

EPILOG = """Examples:

rosplc replay shift.mcap --list  —  what is in it

rosplc replay shift.mcap --to plc  —  into channels, to test a PLC program with yesterday's line

rosplc replay shift.mcap --to plc --speed 0.5 --loop --start 30s --end 40s  —  ten seconds of it, slowly,
again and again until Ctrl-C

rosplc replay robot.bag --to ros --topic /odom --rename /odom:=/test/odom  —  onto a ROS topic

It plays MCAP files and folders of ROS 2, and ROS 1 bags, also those that were cut off. Towards the PLC it
takes the bridge's place, so that no bridge may carry these topics meanwhile. Messages are stamped with the
time at which they are sent; `--stamps original` keeps the recorded stamps.
"""

_BACKENDS = ("auto", "dds", "rclpy", "zenoh", "rospy")


@guarded
def command(
    file: Annotated[Path, typer.Argument(help="An .mcap or .bag file, or the folder of a ROS 2 recording.")],
    to: Annotated[
        str | None, typer.Option(metavar="plc|ros", help="Into channels, or onto ROS topics.")
    ] = None,
    listing: Annotated[
        bool, typer.Option("--list", help="Say what is in the file, and play nothing.")
    ] = False,
    topic: Annotated[
        list[str] | None,
        typer.Option("--topic", "-t", metavar="TOPIC", help="Only these topics or patterns, several times."),
    ] = None,
    exclude: Annotated[
        list[str] | None,
        typer.Option("--exclude", "-x", metavar="TOPIC", help="Topics or patterns to leave out."),
    ] = None,
    rename: Annotated[
        list[str] | None,
        typer.Option("--rename", metavar="OLD:=NEW", help="Play a topic under another name."),
    ] = None,
    speed: Annotated[
        str, typer.Option(metavar="FACTOR", help="0.5 for half as fast, 2 for twice, or `max`.")
    ] = "1",
    loop: Annotated[bool, typer.Option("--loop", help="Begin again at the end, until Ctrl-C.")] = False,
    start: Annotated[
        str | None, typer.Option(metavar="TIME", help="Leave out so much at the beginning, such as 30s.")
    ] = None,
    end: Annotated[
        str | None, typer.Option(metavar="TIME", help="End so long after the recording's beginning.")
    ] = None,
    stamps: Annotated[
        str, typer.Option(metavar="now|original", help="What messages are stamped with.")
    ] = "now",
    wait: Annotated[
        str,
        typer.Option(
            metavar="TIME", help="Wait so long for a reader of each topic, then begin all the same."
        ),
    ] = "2s",
    prefix: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="With --to plc: the channels' prefix; by default rosplc."),
    ] = None,
    config: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", help="With --to plc: a configuration that says prefix, limits and depth."
        ),
    ] = None,
    backend: Annotated[
        str, typer.Option(metavar="NAME", help=f"With --to ros: {', '.join(_BACKENDS)}.")
    ] = "auto",
    distro: Annotated[
        str | None,
        typer.Option(
            metavar="NAME", help="The ROS distribution; by default the recording's, else ROS_DISTRO."
        ),
    ] = None,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Print no progress.")] = False,
    directory: Directory = "/dev/shm",
    as_json: Annotated[bool, typer.Option("--json", help="Print the result as JSON.")] = False,
) -> None:
    """Replay a recording into channels or onto ROS topics, in its order and at its pace."""
    from rosplc.recorder.inlet import Selection
    from rosplc.recorder.replay import chosen_topics
    from rosplc.recorder.source import open_source

    if not listing and to not in ("plc", "ros"):
        raise typer.BadParameter("say where to: plc or ros", param_hint="--to")
    options = _options(speed, loop, start, end, stamps)
    renames = _renames(rename or [])
    patience = duration(wait, "--wait") / 1e9 if wait != "0" else 0.0
    source = open_source(file, _distro(distro, None))
    try:
        if listing:
            _list(file, source, as_json=as_json)
            return
        selection = Selection(tuple(topic or ()), tuple(exclude or ()))
        topics, remarks = chosen_topics(source, selection, renames, to_plc=to == "plc")
        if not quiet:
            for text in (*source.notes, *remarks):
                warn(text)
        chosen = "noetic" if distro is None and backend == "rospy" else _distro(distro, topics)
        if to == "plc":
            target = _plc_target(topics, prefix, config, directory, chosen)
        else:
            target = _ros_target(topics, backend, chosen)
        if not quiet:
            for text in target.notes:
                warn(text)
        _play(file, source, target, topics, options, patience, quiet=quiet, as_json=as_json)
    finally:
        source.close()


def _options(speed: str, loop: bool, start: str | None, end: str | None, stamps: str) -> ReplayOptions:
    from rosplc.recorder.replay import ReplayOptions

    if stamps not in ("now", "original"):
        raise typer.BadParameter(f"{stamps!r} is neither now nor original", param_hint="--stamps")
    try:
        factor = 0.0 if speed == "max" else float(speed)
    except ValueError:
        factor = -1.0
    if speed != "max" and not 1e-3 <= factor <= 1e6:
        raise typer.BadParameter(f"{speed!r} is neither a factor from 0.001 up nor max", param_hint="--speed")
    begin, finish = duration(start, "--start"), duration(end, "--end")
    if finish and finish <= begin:
        raise typer.BadParameter("it lies before --start", param_hint="--end")
    return ReplayOptions(factor, loop, begin, finish, "now" if stamps == "now" else "original")


def _renames(texts: list[str]) -> dict[str, str]:
    renames = {}
    for text in texts:
        old, colon, new = text.partition(":=")
        if not colon or not old.startswith("/") or not new.startswith("/"):
            raise typer.BadParameter(f"{text!r} is not of the form /old:=/new", param_hint="--rename")
        renames[old] = new
    return renames


def _distro(given: str | None, topics: dict[str, SourceTopic] | None) -> str:
    """Return the distribution: the one asked for, the recording's if it is one, the environment's, jazzy."""
    import os

    from rosplc.model import DISTROS

    if given is not None:
        if given not in DISTROS:
            raise typer.BadParameter(f"{given!r} is none of {', '.join(DISTROS)}", param_hint="--distro")
        return given
    # A ROS 1 bag is most often wanted in ROS 2: what it goes to decides.
    recorded = {one.distro for one in (topics or {}).values() if one.distro in DISTROS and not one.ros1}
    if len(recorded) == 1:
        return recorded.pop()
    environment = os.environ.get("ROS_DISTRO", "")
    return environment if environment in DISTROS else "jazzy"


def _plc_target(
    topics: dict[str, SourceTopic], prefix: str | None, config: Path | None, directory: str, distro: str
) -> Target:
    from rosplc.config.resolve import load_project
    from rosplc.recorder.replay import PlcTarget
    from rosplc.shm import Namespace

    project = None if config is None else load_project(config)
    namespace = Namespace(prefix or "rosplc", directory)
    if project is not None and prefix is None:
        namespace = project.namespace
    return PlcTarget(topics, namespace, project=project, distro=distro)


def _ros_target(topics: dict[str, SourceTopic], backend: str, distro: str) -> Target:
    from rosplc.recorder.replay import RosTarget

    if backend not in _BACKENDS:
        raise typer.BadParameter(f"{backend!r} is none of {', '.join(_BACKENDS)}", param_hint="--backend")
    return RosTarget(topics, backend=backend, distro=distro)


def _play(
    file: Path,
    source: Source,
    target: Target,
    topics: dict[str, SourceTopic],
    options: ReplayOptions,
    patience: float,
    *,
    quiet: bool,
    as_json: bool,
) -> None:
    from rosplc.bridge.run import pause, stop_on_signals
    from rosplc.recorder.replay import Player, wait_for_readers

    player = Player(source, target, topics, options)
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
                warn(f"nobody takes {', '.join(missing)} yet; it begins all the same")
            if not quiet:
                pace = (
                    f"{options.speed:g} times as fast as recorded" if options.speed else "as fast as it goes"
                )
                kind = "the present time" if options.stamps == "now" else "their recorded time"
                warn(f"playing {file}, {pace}; messages are stamped with {kind}")
            try:
                player.play(partial(pause, stop), lambda: line.show(progress))
                pause(stop, target.linger_s)
            finally:
                line.clear()
    finally:
        target.close()
    _report(player, target, as_json=as_json)


def _report(player: Player, target: Target, *, as_json: bool) -> None:
    counts = target.counts
    sent = sum(count.sent for count in counts.values())
    if as_json:
        print_json(
            {
                "sent": sent,
                "rounds": player.rounds,
                "latest_ns": player.latest_ns,
                "out_of_order": player.disordered,
                "stamps": player.options.stamps,
                "topics": {
                    name: {"sent": one.sent, "refused": one.refused, "lost": one.lost, "reason": one.reason}
                    for name, one in counts.items()
                },
            }
        )
    else:
        say(
            f"{plural(sent, 'message')} of {plural(len(counts), 'topic')} sent"
            + (f" in {plural(player.rounds, 'round')}" if player.options.loop else "")
        )
        rows = [(name, one.sent, one.refused, one.lost) for name, one in counts.items()]
        for text in columns(rows, header=("topic", "sent", "refused", "lost"), indent=2):
            say(text)
        for name, one in counts.items():
            if one.reason:
                warn(f"{name}: {one.reason}")
        if player.options.speed:
            say(f"the latest message was {player.latest_ns / 1e6:.1f} ms late")
        if player.disordered:
            warn(f"{plural(player.disordered, 'message')} out of order in the file; sent at once")
    if any(one.refused or one.lost for one in counts.values()) or not sent:
        raise typer.Exit(EXIT_FAILURE)


def _when(time_ns: int) -> str:
    try:
        return datetime.fromtimestamp(time_ns / 1e9).astimezone().isoformat(" ", "seconds")
    except (OverflowError, ValueError, OSError):
        return f"{time_ns} ns"  # no time of any calendar


def _list(file: Path, source: Source, *, as_json: bool) -> None:
    seconds = max(0, source.end_ns - source.start_ns) / 1e9 if source.topics else 0.0
    if as_json:
        topics = {
            name: {
                "type": one.type_name,
                "messages": one.count,
                "direction": one.direction,
                "distro": one.distro,
            }
            for name, one in sorted(source.topics.items())
        }
        print_json(
            {
                "start_ns": source.start_ns,
                "end_ns": source.end_ns,
                "topics": topics,
                "unusable": source.unusable,
                "notes": list(source.notes),
            }
        )
        return
    if source.end_ns:
        say(f"{file}: {seconds:.1f} s from {_when(source.start_ns)}")
    else:
        say(f"{file}: no messages")
    ways = {"to_plc": "→ PLC", "to_ros": "→ ROS", "": ""}
    rows = [
        (name, one.type_name, one.count, ways[one.direction]) for name, one in sorted(source.topics.items())
    ]
    for text in columns(rows, header=("topic", "type", "messages", "way"), indent=2):
        say(text)
    for name, why in sorted(source.unusable.items()):
        warn(f"{name} cannot be replayed: {why}")
    for text in source.notes:
        warn(text)
