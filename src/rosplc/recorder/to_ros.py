"""Replaying onto ROS topics, over any backend."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from rosplc.errors import RosplcError
from rosplc.model import TypeStore
from rosplc.recorder.convert import Conversion, renamed, with_types_of
from rosplc.recorder.replay import TopicCount
from rosplc.recorder.source import SourceTopic
from rosplc.ros import ROS1, Backend, Publisher, open_backend

__all__ = ["RosTarget"]

_LINGER_S = 1.0  # a middleware may still be sending, or repeating what got lost


class RosTarget:
    """Publishers on ROS topics, over any backend.

    Args:
        topics: Name in ROS → topic.
        backend: The backend's name, or ``auto``.
        distro: Whose definitions hold on the wire.
        domain: The ROS domain; None: ``ROS_DOMAIN_ID``, else 0.
        join: Opens the backend; for tests.

    Raises:
        RecordingError: REC007, the recording's definition of a type does not agree with the distribution's.
        BackendError: ROS001, ROS002 …
    """

    def __init__(
        self,
        topics: Mapping[str, SourceTopic],
        *,
        backend: str = "auto",
        distro: str = "jazzy",
        domain: int | None = None,
        join: Callable[..., Backend] = open_backend,
    ) -> None:
        self.linger_s = _LINGER_S
        self.counts = {name: TopicCount() for name in topics}
        self.notes: list[str] = []
        store = TypeStore.bundled(distro)
        self._conversions: dict[str, Conversion] = {}
        for name, topic in topics.items():
            own = topic.types(distro)
            store = with_types_of(store, own, topic.type_name)
            self._conversions[name] = conversion = Conversion(
                own, topic.type_name, store, renamed(topic.type_name, store),
                from_ros1=topic.ros1, to_ros1=distro == ROS1, where=name,
            )  # fmt: skip
            self.notes += [f"{name}: {note}" for note in conversion.notes]
        self.backend = join(backend, store, "rosplc_replay", domain=domain)
        self._publishers: dict[str, Publisher] = {}
        try:
            for name, topic in topics.items():
                self._publishers[name] = self.backend.advertise(
                    name, renamed(topic.type_name, store), topic.qos
                )
        except BaseException:
            self.backend.close()
            raise

    def send(self, topic: str, data: bytes, stamp_ns: int) -> None:
        """Publish a message; one that a subscriber has no room for is counted as lost."""
        count = self.counts[topic]
        try:
            sent = self._publishers[topic].write(self._conversions[topic](data), stamp_ns)
        except RosplcError as error:
            count.refused += 1
            count.reason = count.reason or f"{error.what} [{error.code}]"
            return
        if sent:
            count.sent += 1
        else:
            count.lost += 1
            count.reason = "a subscriber does not keep up"

    def missing(self) -> list[str]:
        """Return the topics that nobody subscribes to."""
        return [name for name, publisher in self._publishers.items() if not publisher.matched]

    def close(self) -> None:
        """Leave the graph."""
        self.backend.close()
