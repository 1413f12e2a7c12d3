"""``rosplc init``: from a robot that is there, or a recording of one, to a configuration."""

from __future__ import annotations

import logging
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from rosplc.cli.guard import guarded, print_json
from rosplc.cli.text import plural, say, table, warn

if TYPE_CHECKING:
    from rosplc.init import Chosen, Draft, Source, Wish

__all__ = ["EPILOG", "command"]

EPILOG = """Examples:

rosplc init  —  look at the robot, ask what to carry, write rosplc.yaml

rosplc init --all --listen 10s  —  ask nothing, take everything, measure for ten seconds

rosplc init --to-plc /cmd_vel --to-ros /joint_states=sensor_msgs/JointState  —  these two topics

rosplc init --topics '/robot1/*' --output cell1.yaml  —  whatever robot1 has

rosplc init --bag line3.bag --all  —  from a recording of ROS 1 or ROS 2

It subscribes to the chosen topics while it listens, and publishes nothing. Limits are proposed from what
was seen, with half as much again; the file says what was seen and by which rule. Definitions that the
distribution does not have are taken from `--types`, from an installed ROS (`AMENT_PREFIX_PATH`,
`ROS_PACKAGE_PATH`), from a ROS 1 publisher or from the recording, and saved in `msg` beside the file.
"""


@guarded
def command(
    topics: Annotated[
        list[str] | None,
        typer.Option(
            metavar="TOPIC",
            help="Carry this topic, or those that a pattern such as `/robot1/*` matches, in the "
            "direction that is proposed; `TOPIC=TYPE` names the type, too. May be repeated, or hold several "
            "with commas.",
        ),
    ] = None,
    to_plc: Annotated[
        list[str] | None, typer.Option("--to-plc", metavar="TOPIC", help="As --topics, towards the PLC.")
    ] = None,
    to_ros: Annotated[
        list[str] | None, typer.Option("--to-ros", metavar="TOPIC", help="As --topics, from the PLC to ROS.")
    ] = None,
    everything: Annotated[
        bool, typer.Option("--all", help="Carry every topic but those of ROS itself, such as /rosout.")
    ] = False,
    yes: Annotated[
        bool, typer.Option("--yes", "-y", help="Ask nothing; without a choice of topics take all of them.")
    ] = False,
    listen: Annotated[
        str, typer.Option(metavar="TIME", help="How long to listen for sizes and rates; `0s`: not at all.")
    ] = "5s",
    look: Annotated[
        str,
        typer.Option(metavar="TIME", help="How long to look for the robot at most; less once all is seen."),
    ] = "5s",
    bag: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", help="Look at a recording (.bag, .mcap, .db3, a folder) in place of a robot."
        ),
    ] = None,
    output: Annotated[
        Path, typer.Option("--output", "-o", metavar="FILE", help="The configuration that is written.")
    ] = Path("rosplc.yaml"),
    force: Annotated[bool, typer.Option("--force", help="Replace a configuration that is there.")] = False,
    bridge: Annotated[str, typer.Option(metavar="NAME", help="The bridge's name.")] = "cell1",
    backend: Annotated[
        str, typer.Option(metavar="NAME", help="The way into ROS, as `ros.backend`.")
    ] = "auto",
    distro: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="The ROS distribution; `noetic` is ROS 1. Without it ROS_DISTRO, ROS_MASTER_URI or the "
            "recording tell, else it is jazzy.",
        ),
    ] = None,
    domain: Annotated[
        int | None, typer.Option(metavar="NUMBER", help="The ROS domain; without it ROS_DOMAIN_ID, else 0.")
    ] = None,
    connect: Annotated[
        list[str] | None,
        typer.Option(
            metavar="LOCATOR", help="A Zenoh router, such as `tcp/192.168.1.10:7447`; may be repeated."
        ),
    ] = None,
    types: Annotated[
        list[Path] | None,
        typer.Option(metavar="FOLDER", help="A folder with custom .msg files; may be repeated."),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON; nothing is asked.")] = False,
) -> None:
    """Look at a robot or a recording, and write a commented configuration."""
    from rosplc.cli.init_ask import ask_topics, on_terminal
    from rosplc.config import Config
    from rosplc.init import draft, refuse_to_overwrite, save, select

    # What the backends warn of is part of the outcome, or of the error that ends this.
    logging.getLogger("rosplc").addHandler(logging.NullHandler())
    wishes = _wishes(topics, to_plc, to_ros)
    look_s, listen_s = _seconds(look, "--look"), _seconds(listen, "--listen")
    refuse_to_overwrite(output, force=force)
    ros = _ros(backend, distro, domain, connect)
    Config.from_dict({"bridge": bridge, "ros": ros})  # what is wrong in it is said before anything else
    source: Source | None = None
    try:
        if not as_json:
            warn("Reading the recording …" if bag else "Looking for the robot …")
        needed = [wish.pattern for wish in wishes if wish.exact and wish.type_name is None]
        source = _recorded(bag, ros, types or []) if bag else _live(ros, types or [], look_s, needed)
        chosen, left_out = _select(select, source, wishes, everything=everything or (yes and not wishes))
        if not chosen and not wishes and not everything and not yes:
            if as_json or not on_terminal():
                if not as_json:
                    _list(source)
                what = "say what to carry: --topics, --to-plc, --to-ros, or --all"
                raise typer.BadParameter(what, param_hint="--topics")
            _list(source)
            chosen, left_out = _select(select, source, ask_topics(source.found.topics), everything=False)
        made = draft(source, chosen, seconds=listen_s, progress=_progress(quiet=as_json))
        if not made.entries:
            reasons = "; ".join(f"{name}: {why}" for name, why in {**left_out, **made.left_out}.items())
            raise typer.BadParameter(
                f"nothing is left to carry{f' ({reasons})' if reasons else ''}", param_hint="--topics"
            )
        text, files = save(source, made, output, bridge=bridge, folders=types or [], force=force)
    except (KeyboardInterrupt, typer.Abort):
        if not as_json:
            warn("\nInterrupted: no configuration was written.")
        raise KeyboardInterrupt from None
    finally:
        if source is not None:
            source.close()
    left_out = {**left_out, **made.left_out}
    if as_json:
        print_json(_facts(source, made, left_out, output, files, text))
    else:
        _tell(source, made, left_out, output, files)


