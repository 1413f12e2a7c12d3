"""rosplc's channel from Python: records of bytes, as :mod:`rosplc.shm` carries them.

A owns both objects, as a bridge does; B attaches to them, as any program beside it may. The channel
has no bell: who sleeps does so on a POSIX semaphore beside it, one for each direction.
"""

from __future__ import annotations

import functools
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from rosplc.bench.peers.exchange import COUNT, Transport, serve
from rosplc.errors import ChannelError
from rosplc.shm import Attached, Description, Direction, Namespace, OwnedChannel, attach

if TYPE_CHECKING:
    import posix_ipc

__all__ = ["ANSWER", "QUESTION", "Channels", "describe", "main"]

QUESTION, ANSWER = "/question", "/answer"
_WAIT = 20.0


def describe(topic: str, direction: Direction) -> Description:
    """Return the self-description of one of the two objects, which hold bytes."""
    return Description(
        topic,
        "std_msgs/msg/UInt16MultiArray",
        "jazzy",
        direction,
        {},
        "0" * 16,
        "bench",
        "uint16[100] values",
    )


class Channels(Transport):
    """Both directions.

    Args:
        side: "A" or "B".
        folder: Where the objects lie.
        names: The bells: one that A rings, one that B rings.
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
        self._bells = bells(side, names)

    def send(self) -> None:
        """Publish the record."""
        self.writer.publish(self.record)

    def sender(self) -> Callable[[], object]:
        """Return the publication itself."""
        return functools.partial(self.writer.publish, self.record)

    def attempt(self) -> bool:
        """Take the newest message if it is new."""
        return self.reader.latest(self.record) is not None

    def spin(self) -> None:
        """Take the next message as soon as it is there."""
        latest, record = self.reader.latest, self.record
        while latest(record) is None:
            pass

    def ring(self) -> None:
        """Post the other side's semaphore."""
        self._bells[0].release()

    def sleep(self) -> None:
        """Wait for one's own."""
        self._bells[1].acquire()

    def close(self) -> None:
        """Give the claims back."""
        for each in self._open:
            each.close()


def bells(side: str, names: tuple[str, str]) -> tuple[posix_ipc.Semaphore, posix_ipc.Semaphore]:
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


def main(side: str, arguments: list[str]) -> None:
    """Arguments: the folder of the objects, and the names of two semaphores."""
    folder, *names = arguments
    serve(side, Channels(side, Path(folder), (names[0], names[1])))
