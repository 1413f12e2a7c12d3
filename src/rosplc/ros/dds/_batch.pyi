from typing import final

from _typeshed import ReadableBuffer

@final
class Inlet:
    """What has arrived for many readers, into their sinks, in one call; needs :func:`load`.

    wait() belongs to one thread (RuntimeError); the rest may be called from any.
    """

    def __new__(cls) -> Inlet: ...
    def add(self, key: int, reader: int, capsule: object, /) -> None:
        """Put what a reader receives, attached to the waitset under this key, into a sink."""
    def remove(self, key: int, /) -> None:
        """Use the reader's sink no more; it is not in use once this returns."""
    def wait(
        self, waitset: int, room: int, timeout_ns: int, /
    ) -> tuple[list[int], list[tuple[int, bytes, int]]]:
        """Sleep and pass messages on until something is left to do, or until the time is over.

        Returns the keys of what is ready without an open sink, and messages (key, payload, stamp_ns)
        that a sink did not take, in order. ``room``: how much is attached to the waitset.
        """

@final
class Outlet:
    """A sink that sends messages with one of the wheel's writers; needs :func:`load`."""

    def __new__(cls, writer: int) -> Outlet: ...
    @property
    def capsule(self) -> object: ...
    @property
    def messages(self) -> int: ...
    @property
    def last_ns(self) -> int: ...
    def open(self, most: int, limit_ns: int, /) -> None:
        """Send, until one is not sent, has more than ``most`` bytes, or comes after a longer silence."""
    def close(self) -> None:
        """Send nothing any more."""
    def write(self, payload: bytes, stamp_ns: int, /) -> bool:
        """Send a message of whole words; return whether it was sent."""

def load(path: str, /) -> None:
    """Use this library, which is loaded already. Raises OSError where it lacks a function."""

def changed(pairs: ReadableBuffer, /) -> list[int]:
    """Return the places of the endpoints of which a status may have changed since this was last asked.

    ``pairs`` are 32-bit integers: of each endpoint its handle and a mask of its statuses. All are returned
    without :func:`load`, and always an endpoint that is no more.
    """
