"""ROS graphs of their own for tests: a domain that nobody else uses, backends that get closed."""

from __future__ import annotations

import contextlib
import fcntl
import os
import random
import struct
import tempfile
from collections.abc import Iterator
from pathlib import Path

from rosplc.model import TypeStore
from rosplc.ros import Backend, open_backend

STRING = "std_msgs/msg/String"
LOCAL = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}  # unicast: runs where nothing has multicast


@contextlib.contextmanager
def free_domain() -> Iterator[int]:
    """Hold a ROS domain that no other test on this machine uses, in whatever process.

    Only up to 101: the ports of higher domains lie among Linux's ephemeral ones.
    """
    for number in random.sample(range(10, 101), 91):
        path = Path(tempfile.gettempdir()) / f"rosplc-test-domain-{os.getuid()}-{number}"
        with path.open("w") as lock:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                continue
            yield number
            return
    raise RuntimeError("every ROS domain is taken")


def string(text: str) -> bytes:
    """Return a serialized ``std_msgs/msg/String``, as DDS carries it."""
    data = text.encode() + b"\0"
    return b"\0\1\0\0" + struct.pack("<I", len(data)) + data + bytes(-len(data) % 4)


def text_of(payload: bytes) -> str:
    """Return the text of a serialized ``std_msgs/msg/String`` of either byte order."""
    (length,) = struct.unpack_from("<I" if payload[1] else ">I", payload, 4)
    return payload[8 : 8 + length - 1].decode()


class Graph:
    """Backends of one kind in one domain.

    Args:
        kind: The backend's name.
        domain: The ROS domain.
        distro: The ROS distribution of nodes that ask for none.
    """

    def __init__(self, kind: str, domain: int, distro: str = "jazzy") -> None:
        self.kind = kind
        self.domain = domain
        self.store = TypeStore.bundled(distro)
        self._open: list[Backend] = []

    def node(self, name: str, store: TypeStore | None = None, **options: object) -> Backend:
        """Join with a node."""
        options.setdefault("environment", LOCAL)
        backend = open_backend(self.kind, store or self.store, name, domain=self.domain, **options)  # type: ignore[arg-type]
        self._open.append(backend)
        return backend

    def close(self) -> None:
        """Close all nodes."""
        for backend in self._open:
            backend.close()

    def backends(self) -> tuple[Backend, ...]:
        """Return all nodes that were opened."""
        return tuple(self._open)