def _wishes(*given: list[str] | None) -> list[Wish]:
    from rosplc.init import parse_wish

    wishes = []
    for option, to, texts in zip(
        ("--topics", "--to-plc", "--to-ros"), (None, "plc", "ros"), given, strict=True
    ):
        for text in (part for many in texts or () for part in many.split(",") if part.strip()):
            try:
                wishes.append(parse_wish(text, to))  # type: ignore[arg-type]
            except ValueError as error:
                raise typer.BadParameter(str(error), param_hint=option) from None
    return wishes


def _select(
    select: Any, source: Source, wishes: list[Wish], *, everything: bool
) -> tuple[dict[str, Chosen], dict[str, str]]:
    try:
        chosen, left_out = select(source.found.topics, wishes, everything=everything)
    except ValueError as error:
        raise typer.BadParameter(str(error), param_hint="--topics") from None
    return chosen, left_out


def _seconds(text: str, option: str) -> float:
    from rosplc.config.quantities import parse_duration

    if text.strip() in ("0", "0s"):
        return 0.0
    try:
        return parse_duration(text.strip()) / 1e9
    except ValueError as error:
        raise typer.BadParameter(str(error), param_hint=option) from None


def _ros(
    backend: str, distro: str | None, domain: int | None, connect: list[str] | None
) -> dict[str, object]:
    """Return the keys of the section ``ros`` that were given."""
    given: dict[str, object] = {"backend": backend}
    if distro is not None:
        given["distro"] = distro
    if domain is not None:
        given["domain"] = domain
    if connect:
        given["zenoh"] = {"connect": connect}
    return given


