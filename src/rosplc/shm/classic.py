"""A classic topic's memory and its lock as one thing that comes and goes: spec/classic-mode.md.

Programs of this kind remove and make their objects whenever they start. What is held here is
therefore compared with what the names lead to before and after every use, and attached again.
"""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

from rosplc.shm.classic_lock import ClassicLock, Entry
from rosplc.shm.classic_memory import ClassicMemory
from rosplc.shm.files import USUAL, Rights
from rosplc.shm.lock import NameLock

__all__ = ["ClassicObject", "Entry"]


class ClassicObject:
    """The memory of one classic topic with its lock; used by one thread.

    Args:
        name: The memory's name, without a slash.
        semaphore: The semaphore's, without ``sem.``; empty if nothing guards the memory.
        write: Whether this side writes the record.
        rights: Of what is made here.
        directory: Where the objects lie.

    Attributes:
        memory: None while it is not attached.
        lock: None while it is not attached, and without a semaphore.
        attachments: How often it was attached.
        recovered: How often a lock was freed, over all attachments.
        mended: How often a lock would have let in more than one, over all attachments.
    """

    def __init__(
        self,
        name: str,
        semaphore: str,
        record_size: int,
        *,
        write: bool,
        recover_after_ns: int,
        rights: Rights = USUAL,
        directory: Path | str = "/dev/shm",
    ) -> None:
        self.name, self.semaphore, self.record_size = name, semaphore, record_size
        self.memory: ClassicMemory | None = None
        self.lock: ClassicLock | None = None
        self.attachments = 0
        self._directory = Path(directory)
        self._write = write
        self._recover_after_ns = recover_after_ns
        self._rights = rights
        self._claim: NameLock | None = None
        self._counted = (0, 0)

    @property
    def recovered(self) -> int:
        """How often a lock was freed."""
        return self._counted[0] + (self.lock.recovered if self.lock else 0)

    @property
    def mended(self) -> int:
        """How often a lock would have let in more than one."""
        return self._counted[1] + (self.lock.mended if self.lock else 0)

    @property
    def doubtful(self) -> bool:
        """Whether somebody may be in the memory at the same time: without a lock always."""
        return self.lock is None or self.lock.doubtful

    def claim(self) -> None:
        """Keep other bridges away from this memory, whatever their prefix.

        Raises:
            ChannelError: SHM116 if one has it, and the others of :class:`~rosplc.shm.lock.NameLock`.
        """
        path = self._directory / f"rosplc.classic.{self.name}"
        self._claim = NameLock(path, self._rights)

    def owned(self) -> bool:
        """Return whether the claim of :meth:`claim` still holds."""
        return self._claim is not None and self._claim.still_there()

    def attach(self) -> None:
        """Open memory and semaphore, and make what is missing.

        Raises:
            ChannelError: As :class:`~rosplc.shm.classic_memory.ClassicMemory` and
                :class:`~rosplc.shm.classic_lock.ClassicLock`.
        """
        self.detach()
        memory = ClassicMemory(
            self._directory / self.name, self.record_size, write=self._write, rights=self._rights
        )
        try:
            if self.semaphore:
                self.lock = ClassicLock(
                    self.semaphore, self._recover_after_ns, rights=self._rights, directory=self._directory
                )
        except BaseException:
            memory.close()
            raise
        self.memory = memory
        self.attachments += 1

    def in_place(self) -> bool:
        """Return whether both names still lead to what is held here."""
        if self.memory is None:
            return False
        return self.memory.in_place() and (self.lock is None or self.lock.in_place())

    def enter(self, now_ns: int, *, alive: bool = False) -> Entry:
        """Try to take the lock; without a semaphore that succeeds."""
        return self.lock.enter(now_ns, alive=alive) if self.lock else Entry.ENTERED

    def look(self, now_ns: int, *, alive: bool = False) -> Entry:
        """Judge the lock without using it."""
        return self.lock.look(now_ns, alive=alive) if self.lock else Entry.ENTERED

    def leave(self) -> None:
        """Give the lock back."""
        if self.lock:
            self.lock.leave()

    def read(self) -> bytes | None:
        """Return the record; None where somebody was seen writing it at the same time.

        To be called inside the lock. Where that is in doubt, the record is read twice.
        """
        assert self.memory is not None
        image = self.memory.read()
        return None if self.doubtful and self.memory.read() != image else image

    def peek(self) -> bytes:
        """Return the record as it stands, perhaps half written: to see that something changed."""
        assert self.memory is not None
        return self.memory.read()

    def write(self, record: bytes) -> None:
        """Write the record; to be called inside the lock."""
        assert self.memory is not None
        self.memory.write(record)

    def detach(self) -> None:
        """Let go of memory and lock; they stay."""
        lock, self.lock = self.lock, None
        if lock is not None:
            recovered, mended = self._counted
            self._counted = (recovered + lock.recovered, mended + lock.mended)
            lock.close()
        memory, self.memory = self.memory, None
        if memory is not None:
            memory.close()

    def close(self) -> None:
        """Detach and give the claim back; a second call does nothing."""
        self.detach()
        claim, self._claim = self._claim, None
        if claim is not None:
            with suppress(OSError):
                claim.release()
