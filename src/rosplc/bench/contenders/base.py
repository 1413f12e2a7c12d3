"""What a contender is, and how its two processes are started."""

from __future__ import annotations

import contextlib
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from rosplc.bench.arrangements import Way
from rosplc.bench.pair import Pair
from rosplc.bench.process import Side
from rosplc.errors import SetupError

__all__ = ["BLOCKS", "CYCLE", "RINGS", "SPINS", "Contender", "Place", "ready", "start_pair"]

SPINS = Way("spin", "spins")
BLOCKS = Way("block", "blocks in the socket")
RINGS = Way("block", "sleeps on a named semaphore beside it")
CYCLE = Way("cycle", "looks once per period")

_START_SECONDS = 60.0


@dataclass(frozen=True)
class Place:
    """Where one pair puts what it shares.

    Attributes:
        folder: A folder in /dev/shm of this pair's own.
        names: Names for POSIX semaphores, which know no folders: A's, B's.
        cache: Where compiled programs are kept.
    """

    folder: Path
    names: tuple[str, str]
    cache: Path

    @classmethod
    def under(cls, scratch: Path, label: str, cache: Path) -> Place:
        """Make a place in a run's folder, whose own name is unique on this machine."""
        folder = Path(tempfile.mkdtemp(prefix=f"{label}-", dir=scratch))
        name = f"/{scratch.name}.{folder.name}"
        return cls(folder, (f"{name}.a", f"{name}.b"), cache)

    def remove_semaphores(self) -> None:
        """Take the semaphores' names away; who has them open keeps them."""
        for name in self.names:
            with contextlib.suppress(FileNotFoundError):
                Path(f"/dev/shm/sem.{name[1:]}").unlink()


@dataclass(frozen=True)
class Contender:
    """One way to exchange data.

    Attributes:
        name: What ``--only`` calls it.
        title: What tables call it.
        about: What exactly was measured, one sentence.
        ways: How it waits, by arrangement; what is missing cannot be done with it.
        start: Starts both processes. Raises Missing if the machine lacks something, SetupError if it fails.
        needs: Arrangement → the Python package that waiting in it takes, beyond what ``start`` takes.
    """

    name: str
    title: str
    about: str
    ways: Mapping[str, Way]
    start: Callable[[Place], Pair]
    needs: Mapping[str, str] = field(default_factory=dict)


def ready(side: Side) -> str:
    """Wait until a side has started; return what it says beyond that.

    Raises:
        SetupError: SYS002, it did not start.
    """
    word, _, rest = side.hear(_START_SECONDS).partition(" ")
    if word != "ready":
        raise SetupError("SYS002", f"{word} {rest}".strip())
    return rest


def start_pair(
    name: str,
    place: Place,
    *,
    a: Sequence[str],
    b: Sequence[str],
    order: str = "AB",
    pass_on: bool = False,
) -> Pair:
    """Start two programs one after the other and wait for both.

    Args:
        name: What errors call them.
        place: Where they share.
        a: A's command.
        b: B's command.
        order: "AB" or "BA": who is first.
        pass_on: Whether the second gets as a further argument what the first said.
    """
    sides: dict[str, Side] = {}
    commands = {"A": list(a), "B": list(b)}
    extra: list[str] = []
    try:
        for letter in order:
            sides[letter] = Side(f"{name}, side {letter}", commands[letter] + extra)
            said = ready(sides[letter])
            extra = [said] if pass_on else []
    except BaseException:
        for side in sides.values():
            side.kill()
            side.close()
        place.remove_semaphores()
        raise
    # Both have them open: without names nothing can be left behind, whatever happens from here on.
    place.remove_semaphores()
    return Pair(sides["A"], sides["B"], place.remove_semaphores)


def python_side(module: str, side: str, *arguments: object) -> list[str]:
    """Return the command of a peer in Python."""
    return [sys.executable, "-m", "rosplc.bench.peers", module, side, *map(str, arguments)]
