"""What a robot, or a recording of one, shows of itself: the topics, and what their messages were like."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Literal, Protocol

from rosplc.init.definitions import Definitions
from rosplc.init.meter import Seen
from rosplc.ros import Qos


@dataclass(frozen=True)
class Topic:
    """One topic that was found.

    ``types`` are those seen on it, ``package/msg/Name``: more than one is an error of the robot, none means
    that no node announced it. ``publishers`` and ``subscribers`` name nodes, ``?`` one without a name;
    ``offered`` has the publishers' quality of service, each once, ``hashes`` the type hashes announced;
    ``carried`` is where a bridge took it when it was recorded, ``plc`` or ``ros``.
    """

    name: str
    types: tuple[str, ...]
    publishers: tuple[str, ...] = ()
    subscribers: tuple[str, ...] = ()
    offered: tuple[Qos, ...] = ()
    hashes: tuple[str, ...] = ()
    carried: Literal["", "plc", "ros"] = ""


@dataclass(frozen=True)
class Call:
    """A service or action that was found: its ``kind``, its type, and where its server is, or should be."""

    kind: Literal["service", "action"]
    name: str
    type_name: str
    server: Literal["plc", "ros"]
    why: str


@dataclass(frozen=True)
class Found:
    """What was found: topics by name, services and actions without those that each node has.

    ``where`` is what was looked at, in words; ``ros`` the keys of the configuration's section ``ros`` that
    lead there, ``why`` remarks on them by key; ``notes`` what is worth knowing beyond.
    """

    topics: Mapping[str, Topic]
    where: str
    ros: Mapping[str, object]
    why: Mapping[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    calls: tuple[Call, ...] = ()


class Source(Protocol):
    """A robot or a recording."""

    definitions: Definitions
    found: Found

    def learn(self, topic: str, type_name: str) -> None:
        """Make sure that a topic's type is known; raises RosplcError if it is not, or cannot be right."""

    def listen(
        self, wanted: Mapping[str, str], seconds: float, progress: Callable[[str], None]
    ) -> dict[str, Seen]:
        """Return what the messages of these topics (name → type, which was learnt) are like.

        A recording is read to its end; ``progress`` is called about once a second with how far it is, in
        words.
        """

    def close(self) -> None:
        """Leave the graph, or close the file."""
