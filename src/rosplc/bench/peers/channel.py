"""rosplc's channel from Python: records of bytes, as :mod:`rosplc.shm` carries them.

A owns both objects, as a bridge does; B attaches to them, as any program beside it may. The channel
has no bell: who sleeps does so on a POSIX semaphore beside it, one for each direction.
"""

from __future__ import annotations

import time
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

from rosplc.bench.contenders.registers import ANSWER, QUESTION, describe
from rosplc.bench.peers.exchange import COUNT, Operations, Transport, serve
from rosplc.errors import ChannelError
from rosplc.shm import Attached, Direction, Namespace, OwnedChannel, attach

if TYPE_CHECKING:
    import posix_ipc

__all__ = ["Channels", "main"]

_WAIT = 20.0


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
        # Only who sleeps needs them; without the package everything else can be measured.
        self._bells = bells(side, names) if find_spec("posix_ipc") else None

    def operations(self) -> Operations:
        """Return publication and taking themselves, and the semaphores' own methods."""
        if self._bells is None:
            return Operations(self.writer.publish, self.reader.update, self.ring, self.sleep)
        ring, sleep = self._bells
        return Operations(self.writer.publish, self.reader.update, ring.release, sleep.acquire)

    def sleep(self) -> None:
        """Refuse: nobody can ring."""
        raise SystemExit("the Python package posix_ipc is missing")

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
