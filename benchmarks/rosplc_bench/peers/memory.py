"""Contenders over shared memory: rosplc's channel, bytes or typed, and memory locked by a semaphore."""

from __future__ import annotations

import mmap
import os
import time
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import rosplc
from rosplc.errors import ChannelError
from rosplc.shm import Attached, Direction, Namespace, OwnedChannel, attach
from rosplc_bench.contenders import ANSWER, QUESTION, describe
from rosplc_bench.peers.exchange import COUNT, Operations, Transport, serve

_WAIT = 20.0


class Channels(Transport):
    """Both directions: records of bytes, as :mod:`rosplc.shm` carries them.

    A owns both objects, as a bridge does; B attaches to them, as any program beside it may. A channel wakes
    no reader: a side that sleeps does so on a POSIX semaphore beside it, one for each direction.

    Args:
        side: "A" or "B".
        folder: Where the objects lie.
        names: The semaphores: one that A posts, one that B posts.
    """

    def __init__(self, side: str, folder: Path, names: tuple[str, str]) -> None:
        super().__init__()
        namespace = Namespace("rosplc", folder)
        self._open: list[OwnedChannel | Attached]
        if side == "A":
            out = OwnedChannel.open(namespace, describe(QUESTION, Direction.TO_PLC), record_size=2 * COUNT)
            back = OwnedChannel.open(namespace, describe(ANSWER, Direction.TO_ROS), record_size=2 * COUNT)
            self._open = [out, back]
            self.writer, self.reader = out.writer(), back.reader()
        else:
            question = _wait_for(namespace, QUESTION)
            answer = _wait_for(namespace, ANSWER)
            self._open = [question, answer]
            self.writer, self.reader = answer.writer(), question.reader("bench", observe=False)
        # Only a side that sleeps needs them; without the package everything else can be measured.
        self._signals = signals(side, names) if find_spec("posix_ipc") else None

    def operations(self) -> Operations:
        """Return publication and taking themselves, and the semaphores' own methods."""
        if self._signals is None:
            return Operations(self.writer.publish, self.reader.update, self.wake, self.wait)
        wake, wait = self._signals
        return Operations(self.writer.publish, self.reader.update, wake.release, wait.acquire)

    def wait(self) -> None:
        """Refuse: without the package there is nothing to wait on."""
        raise SystemExit("the Python package posix_ipc is missing")

    def close(self) -> None:
        """Give the claims back."""
        for each in self._open:
            each.close()


def signals(side: str, names: tuple[str, str]) -> tuple[Any, Any]:
    """Return the semaphore that this side posts, and the one that it waits for."""
    import posix_ipc

    made = [posix_ipc.Semaphore(name, posix_ipc.O_CREAT, mode=0o600, initial_value=0) for name in names]
    return (made[0], made[1]) if side == "A" else (made[1], made[0])


def _wait_for(namespace: Namespace, topic: str) -> Attached:
    deadline = time.monotonic() + _WAIT
    while True:
        try:
            return attach(namespace, topic, record_size=2 * COUNT, write=True)
        except ChannelError as error:
            if error.code != "SHM101" or time.monotonic() > deadline:
                raise
            time.sleep(0.005)


_WAIT = 20.0


class TypedChannels(Transport):
    """B through :func:`rosplc.attach`: messages with fields instead of bytes, as scripts use it.

    Args:
        folder: Where the objects lie.
    """

    def __init__(self, folder: Path) -> None:
        super().__init__()
        self._in = rosplc.attach(QUESTION, directory=str(folder), timeout=_WAIT)
        self._out = rosplc.attach(ANSWER, directory=str(folder), write=True, timeout=_WAIT)

    def send(self, record: bytearray) -> None:
        """Write a message."""
        self._out.write({"values": self.values.tolist()})

    def poll(self, record: bytearray) -> bool:
        """Read the newest message if it is new."""
        message = self._in.read()
        if message is None:
            return False
        self.values[:] = message.values
        return True

    def close(self) -> None:
        """Give the claim back."""
        self._in.close()
        self._out.close()


_SIZE = 2 * COUNT
_PAGE = 4096


class LockedMemory(Transport):
    """One area of memory and one lock for each direction.

    Args:
        side: "A" or "B".
        file: The areas: A's in the first page, B's in the second.
        names: The locks: A's, B's.
    """

    def __init__(self, side: str, file: Path, names: tuple[str, str]) -> None:
        super().__init__()
        descriptor = os.open(file, os.O_RDWR | os.O_CREAT, 0o600)
        os.ftruncate(descriptor, 2 * _PAGE)
        self._memory = mmap.mmap(descriptor, 2 * _PAGE)
        os.close(descriptor)
        import posix_ipc

        me = side == "B"
        view = memoryview(self._memory)
        areas = [view[:_SIZE], view[_PAGE : _PAGE + _SIZE]]
        areas[me][:] = b"\xff" * _SIZE  # nothing that a first message could be equal to
        locks = [posix_ipc.Semaphore(name, posix_ipc.O_CREAT, mode=0o600, initial_value=1) for name in names]
        self._out, self._in = areas[me], areas[not me]
        self._out_lock, self._in_lock = locks[me], locks[not me]
        self._seen = b"\xff" * _SIZE

    def send(self, record: bytearray) -> None:
        """Copy the record in, under the lock."""
        self._out_lock.acquire()
        self._out[:] = record
        self._out_lock.release()

    def poll(self, record: bytearray) -> bool:
        """Copy it out, under the lock; it is new if it differs."""
        self._in_lock.acquire()
        found = self._in.tobytes()
        self._in_lock.release()
        if found == self._seen:
            return False
        self._seen = found
        record[:] = found
        return True


def channel(side: str, arguments: list[str]) -> None:
    """Serve records of bytes; arguments: the folder of the objects, and the names of two semaphores."""
    folder, *names = arguments
    serve(side, Channels(side, Path(folder), (names[0], names[1])))


def typed_channel(side: str, arguments: list[str]) -> None:
    """The same with typed messages on side B."""
    if side == "A":
        channel(side, arguments)
    else:
        serve(side, TypedChannels(Path(arguments[0])))


def semaphore(side: str, arguments: list[str]) -> None:
    """Serve locked memory; arguments: the file, and the names of two semaphores."""
    file, *names = arguments
    serve(side, LockedMemory(side, Path(file), (names[0], names[1])))
