"""``rosplc init``: from a robot that is there, or a recording of one, to a configuration.

rosplc init  —  examine the robot, ask what to carry, write rosplc.yaml

rosplc init --all --listen 10s  —  do not ask; carry all topics, measure for ten seconds

rosplc init --to-plc /cmd_vel --to-ros /joint_states=sensor_msgs/JointState  —  carry these two topics

rosplc init --topics '/robot1/*' --output cell1.yaml  —  all topics of robot1

rosplc init --all --services  —  also propose services and actions, as comments in the file

rosplc init --bag line3.bag --all  —  from a recording of ROS 1 or ROS 2

While listening, the command subscribes to the chosen topics; it publishes nothing. The proposed limits
are one and a half times the observed sizes; comments in the file show the sizes. Definitions that are not
in the distribution are taken from `--types`, from a ROS installation (`AMENT_PREFIX_PATH`,
`ROS_PACKAGE_PATH`), from a node that uses the topic or from the recording, and saved in a folder `msg`
next to the file.
"""

from __future__ import annotations

import logging
import sys
from collections.abc import Callable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any, Literal

import typer

from rosplc.cli.options import duration, parsed
from rosplc.cli.text import ProgressLine, print_json, say, table, warn
from rosplc.cli.verb import verb
from rosplc.config import Config
from rosplc.harmless import plural
from rosplc.init.found import Topic
from rosplc.init.live import LiveRobot
from rosplc.init.propose import Wish, direction, is_of_ros_itself, parse_wish, select, type_called
from rosplc.init.recorded import RecordedRobot
from rosplc.init.write import Draft, Source, draft, refuse_to_overwrite, save

_LONGEST = 40


@verb
def command(
    *,
    topics: list[str] | None = None,
    to_plc: list[str] | None = None,
    to_ros: list[str] | None = None,
    everything: bool = False,
    services: bool = False,
    yes: bool = False,
    listen: str = "5s",
    look: str = "5s",
    bag: Path | None = None,
    output: Path = Path("rosplc.yaml"),
    force: bool = False,
    bridge: str = "cell1",
    backend: str = "auto",
    distro: str | None = None,
    domain: int | None = None,
    connect: list[str] | None = None,
    types: list[Path] | None = None,
    as_json: bool = False,
) -> None:
    """Examine a robot or a recording, and write a commented configuration.

    Options:
        topics TOPIC: Carry this topic, or those that match a pattern such as `/robot1/*`, in the
            proposed direction; `TOPIC=TYPE` also sets the type. May be repeated; also accepts a
            comma-separated list.
        to_plc TOPIC: Like --topics, but from ROS to the PLC.
        to_ros TOPIC: Like --topics, but from the PLC to ROS.
        everything: Carry every topic except those of ROS itself, such as /rosout.
        services: Also propose the services and actions of the graph, as comments in the file.
        yes: Do not ask; if no topics are chosen, carry all of them.
        listen TIME: How long to measure sizes and rates of messages; `0s` skips this.
        look TIME: Maximum time to look for the robot; the search ends as soon as everything is found.
        bag FILE: Examine a recording (.bag, .mcap, .db3 or a folder) instead of a robot.
        output FILE: The configuration to write.
        force: Replace an existing configuration.
        bridge NAME: The bridge's name.
        backend NAME: The ROS backend, as in `ros.backend`.
        distro NAME: The ROS distribution; `noetic` is ROS 1. By default from ROS_DISTRO,
            ROS_MASTER_URI or the recording, else jazzy.
        domain NUMBER: The ROS domain; by default ROS_DOMAIN_ID, else 0.
        connect LOCATOR: A Zenoh router, such as `tcp/192.168.1.10:7447`; may be repeated.
        types FOLDER: A folder with custom .msg files; may be repeated.
        as_json: Print JSON and do not ask.
    """
    # What the backends warn of is part of the outcome, or of the error that ends this.
    logging.getLogger("rosplc").addHandler(logging.NullHandler())
    folders, wishes = types or [], _wishes(topics, to_plc, to_ros)
    look_s, listen_s = _seconds(look, "--look"), _seconds(listen, "--listen")
    refuse_to_overwrite(output, force=force)
    keys = {"distro": distro, "domain": domain, "zenoh": {"connect": connect} if connect else None}
    ros: dict[str, Any] = {"backend": backend}
    ros |= {key: value for key, value in keys.items() if value is not None}
    Config.from_dict({"bridge": bridge, "ros": ros})  # what is wrong in it is said before anything else
    source: Source | None = None
    try:
        if not as_json:
            warn("Reading the recording …" if bag else "Looking for the robot …")
        needed = [wish.pattern for wish in wishes if wish.exact and wish.type_name is None]
        if bag:
            source = RecordedRobot(bag, distro, folders, ros)
        else:
            source = LiveRobot(ros, folders, look_s, needed)
        found = source.found.topics
        ask = not (wishes or everything or yes)
        if ask:
            if not as_json:
                _list(source)
            if as_json or not (sys.stdin.isatty() and sys.stdout.isatty()):
                what = "choose the topics with --topics, --to-plc, --to-ros or --all"
                raise typer.BadParameter(what, param_hint="--topics")
            wishes = _ask_topics(found)
        everything = everything or (yes and not wishes)
        chosen, left_out = parsed(lambda _: select(found, wishes, everything=everything), "", "--topics")
        if listen_s and not (as_json or bag):
            warn(f"Listening for {listen} …")
        line = ProgressLine(quiet=as_json)
        made = draft(source, chosen, seconds=listen_s, progress=lambda words: line.show(lambda: words))
        line.clear()
        if not made.entries:
            reasons = "; ".join(f"{name}: {why}" for name, why in {**left_out, **made.left_out}.items())
            what = f"there is no topic to carry{f' ({reasons})' if reasons else ''}"
            raise typer.BadParameter(what, param_hint="--topics")
        text, files = save(source, made, output, bridge=bridge, folders=folders, force=force, calls=services)
    except (KeyboardInterrupt, typer.Abort):
        if not as_json:
            warn("\nInterrupted: no configuration was written.")
        raise KeyboardInterrupt from None
    finally:
        if source is not None:
            source.close()
    left_out = {**left_out, **made.left_out}
    if as_json:
        found_calls = {"calls": [asdict(call) for call in source.found.calls]} if services else {}
        print_json(_facts(source, made, left_out, output, files, text) | found_calls)
    else:
        _tell(source, made, left_out, output, files)


