"""Proposals for a configuration from the topics found: direction, limits, QoS and times.

Every proposal has a reason, and every chosen number follows a rule at the top of this module.
The file contains both, so that the integrator can judge and correct them.
"""

from __future__ import annotations

import fnmatch
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

from rosplc.errors import LayoutError, RosplcError
from rosplc.harmless import listed, nearest, plural
from rosplc.init.found import Seen, Topic
from rosplc.layout import Layout, Limits, compute_layout
from rosplc.layout.nodes import MAX_SEQUENCE, MAX_STRING, SequenceNode, StringNode
from rosplc.model import TypeStore
from rosplc.model.parse import full_name
from rosplc.ros.names import validate_topic

_STRING_HEADROOM, _STRING_STEP, _STRING_LEAST = 2.0, 16, 48
_SEQUENCE_HEADROOM, _SEQUENCE_STEP = 1.5, 4
_RATE_HEADROOM, _RATE_STEP = 1.5, 100
_SURE = 10  # messages from which on a length that never changed counts as fixed
_STALE_S = 1.0  # the configuration's default for messages to the PLC
_STALE_GAPS = 3
_FAST_HZ = 100.0
_LARGE = 64 * 1024
_LARGEST = 128 * 1024 * 1024  # with four slots half a gigabyte: no topic for a PLC

RULES = (
    f"The limit of a string is twice the longest length seen, rounded up to a multiple of {_STRING_STEP}, "
    f"and at least {_STRING_LEAST} bytes. The limit of a sequence is 1.5 times the longest length seen, "
    f"rounded up to a multiple of {_SEQUENCE_STEP}, or exactly that length if it never changed in at least "
    f"{_SURE} messages. With fewer than {_SURE} messages, no limit is set below the default. "
    "A message that exceeds a limit is refused and counted, never truncated."
)
"""The rules for proposed limits, in words."""

_OF_ROS = frozenset(
    {"/rosout", "/rosout_agg", "/parameter_events", "/diagnostics", "/diagnostics_agg", "/clock"}
)


@dataclass
class Entry:
    """One topic of the configuration.

    ``about`` describes the topic in sentences; ``limits`` has the capacities that differ from the defaults,
    by path, ``settings`` the values of other keys as YAML, both with the reason; ``record_bytes`` is the size
    of a record with these limits.
    """

    topic: str
    type_name: str
    to: Literal["plc", "ros"]
    about: list[str] = field(default_factory=list)
    limits: dict[str, tuple[int, str]] = field(default_factory=dict)
    settings: dict[str, tuple[str, str]] = field(default_factory=dict)
    record_bytes: int = 0


def is_of_ros_itself(topic: str) -> bool:
    """Return whether a topic belongs to ROS itself, and is carried only if the user names it."""
    return topic in _OF_ROS or any(part.startswith("_") for part in topic.split("/"))


def direction(topic: Topic) -> tuple[Literal["plc", "ros"], str]:
    """Return the direction in which a topic should be carried, and the reason.

    The PLC reads a topic that has a publisher, and publishes one that has only subscribers. If a topic has
    both, a second publisher would interfere with the first, so the PLC reads it unless the user decides
    otherwise. A topic that a bridge carried during the recording keeps its direction.
    """
    if topic.carried:
        way = "from" if topic.carried == "ros" else "to"
        return topic.carried, f"a bridge carried it {way} the PLC during the recording"
    subs, pubs = _listed(topic.subscribers), _listed(topic.publishers)
    if topic.publishers and topic.subscribers:
        return "plc", f"it is published by {pubs} for {subs}; the PLC subscribes, too"
    if topic.publishers:
        return "plc", f"it is published by {pubs}" if topic.publishers != ("unnamed",) else "it was recorded"
    if topic.subscribers:
        return "ros", f"it has subscribers ({subs}) but no publisher"
    return "plc", "it has neither publishers nor subscribers"


