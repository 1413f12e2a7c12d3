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

    Attributes:
        name: As ROS writes it.
        types: Those that were seen on it, ``package/msg/Name``; more than one is an error of the robot, none
            means that no node announced it.
        publishers: Names of the nodes that publish it; ``?`` for a node without a name.
        subscribers: Names of the nodes that subscribe to it.
        offered: The publishers' quality of service, each once.
        hashes: The type hashes that are announced, each once.
        carried: Where a bridge took it when it was recorded: to the ``plc`` or to ``ros``; else empty.
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
    """What was found.

    Attributes:
        topics: By name, sorted.
        where: What was looked at, in words: ``domain 0, over dds``.
        ros: The keys of the configuration's section ``ros`` that lead there.
        why: Remarks on ``ros``, by key.
        notes: What is worth knowing beyond.
        calls: Services, then actions, by name; not those that each node of ROS has.
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
        """Make sure that a topic's type is known.

        Raises:
            RosplcError: It is not, or what tells its definition cannot be right.
        """

    def listen(
        self, wanted: Mapping[str, str], seconds: float, progress: Callable[[str], None]
    ) -> dict[str, Seen]:
        """Return what the messages of these topics (name → type) are like.

        Args:
            wanted: Type by topic; each type has been learnt.
            seconds: How long to listen; a recording is read to its end.
            progress: Called about once a second with how far it is, in words.
        """

    def close(self) -> None:
        """Leave the graph, or close the file."""
