"""Which of the topics that were found are carried, and which way: by name, by pattern, or all."""

from __future__ import annotations

import fnmatch
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from rosplc.errors import RosplcError
from rosplc.harmless import nearest
from rosplc.init.found import Topic
from rosplc.init.propose import direction, is_of_ros_itself
from rosplc.model.parse import full_name
from rosplc.ros.names import validate_topic

To = Literal["plc", "ros"]
_GLOB = frozenset("*?[")


@dataclass(frozen=True)
class Wish:
    """What the user asked for: a topic, or a pattern with ``*``, ``?`` or ``[…]``.

    ``type_name`` and ``to`` as far as they were given; ``firm``: a topic that cannot be carried is an error,
    and not left out.
    """

    pattern: str
    type_name: str | None = None
    to: To | None = None
    firm: bool = True

    @property
    def exact(self) -> bool:
        """Whether it names one topic."""
        return not _GLOB & set(self.pattern)


@dataclass(frozen=True)
class Chosen:
    """A topic that is to be carried; ``named``: by the user, itself and not by a pattern."""

    topic: Topic
    type_name: str
    to: To
    named: bool


def parse_wish(text: str, to: To | None = None) -> Wish:
    """Return the wish that ``/topic``, ``/robot1/*`` or ``/topic=package/Type`` stands for.

    Raises ValueError with a text of what would be right.
    """
    pattern, equals, type_name = text.strip().partition("=")
    if pattern and not pattern.startswith(("/", "*")):
        pattern = f"/{pattern}"
    if not pattern:
        raise ValueError(f"{text!r} names no topic")
    if not equals:
        return Wish(pattern, None, to)
    return Wish(pattern, _full_name(type_name), to)


def _full_name(type_name: str) -> str:
    try:
        return full_name(type_name)
    except RosplcError as error:
        raise ValueError(error.what) from None


def select(
    topics: Mapping[str, Topic], wishes: Sequence[Wish], *, everything: bool
) -> tuple[dict[str, Chosen], dict[str, str]]:
    """Return the topics to carry by name, and why others that were meant are left out.

    A later wish replaces an earlier one's answers for the same topic; ``everything`` takes all topics but
    those of ROS itself. Raises ValueError: a wish names a topic that was not found, or cannot be carried.
    """
    meant: dict[str, Wish] = {}
    if everything:
        meant.update((name, Wish("*")) for name in topics if not is_of_ros_itself(name))
    for wish in wishes:
        for name in _matching(topics, wish):
            before = meant.get(name, wish)
            meant[name] = Wish(
                wish.pattern if wish.exact else before.pattern,
                wish.type_name or before.type_name,
                wish.to or before.to,
                wish.firm and before.firm,
            )
    chosen: dict[str, Chosen] = {}
    left_out: dict[str, str] = {}
    for name, wish in sorted(meant.items()):
        topic = topics.get(name) or Topic(name, (wish.type_name,) if wish.type_name else ())
        named = wish.exact and wish.firm
        try:
            type_name = _type(topic, wish)
            validate_topic(name)
        except (ValueError, RosplcError) as error:
            why = error.what if isinstance(error, RosplcError) else str(error)
            if named:
                raise ValueError(f"{name}: {why}") from None
            left_out[name] = why
            continue
        chosen[name] = Chosen(topic, type_name, wish.to or direction(topic)[0], named)
    return chosen, left_out


def _matching(topics: Mapping[str, Topic], wish: Wish) -> list[str]:
    if wish.exact:
        if wish.pattern in topics or wish.type_name:
            return [wish.pattern]
        near = nearest(wish.pattern, topics)
        hint = f"; did you mean {near}?" if near else f"; {wish.pattern}=PACKAGE/TYPE carries it nevertheless"
        raise ValueError(f"no topic {wish.pattern} was found{hint}")
    found = [
        name for name in topics if fnmatch.fnmatchcase(name, wish.pattern) and not is_of_ros_itself(name)
    ]
    if not found:
        raise ValueError(f"no topic that was found matches {wish.pattern}")
    return found


def _type(topic: Topic, wish: Wish) -> str:
    if wish.type_name:
        return wish.type_name
    if not topic.types:
        raise ValueError(f"nobody has told its type; write {topic.name}=PACKAGE/TYPE")
    if len(topic.types) > 1:
        types = ", ".join(topic.types)
        raise ValueError(f"it has several types ({types}); write {topic.name}=PACKAGE/TYPE with one")
    return _full_name(topic.types[0])