def propose(
    topic: Topic, type_name: str, to: Literal["plc", "ros"], store: TypeStore, seen: Seen | None
) -> Entry:
    """Return the entry of a topic whose type is in the store; ``seen`` is None without measurements.

    Raises LayoutError LAY… if no limits give a valid record of the type.
    """
    entry = Entry(topic.name, store[type_name].name, to)
    _tell(entry, topic, seen)
    layout = _limits(entry, store, seen)
    entry.record_bytes = layout.size
    if layout.size > _LARGEST:
        raise LayoutError(
            "LAY003",
            f"based on the data seen, a record needs {layout.size} bytes; the limit is {_LARGEST}",
            where=topic.name,
            remedy="Choose a topic with smaller messages, or write the entry and its limits by hand.",
        )
    if to == "plc":
        _quality(entry, topic)
        _times(entry, topic, seen)
    if layout.size > _LARGE:
        entry.about.append(
            f"A record is {layout.size} bytes long; copying it takes a noticeable part of a scan. "
            "Lower the topic's largest limits if you can."
        )
    return entry


def _tell(entry: Entry, topic: Topic, seen: Seen | None) -> None:
    to, (proposed, why) = entry.to, direction(topic)
    entry.about.append(f"{why[0].upper()}{why[1:]}.")
    if proposed != to:
        entry.about.append(f"Carried {'to the PLC' if to == 'plc' else 'from the PLC'} as requested.")
    if len(topic.types) > 1:
        entry.about.append(f"It has several types: {', '.join(topic.types)}.")
    if to == "ros" and topic.publishers:
        entry.about.append("Its publishers and the PLC will both publish to it.")
    if seen is None or (to == "ros" and not seen.messages):
        return
    if not seen.messages:
        why = f": {seen.trouble}" if seen.trouble else ""
        entry.about.append(f"No message was seen in {seen.seconds:.3g} s{why}.")
        return
    rate = f" ({seen.rate_hz:.3g} Hz)" if seen.rate_hz else ""
    entry.about.append(f"Measured {plural(seen.messages, 'message')} in {seen.seconds:.3g} s{rate}.")
    if seen.unreadable:
        entry.about.append(
            f"{plural(seen.unreadable, 'message')} could not be decoded: the robot may use a different "
            "definition of the type."
        )


def _limits(entry: Entry, store: TypeStore, seen: Seen | None) -> Layout:
    """Add limits from the measured lengths, and return the resulting layout."""
    fields = compute_layout(store, entry.type_name).fields()
    variable = {path: node for path, _, node in fields if isinstance(node, StringNode | SequenceNode)}
    wanted = _wanted(variable, seen) if seen is not None and seen.messages else {}
    while True:
        capacities = {path: capacity for path, (capacity, _) in wanted.items()}
        try:
            layout = compute_layout(store, entry.type_name, Limits(fields=capacities))
            break
        except LayoutError as error:
            # A default value of the definition may need more than was seen; its default capacity then holds.
            if error.where not in wanted:
                raise
            del wanted[error.where]
    entry.limits |= {path: item for path, item in wanted.items() if variable[path].capacity != item[0]}
    unseen = [path for path in variable if path not in wanted]
    if unseen:
        nothing = "always empty" if wanted or (seen is not None and seen.messages) else "not seen yet"
        entry.about.append(f"The default limits above apply to {listed(unseen, 6)} ({nothing}).")
    return layout


def _wanted(variable: Mapping[str, StringNode | SequenceNode], seen: Seen) -> dict[str, tuple[int, str]]:
    """Return the capacities that fit the measured lengths, each with the reason."""
    found = {}
    for path, length in seen.lengths.items():
        if length.most == 0 or (node := variable.get(path)) is None:
            continue
        if isinstance(node, StringNode):
            capacity = min(max(_STRING_LEAST, _up(length.most * _STRING_HEADROOM, _STRING_STEP)), MAX_STRING)
            why = f"longest seen: {plural(length.most, 'byte')}"
        elif length.least == length.most and seen.messages >= _SURE:
            capacity = min(length.most, MAX_SEQUENCE)
            why = f"always {length.most} in {seen.messages} messages"
        else:
            capacity = min(_up(length.most * _SEQUENCE_HEADROOM, _SEQUENCE_STEP), MAX_SEQUENCE)
            why = f"longest seen: {length.most}"
        if seen.messages < _SURE:
            capacity = max(capacity, node.capacity)
        if node.bound is not None and capacity > node.bound:
            capacity, why = node.bound, f"{why}; the type allows at most {node.bound}"
        found[path] = capacity, why
    return found


