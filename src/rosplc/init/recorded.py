"""A robot of which only a recording is available."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal

from rosplc.errors import BackendError, MessageTypeError, RosplcError
from rosplc.init.found import Found, Meter, Seen, Topic
from rosplc.init.learn import Definitions
from rosplc.model import DISTROS, TypeStore
from rosplc.model.parse import full_name
from rosplc.recorder.mcap_file import survey
from rosplc.ros import ROS1
from rosplc.ros.bag import Bag, BagTopic

_NEWEST = "jazzy"
_UNNAMED = "unnamed"
_WAYS: dict[str, Literal["plc", "ros"]] = {"to_plc": "plc", "to_ros": "ros"}


class RecordedRobot:
    """A recording.

    ``distro`` None selects the distribution that fits the recording best; ``folders`` contain the user's
    ``.msg`` files; ``ros`` has more keys of the configuration's section ``ros``. Raises BackendError: ROS006,
    the recording cannot be read; ROS001, its ROS version is not that of ``distro``.
    """

    def __init__(
        self, path: Path, distro: str | None, folders: Sequence[Path], ros: Mapping[str, object]
    ) -> None:
        self._bag = Bag(path)
        try:
            self._recorded = self._bag.topics()
            self._carried, self._carried_distro = _carried(path)
            chosen, why = self._distro(distro)
            self.definitions = Definitions(chosen, folders)
        except BaseException:
            self._bag.close()
            raise
        topics: dict[str, list[BagTopic]] = {}
        for each in self._recorded:
            topics.setdefault(_absolute(each.name), []).append(each)
        note = (
            "A recording shows publishers, but no subscribers: "
            "use --to-ros TOPIC=TYPE for the topics that the PLC should publish."
        )
        carried = self._carried
        self.found = Found(
            {name: _topic(name, parts, carried.get(name, "")) for name, parts in sorted(topics.items())},
            f"the recording {path}",
            {**ros, "distro": chosen},
            {"distro": why},
            () if carried.keys() >= topics.keys() else (note,),
        )

    def _distro(self, wanted: str | None) -> tuple[str, str]:
        if wanted is not None:
            if (wanted == ROS1) != (self._bag.ros_version == 1):
                raise BackendError(
                    "ROS001",
                    f"{wanted} is not a ROS {self._bag.ros_version} distribution, as the recording requires",
                    where=str(self._bag.path),
                    remedy="Omit --distro, or specify a distribution of that ROS version.",
                )
            return wanted, "as requested"
        if self._bag.ros_version == 1:
            return ROS1, "the recording is from ROS 1"
        if self._bag.distro in DISTROS:
            return self._bag.distro, "specified by the recording"
        if self._carried_distro in DISTROS and self._carried_distro != ROS1:
            return self._carried_distro, "the recorded bridge used it"
        candidates = [_NEWEST, *(name for name in reversed(DISTROS) if name not in (ROS1, _NEWEST))]
        best = min(candidates, key=self._misfits)
        more = "" if best == _NEWEST else "; its definitions match this one best"
        return best, f"the recording specifies no distribution{more}"

    def _misfits(self, distro: str) -> int:
        """Return the number of types in the recording that a distribution defines differently."""
        known = TypeStore.bundled(distro)
        count = 0
        for each in self._recorded:
            if each.definition and each.type_name in known:
                try:
                    known.with_definition(each.type_name, each.definition)
                except MessageTypeError:
                    count += 1
        return count

    def learn(self, topic: str, type_name: str) -> None:
        """Make sure that a topic's type is known; see :meth:`rosplc.init.live.LiveRobot.learn`."""
        carried = [
            each.definition
            for each in self._recorded
            if _absolute(each.name) == topic and _full(each.type_name) == type_name and each.definition
        ]
        if carried:
            # Also where the type is known: a recording of another definition must not be measured by ours.
            self.definitions.learn(type_name, carried[0], f"the recording {self._bag.path}")
        elif not self.definitions.find_installed(type_name):
            raise self.definitions.unknown(type_name, ", and the recording contains no definition of it")

    def listen(
        self, wanted: Mapping[str, str], seconds: float, progress: Callable[[str], None]
    ) -> dict[str, Seen]:
        """Read the recording to its end; see :meth:`rosplc.init.live.LiveRobot.listen`."""
        store = self.definitions.store
        meters = {(topic, kind): Meter(store, kind) for topic, kind in wanted.items()}
        first = last = count = 0
        total = sum(each.count for each in self._recorded)
        trouble, shown = "", time.monotonic()
        try:
            for topic, kind, time_ns, data in self._bag.messages():
                count += 1
                first = first or time_ns
                last = max(last, time_ns)
                if (meter := meters.get((_absolute(topic), _full(kind)))) is not None:
                    meter.take(data, time_ns)
                if (now := time.monotonic()) - shown > 1.0:
                    shown = now
                    progress(f"{count} of {total} messages read")
        except RosplcError as error:
            trouble = error.what
            note = f"The recording was read only up to the damaged part: {error.what}."
            self.found = replace(self.found, notes=(*self.found.notes, note))
        lasted = (last - first) / 1e9
        return {topic: meter.finish(lasted, trouble) for (topic, _), meter in meters.items()}

    def close(self) -> None:
        """Close the file."""
        self._bag.close()


def _absolute(topic: str) -> str:
    # ROS 1 recorders keep the name as it was given; without a namespace it is at the root.
    return topic if topic.startswith("/") else f"/{topic}"


def _full(type_name: str) -> str:
    try:
        return full_name(type_name)
    except MessageTypeError:
        return type_name


def _carried(path: Path) -> tuple[dict[str, Literal["plc", "ros"]], str]:
    """Return the metadata of rosplc's own recorder: the direction of each topic, and the distribution."""
    ways: dict[str, Literal["plc", "ros"]] = {}
    distros: list[str] = []
    for file in sorted(path.glob("*.mcap")) if path.is_dir() else [path] if path.suffix == ".mcap" else []:
        try:
            channels = survey(file).channels.values()
        except RosplcError:
            continue  # what can be read of it has been read
        for channel in channels:
            if (way := channel.metadata.get("rosplc.direction")) in _WAYS:
                ways[_absolute(channel.topic)] = _WAYS[way]
                distros.append(channel.metadata.get("rosplc.distro", ""))
    return ways, distros[0] if len(set(distros)) == 1 else ""


def _topic(name: str, parts: Sequence[BagTopic], carried: Literal["", "plc", "ros"]) -> Topic:
    publishers = {node for part in parts for node in part.publishers}
    return Topic(
        name=name,
        types=tuple(sorted({_full(part.type_name) for part in parts})),
        publishers=() if carried == "ros" else tuple(sorted(publishers)) or (_UNNAMED,),
        offered=tuple(dict.fromkeys(qos for part in parts for qos in part.offered)),
        carried=carried,
    )
