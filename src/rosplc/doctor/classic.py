"""Memories and semaphores of classic topics, which any program may have made."""

from __future__ import annotations

import shlex
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from rosplc.config.plans import ClassicPlan
from rosplc.doctor.finding import Finding, listed, user_name
from rosplc.doctor.kinds import fine, found, judged
from rosplc.monitor.classic import semaphore_value

_LOOKS = 12
_PAUSE_S = 0.05
_SIZES = {32: 64, 16: 32}  # bytes of glibc's sem_t → word size of the programs that made it


def locks(
    directory: Path, plans: Sequence[ClassicPlan], bits: int, *, sleep: Callable[[float], None] = time.sleep
) -> Iterator[Finding]:
    """Judge the semaphores of the configuration's classic topics.

    ``bits`` is the word size of the programs that a bridge shares them with: its own.
    """
    paths = {plan.semaphore: directory / f"sem.{plan.semaphore}" for plan in plans if plan.semaphore}
    present = {name: path for name, path in sorted(paths.items()) if path.is_file()}
    other = {name: size for name, path in present.items() if (size := path.stat().st_size) != bits // 2}
    for name, size in other.items():
        made = f"{_SIZES[size]}-bit programs" if size in _SIZES else "no C library that is known"
        what = f"sem.{name} was made by {made} ({size} bytes), and a bridge here has {bits} bits"
        yield found("DOC215", what)
    if not other:
        yield fine("DOC215", "semaphores have this machine's word size")
    same = {name: path for name, path in present.items() if name not in other}
    most = dict.fromkeys(same, 0)
    for look in range(_LOOKS):
        most = {name: max(value, semaphore_value(same[name]) or 0) for name, value in most.items()}
        if all(most.values()):
            break
        if look < _LOOKS - 1:
            sleep(_PAUSE_S)
    taken = [name for name, value in most.items() if not value]
    what = f"taken at all of {_LOOKS} looks: {listed(taken)}" if taken else ""
    command = _remove(*(same[name] for name in taken)) if taken else ""
    yield judged("DOC214", what, "no lock of a classic topic stays taken", command=command)
    many = [f"{name} ({value})" for name, value in most.items() if value > 1]
    what = f"more than one may enter: {listed(many)}" if many else ""
    yield judged("DOC216", what, "no semaphore lets in more than one")


def _remove(*paths: Path) -> str:
    return f"rm {' '.join(shlex.quote(str(path)) for path in paths)}"


def sizes(directory: Path, plans: Sequence[tuple[str, ClassicPlan, int]]) -> Iterator[Finding]:
    """Judge the memories' sizes; ``plans`` has topic, plan and bytes of its record."""
    small = []
    for topic, plan, record in plans:
        path = directory / plan.name
        if path.is_file() and (size := path.stat().st_size) < record:
            what = f"{topic}: {path} has {size} bytes, the record {record}"
            small.append(found("DOC217", what, command=_remove(path)))
    yield from small or [fine("DOC217", "memories of classic topics are large enough")]


def create_or_open(
    root: Path, directory: Path, plans: Sequence[ClassicPlan], uids: Sequence[int]
) -> Iterator[Finding]:
    """Judge whether the kernel lets a runtime, one of ``uids``, create-or-open what another user has made."""
    try:
        protected = int((root / "proc/sys/fs/protected_regular").read_text(encoding="ascii"))
    except (OSError, ValueError):
        protected = 0
    folder, seen = directory.stat(), ""
    names = {plan.name for plan in plans} | {f"sem.{plan.semaphore}" for plan in plans if plan.semaphore}
    owners = {
        name: (directory / name).stat().st_uid for name in sorted(names) if (directory / name).is_file()
    }
    for uid in uids if protected and folder.st_mode & 0o1002 == 0o1002 else ():
        closed = [name for name, owner in owners.items() if owner not in (uid, folder.st_uid)]
        if closed and not seen:
            who = (
                f"{user_name(owners[closed[0]])} owns {listed(closed)}, the runtime runs as {user_name(uid)}"
            )
            seen = f"fs.protected_regular is {protected}; {who}"
    yield judged("DOC218", seen, "the kernel lets the runtime create-or-open classic objects")
