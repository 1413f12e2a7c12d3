"""Memories and semaphores of classic topics, which any program may have made."""

from __future__ import annotations

import struct
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from rosplc.config.plans import ClassicPlan
from rosplc.doctor.finding import Finding
from rosplc.doctor.kinds import kind
from rosplc.doctor.words import listed, remove, user_name

__all__ = ["create_or_open", "locks", "sizes"]

_LOOKS = 12
_PAUSE_S = 0.05
_SIZES = {32: 64, 16: 32}
"""Bytes of glibc's sem_t → word size of the programs that made it."""


def locks(
    directory: Path, plans: Sequence[ClassicPlan], bits: int, *, sleep: Callable[[float], None] = time.sleep
) -> Iterator[Finding]:
    """Judge the semaphores.

    Args:
        directory: Where the C library keeps them.
        plans: The configuration's classic topics.
        bits: Word size of the programs that a bridge shares them with: its own.
        sleep: Waits for so many seconds.
    """
    found = {plan.semaphore: directory / f"sem.{plan.semaphore}" for plan in plans if plan.semaphore}
    present = {name: path for name, path in sorted(found.items()) if path.is_file()}
    other = {name: size for name, path in present.items() if (size := path.stat().st_size) != bits // 2}
    for name, size in other.items():
        made = f"{_SIZES[size]}-bit programs" if size in _SIZES else "no C library that is known"
        what = f"sem.{name} was made by {made} ({size} bytes), and a bridge here has {bits} bits"
        yield kind("DOC215").found(what)
    if not other:
        yield kind("DOC215").fine("semaphores have this machine's word size")
    same = {name: path for name, path in present.items() if name not in other}
    taken, most = set(same), dict.fromkeys(same, 0)
    for look in range(_LOOKS):
        for name, path in same.items():
            if value := _value(path):
                taken.discard(name)
                most[name] = max(most[name], value)
        if not taken:
            break
        if look < _LOOKS - 1:
            sleep(_PAUSE_S)
    if taken:
        what = f"taken at all of {_LOOKS} looks: {listed(sorted(taken))}"
        yield kind("DOC214").found(what, command=remove(same[name] for name in sorted(taken)))
    else:
        yield kind("DOC214").fine("no lock of a classic topic stays taken")
    if many := sorted(name for name, value in most.items() if value > 1):
        yield kind("DOC216").found(f"more than one may enter: {listed(f'{n} ({most[n]})' for n in many)}")
    else:
        yield kind("DOC216").fine("no semaphore lets in more than one")


def _value(path: Path) -> int:
    """Return how many could enter now; 0 if it is gone."""
    try:
        content = path.read_bytes()
    except OSError:
        return 0
    if len(content) == 32:
        return int(struct.unpack_from("=I", content)[0])
    # 32-bit programs keep a flag for waiters in the lowest bit.
    return int(struct.unpack_from("=I", content)[0]) >> 1 if len(content) == 16 else 0


def sizes(directory: Path, plans: Sequence[tuple[str, ClassicPlan, int]]) -> Iterator[Finding]:
    """Judge the memories' sizes.

    Args:
        directory: Where they lie.
        plans: Topic, plan and bytes of its record.
    """
    small = False
    for topic, plan, record in plans:
        path = directory / plan.name
        if path.is_file() and (size := path.stat().st_size) < record:
            small = True
            what = f"{topic}: {path} has {size} bytes, the record {record}"
            yield kind("DOC217").found(what, command=remove([path]))
    if not small:
        yield kind("DOC217").fine("memories of classic topics are large enough")


def create_or_open(
    root: Path, directory: Path, plans: Sequence[ClassicPlan], uids: Sequence[int]
) -> Iterator[Finding]:
    """Judge whether the kernel lets a runtime create-or-open what another user has made.

    Args:
        root: Where ``proc`` stands.
        directory: Where memories and semaphores lie.
        plans: The configuration's classic topics.
        uids: Users of PLC runtimes.
    """
    try:
        protected = int((root / "proc/sys/fs/protected_regular").read_text(encoding="ascii"))
    except (OSError, ValueError):
        protected = 0
    folder = directory.stat()
    names = {plan.name for plan in plans} | {f"sem.{plan.semaphore}" for plan in plans if plan.semaphore}
    if protected and folder.st_mode & 0o1002 == 0o1002:
        for uid in uids:
            closed = [
                name
                for name in sorted(names)
                if (directory / name).is_file()
                and (directory / name).stat().st_uid not in (uid, folder.st_uid)
            ]
            if closed:
                owner = user_name((directory / closed[0]).stat().st_uid)
                what = f"{owner} owns {listed(closed)}, the runtime runs as {user_name(uid)}"
                yield kind("DOC218").found(f"fs.protected_regular is {protected}; {what}")
                return
    yield kind("DOC218").fine("the kernel lets the runtime create-or-open classic objects")