def _quality(entry: Entry, topic: Topic) -> None:
    if any(qos.reliability == "best_effort" for qos in topic.offered):
        why = "a publisher is best effort, so a reliable subscription would not match it"
        entry.settings["qos"] = "{reliability: best_effort}", why
    if _retained(topic):
        entry.settings["latched"] = "true", "its publishers keep the last message for late subscribers"


def _times(entry: Entry, topic: Topic, seen: Seen | None) -> None:
    if seen is None:
        return
    if _retained(topic) and seen.messages < 2:
        entry.settings["stale_after"] = "never", "its messages are not sent regularly"
    elif seen.longest_gap_s * _STALE_GAPS > _STALE_S:
        seconds = min(math.ceil(seen.longest_gap_s * _STALE_GAPS), 24 * 3600)
        why = f"three times the longest pause seen, {seen.longest_gap_s:.3g} s"
        entry.settings["stale_after"] = f"{seconds}s", why
    if entry.record_bytes <= _LARGE and seen.rate_hz > _FAST_HZ:
        rate = min(_up(seen.rate_hz * _RATE_HEADROOM, _RATE_STEP), 1_000_000)
        why = f"{seen.rate_hz:.4g} Hz seen; this value sets the number of slots"
        entry.settings["expected_rate"] = f"{rate}Hz", why


def _retained(topic: Topic) -> bool:
    return bool(topic.offered) and all(qos.durability == "transient_local" for qos in topic.offered)


def _up(value: float, step: int) -> int:
    return math.ceil(value / step) * step


def _listed(names: tuple[str, ...]) -> str:
    return listed((name if name != "?" else "a node without a name" for name in names), 3)


To = Literal["plc", "ros"]
_GLOB = frozenset("*?[")


@dataclass(frozen=True)
class Wish:
    """The user's selection: a topic, or a pattern with ``*``, ``?`` or ``[…]``.

    ``type_name`` and ``to`` are None if they were not given; ``firm``: a topic that cannot be carried is an
    error instead of being left out.
    """

    pattern: str
    type_name: str | None = None
    to: To | None = None
    firm: bool = True

    @property
    def exact(self) -> bool:
        """Whether the selection is exactly one topic."""
        return not _GLOB & set(self.pattern)


@dataclass(frozen=True)
class Chosen:
    """A topic to be carried; ``named``: the user selected it by its name, not by a pattern."""

    topic: Topic
    type_name: str
    to: To
    named: bool


def parse_wish(text: str, to: To | None = None) -> Wish:
    """Return the selection that ``/topic``, ``/robot1/*`` or ``/topic=package/Type`` expresses.

    Raises ValueError with a text that shows the problem.
    """
    pattern, equals, type_name = text.strip().partition("=")
    if pattern and not pattern.startswith(("/", "*")):
        pattern = f"/{pattern}"
    if not pattern:
        raise ValueError(f"{text!r} is not a topic")
    return Wish(pattern, type_called(type_name) if equals else None, to)


def type_called(type_name: str) -> str:
    """Return a type's full name; raises ValueError, with the valid form, if it is not a type name."""
    try:
        return full_name(type_name)
    except RosplcError as error:
        raise ValueError(error.what) from None


def select(
    topics: Mapping[str, Topic], wishes: Sequence[Wish], *, everything: bool
) -> tuple[dict[str, Chosen], dict[str, str]]:
    """Return the topics to carry by name, and the reasons why other selected topics are left out.

    For the same topic, values of a later selection replace earlier ones; ``everything`` selects all topics
    except those of ROS itself. Raises ValueError if a selected topic was not found or cannot be carried.
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
        hint = f"; did you mean {near}?" if near else f"; specify {wish.pattern}=PACKAGE/TYPE to carry it"
        raise ValueError(f"topic {wish.pattern} was not found{hint}")
    found = [
        name for name in topics if fnmatch.fnmatchcase(name, wish.pattern) and not is_of_ros_itself(name)
    ]
    if not found:
        raise ValueError(f"no topic matches {wish.pattern}")
    return found


def _type(topic: Topic, wish: Wish) -> str:
    if wish.type_name:
        return wish.type_name
    if not topic.types:
        raise ValueError(f"its type is unknown; specify {topic.name}=PACKAGE/TYPE")
    if len(topic.types) > 1:
        types = ", ".join(topic.types)
        raise ValueError(f"it has several types ({types}); specify one: {topic.name}=PACKAGE/TYPE")
    return type_called(topic.types[0])
