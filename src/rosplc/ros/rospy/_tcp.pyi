from typing import Any, final

@final
class Loop:
    """Connections that one thread serves, in :meth:`wait`; the rest may be called from any.

    ``most``: bytes of a message; a connection that announces more ends.
    """

    def __new__(cls, most: int) -> Loop: ...
    def receive(self, fd: int, owner: object, capsule: object, /) -> None:
        """Receive from a publisher, into a sink or (None) for :meth:`wait`. Raises OSError, ValueError."""
    def divert(self, fd: int, capsule: object, /) -> None:
        """Put what comes into another sink, or none (None)."""
    def remove(self, fd: int, /) -> None:
        """Let go of a connection, before it is closed; harmless if there is none."""
    def wait(self) -> list[tuple[Any, list[bytes], str | None]]:
        """Sleep and pass messages on until something is left to do, or :meth:`wake` is called.

        Returns owners, messages that no sink took, in order, and why the connection ended, if it has.
        Raises RuntimeError: Another thread waits.
        """
    def wake(self) -> None:
        """Make this or the next :meth:`wait` return."""
    def close(self) -> None:
        """Give everything back; nothing may wait any more."""

@final
class Sender:
    """The subscribers of a topic; the loop's thread sends what has to wait."""

    def __new__(cls, loop: Loop) -> Sender: ...
    @property
    def waiting(self) -> int:
        """How many messages wait for all subscribers."""
    def add(self, fd: int, owner: object, depth: int, latching: bool, /) -> None:
        """Send to a subscriber too, what is latched first; ``depth`` messages may wait for it.

        Raises OSError, ValueError.
        """
    def write(self, payload: bytes, latch: bool, /) -> int:
        """Send a message; return how many had to give way in full queues. Never blocks."""
    def close(self) -> None:
        """Let no outlet send any more."""

@final
class Outlet:
    """A publisher's sink."""

    def __new__(cls, sender: Sender, latch: bool) -> Outlet: ...
    @property
    def capsule(self) -> object: ...
    @property
    def messages(self) -> int: ...
    @property
    def last_ns(self) -> int: ...
    def open(self, limit_ns: int, /) -> None:
        """Send, until a queue is full or a message comes after a longer silence."""
    def close(self) -> None:
        """Send nothing any more."""