def _wishes(*given: list[str] | None) -> list[Wish]:
    options: tuple[tuple[str, Literal["plc", "ros"] | None], ...]
    options = (("--topics", None), ("--to-plc", "plc"), ("--to-ros", "ros"))
    return [
        parsed(lambda text, to=to: parse_wish(text, to), part, option)  # type: ignore[misc]
        for (option, to), texts in zip(options, given, strict=True)
        for many in texts or ()
        for part in many.split(",")
        if part.strip()
    ]


def _seconds(text: str, option: str) -> float:
    return 0.0 if text.strip() in ("0", "0s") else duration(text.strip(), option) / 1e9


def _list(source: Source) -> None:
    def short(names: tuple[str, ...]) -> str:
        text = ", ".join(names) or "-"
        return text if len(text) <= _LONGEST else f"{text[: _LONGEST - 1]}…"

    found = source.found
    say(f"{plural(len(found.topics), 'topic')} in {found.where}:\n")
    rows = [
        (
            number,
            name,
            ", ".join(topic.types) or "unknown",
            short(topic.publishers),
            short(topic.subscribers),
            "of ROS itself" if is_of_ros_itself(name) else f"to {direction(topic)[0]}",
        )
        for number, (name, topic) in enumerate(found.topics.items(), 1)
    ]
    table(rows, header=("", "topic", "type", "published by", "subscribed by", "proposal"))
    say()


