"""Replaying onto ROS topics, over any backend."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from rosplc.codec import Codec, Wire
from rosplc.errors import RecordingError, RosplcError
from rosplc.layout import Limits, compute_layout
from rosplc.model import TypeStore
from rosplc.recorder.source import SourceTopic
from rosplc.recorder.target import TopicCount
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
        RecordingError: REC007, the recording's definition of a type differs from the distribution's.
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
        store = TypeStore.bundled(distro)
        for topic in topics.values():
            try:
                if topic.definition is not None:
                    store = store.with_definition(topic.type_name, topic.definition)
                store[topic.type_name]
            except RosplcError as error:
                raise RecordingError(
                    "REC007",
                    f"its type cannot be used: {error.what} [{error.code}]",
                    where=topic.name,
                    remedy="Name the distribution that it was recorded with (--distro), or leave it out.",
                ) from error
        # Towards ROS 1 messages are written anew, which takes a layout that they fit.
        self._codecs: dict[str, tuple[Codec, Codec]] = {}
        if distro == ROS1:
            for name, topic in topics.items():
                self._codecs[name] = _to_ros1(store, topic)
        self.backend = join(backend, store, "rosplc_replay", domain=domain)
        self._publishers: dict[str, Publisher] = {}
        try:
            for name, topic in topics.items():
                self._publishers[name] = self.backend.advertise(name, topic.type_name, topic.qos)
        except BaseException:
            self.backend.close()
            raise

    def send(self, topic: str, data: bytes, stamp_ns: int) -> None:
        """Publish a message; one that a subscriber has no room for is counted as lost."""
        count = self.counts[topic]
        try:
            if topic in self._codecs:
                read, write = self._codecs[topic]
                data = write.encode(read.decode(data))
            sent = self._publishers[topic].write(data, stamp_ns)
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


def _to_ros1(store: TypeStore, topic: SourceTopic) -> tuple[Codec, Codec]:
    limits = Limits.from_dict(dict(topic.limits)) if topic.limits is not None else Limits(4096, 4096)
    layout = compute_layout(store, topic.type_name, limits)
    return Codec(layout, Wire.CDR), Codec(layout, Wire.ROS1)
