"""B through :func:`rosplc.attach`: messages with fields instead of bytes, as scripts use it."""

from __future__ import annotations

from pathlib import Path

import rosplc
from rosplc.bench.contenders.registers import ANSWER, QUESTION
from rosplc.bench.peers.channel import Channels
from rosplc.bench.peers.exchange import Transport, serve

__all__ = ["TypedChannels", "main"]

_WAIT = 20.0


class TypedChannels(Transport):
    """B: reads and writes messages.

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

    def attempt(self, record: bytearray) -> bool:
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


def main(side: str, arguments: list[str]) -> None:
    """Arguments: the folder of the objects, and the names of two semaphores."""
    folder, *names = arguments
    if side == "B":
        serve(side, TypedChannels(Path(folder)))
    else:
        serve(side, Channels(side, Path(folder), (names[0], names[1])))
