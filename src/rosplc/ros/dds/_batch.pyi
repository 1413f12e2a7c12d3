from typing import final

from _typeshed import ReadableBuffer

@final
class Inlet:
    """Passes the messages of many readers to their sinks, in one call; needs :func:`load`.

    Only one thread may call wait() (RuntimeError); other methods may be called from any thread.
    """

    def __new__(cls) -> Inlet: ...
    def add(self, key: int, reader: int, capsule: object, /) -> None:
        """Pass the messages of a reader, attached to the waitset under this key, to a sink."""
    def remove(self, key: int, /) -> None:
        """Stop using the reader's sink; it is not in use after this returns."""
    def wait(
        self, waitset: int, room: int, timeout_ns: int, /
    ) -> tuple[list[int], list[tuple[int, bytes, int]]]:
        """Sleep and pass messages on until something is left to do, or until the time is over.

        Returns the keys of ready readers without an open sink, and messages (key, payload, stamp_ns)
        that a sink did not take, in order. ``room`` is the number of entities attached to the waitset.
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
        """Send messages until one is not sent, exceeds ``most`` bytes, or follows a longer silence."""
    def close(self) -> None:
        """Stop sending."""
    def write(self, payload: bytes, stamp_ns: int, /) -> bool:
        """Send a message of whole words; return whether it was sent."""

def load(path: str, /) -> None:
    """Use this library, which is already loaded. Raises OSError if it lacks a function."""

def changed(pairs: ReadableBuffer, /) -> list[int]:
    """Return the positions of the endpoints with a status that may have changed since the last call.

    ``pairs`` holds two 32-bit integers per endpoint, its handle and a mask of statuses. Without :func:`load`
    all positions are returned; those of endpoints that no longer exist are always returned.
    """