def _tell(
    source: Source, made: Draft, left_out: dict[str, str], output: Path, files: tuple[Path, ...]
) -> None:
    found = []
    for entry in made.entries:
        seen = made.seen.get(entry.topic)
        rate = "not measured" if seen is None else plural(seen.messages, "message")
        if seen is not None and seen.rate_hz:
            rate += f", {seen.rate_hz:.3g} Hz"
        arrow = "ROS → PLC" if entry.to == "plc" else "PLC → ROS"
        found.append((entry.topic, arrow, entry.type_name, plural(entry.record_bytes, "byte"), rate))
    table(found, header=("topic", "direction", "type", "record", "seen"))
    say()
    for name, why in left_out.items():
        say(f"Left out {name}: {why}")
    for note in source.found.notes:
        say(f"Note: {note}")
    for name, origin in made.origins.items():
        say(f"Saved: {name}, from {origin}")
    count = f" and {plural(len(files), 'definition')} in {output.parent / 'msg'}"
    say(f"Written: {output}{count if files else ''}")
    say("\nNext:")
    steps = [
        (f"rosplc check {output}", "explain the file, and show how much memory the bridge needs"),
        (f"rosplc run {output}", "run the bridge"),
        (f"rosplc generate {output}", "write the PLC code for CODESYS"),
    ]
    table(steps, indent=2)


def _facts(
    source: Source, made: Draft, left_out: dict[str, str], output: Path, files: tuple[Path, ...], text: str
) -> dict[str, Any]:
    found = source.found
    return {
        "from": found.where,
        "ros": dict(found.ros),
        "found": {
            name: {key: list(getattr(topic, key)) for key in ("types", "publishers", "subscribers")}
            for name, topic in found.topics.items()
        },
        "topics": {
            entry.topic: {
                "type": entry.type_name,
                "to": entry.to,
                "about": entry.about,
                "limits": {path: capacity for path, (capacity, _) in entry.limits.items()},
                "settings": {key: value for key, (value, _) in entry.settings.items()},
                "record_bytes": entry.record_bytes,
                "seen": asdict(made.seen[entry.topic]) if entry.topic in made.seen else None,
            }
            for entry in made.entries
        },
        "left_out": left_out,
        "notes": list(found.notes),
        "definitions": {name: made.origins[name] for name in made.definitions},
        "written": [str(output), *map(str, files)],
        "configuration": text,
    }


def _ask_topics(topics: Mapping[str, Topic]) -> list[Wish]:
    """Ask what to carry, and which way; the answers are wishes as from the command line."""

    def names(answer: str) -> list[str]:
        if answer.strip() == "all":
            return [name for name in topics if not is_of_ros_itself(name)]
        parts = answer.replace(",", " ").split()
        return list(dict.fromkeys(name for part in parts for name in _picked(part, list(topics))))

    def way(answer: str) -> Literal["plc", "ros"] | None:
        ways: dict[str, Literal["plc", "ros"] | None] = {"plc": "plc", "ros": "ros", "none": None}
        found = [each for each in ways if answer.strip() and each.startswith(answer.strip().lower())]
        if len(found) != 1:
            raise ValueError(f"  {answer.strip().lower()!r} is not one of {', '.join(ways)}")
        return ways[found[0]]

    wishes = []
    for name in _asked("Topics to carry (numbers, names, 1-4, all)", "all", names):
        topic, kind = topics[name], None
        if len(topic.types) != 1:
            say(f"{name}: {'unknown type' if not topic.types else ', '.join(topic.types)}")
            kind = _asked("  Message type", topic.types[0] if topic.types else None, type_called)
        proposed, why = direction(topic)
        say(f"{name}: {why}.")
        if to := _asked("  Carry it to (plc/ros/none)", proposed, way):
            wishes.append(Wish(name, kind, to, firm=False))
    return wishes


def _asked(question: str, default: str | None, understand: Callable[[str], Any]) -> Any:
    while True:
        try:
            return understand(str(typer.prompt(question, default=default)))
        except ValueError as error:
            say(str(error))


def _picked(part: str, names: list[str]) -> list[str]:
    if part in names:
        return [part]
    first, dash, last = part.partition("-")
    if first.isdecimal() and (not dash or last.isdecimal()):
        numbers = range(int(first), int(last if dash else first) + 1)
        if numbers and numbers[0] >= 1 and numbers[-1] <= len(names):
            return [names[number - 1] for number in numbers]
    raise ValueError(f"{part!r} is neither a listed topic nor a number from 1 to {len(names)}")
