"""The questions of ``rosplc init``, for people in front of a terminal."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from typing import TYPE_CHECKING

import typer

from rosplc.cli.text import say

if TYPE_CHECKING:
    from rosplc.init import Topic, Wish

__all__ = ["ask_topics", "on_terminal", "rows"]

_LONGEST = 40


def on_terminal() -> bool:
    """Return whether somebody can be asked."""
    return sys.stdin.isatty() and sys.stdout.isatty()


def rows(topics: Mapping[str, Topic]) -> list[tuple[object, ...]]:
    """Return a table's rows: number, topic, type, who publishes, who subscribes, what is proposed."""
    from rosplc.init import direction, is_of_ros_itself

    table: list[tuple[object, ...]] = []
    for number, (name, topic) in enumerate(topics.items(), 1):
        proposal = "of ROS itself" if is_of_ros_itself(name) else f"to {direction(topic)[0]}"
        types = ", ".join(topic.types) or "not told"
        table.append((number, name, types, _short(topic.publishers), _short(topic.subscribers), proposal))
    return table


def ask_topics(topics: Mapping[str, Topic]) -> list[Wish]:
    """Ask what to carry, and which way; the answers are wishes as from the command line.

    Raises:
        typer.Abort: Ctrl-C, or the end of the input.
    """
    from rosplc.init import direction, is_of_ros_itself
    from rosplc.init.select import Wish

    names = list(topics)
    usual = [name for name in names if not is_of_ros_itself(name)]
    picked = _ask_names(names, usual)
    wishes = []
    for name in picked:
        topic = topics[name]
        proposed, why = direction(topic)
        type_name = None
        if len(topic.types) != 1:
            say(f"{name}: {'nobody tells its type' if not topic.types else ', '.join(topic.types)}")
            type_name = _ask_type(topic.types)
        say(f"{name}: {why}.")
        to = _ask_one_of("  Carry it to", ("plc", "ros", "none"), proposed)
        if to != "none":
            wishes.append(Wish(name, type_name, "plc" if to == "plc" else "ros", firm=False))
    return wishes


def _ask_names(names: list[str], usual: list[str]) -> list[str]:
    while True:
        answer = typer.prompt("Which to carry (numbers, names, 1-4, all)", default="all")
        if answer.strip() == "all":
            return usual
        try:
            return list(
                dict.fromkeys(
                    name for part in answer.replace(",", " ").split() for name in _picked(part, names)
                )
            )
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
    raise ValueError(f"{part!r} is neither a topic of the list nor a number from 1 to {len(names)}")


def _ask_type(types: tuple[str, ...]) -> str:
    from rosplc.errors import RosplcError
    from rosplc.model.parse import full_name

    while True:
        try:
            return full_name(typer.prompt("  Its type", default=types[0] if types else None))
        except RosplcError as error:
            say(error.what)


def _ask_one_of(question: str, answers: tuple[str, ...], default: str) -> str:
    while True:
        answer = str(typer.prompt(f"{question} ({'/'.join(answers)})", default=default)).strip().lower()
        found = [each for each in answers if answer and each.startswith(answer)]
        if len(found) == 1:
            return found[0]
        say(f"  {answer!r} is none of {', '.join(answers)}")


def _short(names: tuple[str, ...]) -> str:
    text = ", ".join(names) or "-"
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST - 1]}…"