def _live(ros: dict[str, object], types: list[Path], seconds: float, needed: list[str]) -> Source:
    from rosplc.init import LiveRobot

    return LiveRobot(ros, types, seconds, needed)


def _recorded(bag: Path, ros: dict[str, object], types: list[Path]) -> Source:
    from rosplc.init import RecordedRobot

    distro = ros.get("distro")
    return RecordedRobot(bag, None if distro is None else str(distro), types, ros)


def _progress(*, quiet: bool) -> Callable[[str], None]:
    """Return what shows how far it is: a line that changes on a terminal, else one line."""
    said = False

    def show(words: str) -> None:
        nonlocal said
        if quiet:
            return
        if sys.stderr.isatty():
            sys.stderr.write(f"\r\x1b[K{words} … ")
            sys.stderr.flush()
        elif not said:
            warn(f"{words} …")
        said = True

    return show


def _list(source: Source) -> None:
    from rosplc.cli.init_ask import rows

    found = source.found
    say(f"{len(found.topics)} topics in {found.where}:\n")
    table(rows(found.topics), header=("", "topic", "type", "published by", "subscribed by", "proposal"))
    say()


def _tell(
    source: Source, made: Draft, left_out: dict[str, str], output: Path, files: tuple[Path, ...]
) -> None:
    if sys.stderr.isatty():
        sys.stderr.write("\r\x1b[K")
    found = []
    for entry in made.entries:
        seen = made.seen.get(entry.topic)
        rate = "not listened to" if seen is None else plural(seen.messages, "message")
        if seen is not None and seen.rate_hz:
            rate += f", {seen.rate_hz:.3g} Hz"
        arrow = "ROS → PLC" if entry.to == "plc" else "PLC → ROS"
        found.append((entry.topic, arrow, entry.type_name, plural(entry.record_bytes, "byte"), rate))
    table(found, header=("topic", "direction", "type", "record", "seen"))
    say()
    for name, why in left_out.items():
        say(f"Left out: {name}: {why}")
    for note in source.found.notes:
        say(f"Note: {note}")
    for name, origin in made.origins.items():
        say(f"Saved: {name}, from {origin}")
    count = f" and {plural(len(files), 'definition')} in {output.parent / 'msg'}"
    say(f"Written: {output}{count if files else ''}")
    say("\nNext:")
    steps = [
        (f"rosplc check {output}", "what it means, and how much memory it takes"),
        (f"rosplc run {output}", "carry the topics"),
        (f"rosplc generate {output}", "the PLC's half, for CODESYS"),
    ]
    table(steps, indent=2)


def _facts(
    source: Source, made: Draft, left_out: dict[str, str], output: Path, files: tuple[Path, ...], text: str
) -> dict[str, Any]:
    from dataclasses import asdict

    return {
        "from": source.found.where,
        "ros": dict(source.found.ros),
        "found": {
            name: {
                "types": list(topic.types),
                "publishers": list(topic.publishers),
                "subscribers": list(topic.subscribers),
            }
            for name, topic in source.found.topics.items()
        },
        "topics": {
            entry.topic: {
                "type": entry.type_name,
                "to": entry.to,
                "about": list(entry.about),
                "limits": {limit.path: limit.capacity for limit in entry.limits},
                "settings": {setting.key: setting.value for setting in entry.settings},
                "record_bytes": entry.record_bytes,
                "seen": asdict(made.seen[entry.topic]) if entry.topic in made.seen else None,
            }
            for entry in made.entries
        },
        "left_out": left_out,
        "notes": list(source.found.notes),
        "definitions": {name: made.origins[name] for name in made.definitions},
        "written": [str(output), *map(str, files)],
        "configuration": text,
    }
