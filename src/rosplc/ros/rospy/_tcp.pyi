from typing import Any, final

@final
class Loop:
    """Connections that one thread serves in :meth:`wait`; other methods may be called from any thread.

    ``most`` is the maximum message size in bytes; a connection that announces more is ended.
    """

    def __new__(cls, most: int) -> Loop: ...
    def receive(self, fd: int, owner: object, capsule: object, /) -> None:
        """Receive from a publisher, into a sink or (None) for :meth:`wait`. Raises OSError, ValueError."""
    def divert(self, fd: int, capsule: object, /) -> None:
        """Pass received messages to another sink, or to none (None)."""
    def remove(self, fd: int, /) -> None:
        """Stop serving a connection before it is closed; does nothing if there is none."""
    def wait(self) -> list[tuple[Any, list[bytes], str | None]]:
        """Sleep and pass messages on until something is left to do, or :meth:`wake` is called.

        Returns owners, messages that no sink took, in order, and why the connection ended, if it has.
        Raises RuntimeError if another thread is waiting.
        """
    def wake(self) -> None:
        """Make this or the next :meth:`wait` return."""
    def close(self) -> None:
        """Release all resources; no thread may be waiting."""

@final
class Sender:
    """The subscribers of a topic; the loop's thread sends messages that have to wait."""

    def __new__(cls, loop: Loop) -> Sender: ...
    @property
    def waiting(self) -> int:
        """Number of messages that wait for all subscribers."""
    def add(self, fd: int, owner: object, depth: int, latching: bool, /) -> None:
        """Add a subscriber, and first send it the latched message; ``depth`` messages may wait for it.

        Raises OSError, ValueError.
        """
    def write(self, payload: bytes, latch: bool, /) -> int:
        """Send a message; return the number of messages dropped from full queues. Never blocks."""
    def close(self) -> None:
        """Stop all outlets from sending."""

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
        """Stop sending."""
