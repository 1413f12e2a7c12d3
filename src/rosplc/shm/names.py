"""Where objects lie: names of spec/shm-format.md, section 8.1."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from rosplc.shm.constants import FNV_OFFSET, FNV_PRIME, MAX_NAME, NAME_KEPT
from rosplc.shm.header import channel_error

_PREFIX = re.compile(r"[A-Za-z][A-Za-z0-9_-]{0,31}")
_TOPIC = re.compile(r"(/[A-Za-z_][A-Za-z0-9_]*)+")


def fnv1a(text: str) -> int:
    """Return the 32-bit FNV-1a hash of a text of ASCII characters."""
    value = FNV_OFFSET
    for byte in text.encode("ascii"):
        value = (value ^ byte) * FNV_PRIME & 0xFFFFFFFF
    return value


@dataclass(frozen=True)
class Namespace:
    """The names of one bridge: a prefix in a directory.

    Attributes:
        prefix: Keeps several bridges of one machine apart.
        directory: Where the objects lie; anything but ``/dev/shm`` is for tests.

    Raises:
        ChannelError: SHM118 if the prefix is not valid.
    """

    prefix: str = "rosplc"
    directory: Path | str = "/dev/shm"

    def __post_init__(self) -> None:
        if not _PREFIX.fullmatch(self.prefix):
            raise channel_error(118, f"prefix {self.prefix!r} does not match {_PREFIX.pattern}")

    def object_name(self, topic: str) -> str:
        """Return the name of a topic's object. Raises SHM118 if the topic is not valid."""
        if not _TOPIC.fullmatch(topic):
            raise channel_error(118, f"topic {topic!r} does not match {_TOPIC.pattern}")
        name = f"{self.prefix}.t.{topic[1:].replace('/', '.')}"
        if len(name) > MAX_NAME:
            name = f"{name[:NAME_KEPT]}~{fnv1a(name):08x}"
        return name

    def path(self, topic: str) -> Path:
        """Return the path of a topic's object."""
        return Path(self.directory) / self.object_name(topic)

    def lock_path(self, topic: str) -> Path:
        """Return the path of the lock file beside a topic's object."""
        return Path(self.directory) / self._other_kind(topic, "l")

    def temporary_prefix(self, topic: str) -> str:
        """Return the name of a topic's temporaries up to their 8 random digits."""
        return self._other_kind(topic, "n") + "."

    def topics(self) -> list[str]:
        """Return the names of the objects that are present, sorted.

        Raises:
            ChannelError: SHM123 if the directory cannot be listed.
        """
        start = f"{self.prefix}.t."
        try:
            names = [entry.name for entry in Path(self.directory).iterdir()]
            return sorted(name for name in names if name.startswith(start))
        except OSError as error:
            raise channel_error(123, f"cannot list: {error.strerror}", str(self.directory)) from error

    def topic_of(self, object_name: str) -> str | None:
        """Return the topic of an object's name; None if it was shortened or is no such name."""
        start = f"{self.prefix}.t."
        topic = "/" + object_name[len(start) :].replace(".", "/")
        return topic if object_name.startswith(start) and _TOPIC.fullmatch(topic) else None

    def _other_kind(self, topic: str, kind: str) -> str:
        at = len(self.prefix) + 1
        name = self.object_name(topic)
        return name[:at] + kind + name[at + 1 :]
