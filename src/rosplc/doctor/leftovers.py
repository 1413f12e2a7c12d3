"""Objects as files: left behind, damaged, somebody else's, open to everybody; and those of classic topics."""

from __future__ import annotations

import shlex
import stat
import time
from collections.abc import Callable, Collection, Iterator, Sequence
from pathlib import Path

from rosplc.config.plans import ClassicPlan
from rosplc.doctor.finding import Finding, Level, user_name
from rosplc.doctor.kinds import fine, found, judged
from rosplc.doctor.objects import Objects, Seen, lock_of
from rosplc.harmless import listed, plural
from rosplc.monitor.classic import semaphore_value
from rosplc.shm.constants import STATE_RETIRED
from rosplc.shm.names import file_name

_HIDDEN = ("SHM102", "SHM123")
"""Errors that say nothing about an object: no right, or no descriptor, to look at it."""


def concerned(objects: Objects, prefix: str | None) -> tuple[Seen, ...]:
    """Return the objects to judge: of one prefix, or, without one, all that are a bridge's.

    Any program may have a file whose name looks like an object's. Without a prefix it counts only if it is
    sound, has the default prefix, or has a lock file beside it.
    """
    if prefix is not None:
        return tuple(seen for seen in objects.objects if seen.prefix == prefix)
    return tuple(
        seen
        for seen in objects.objects
        if seen.error is None or seen.prefix == "rosplc" or lock_of(seen.path) in objects.locks
    )


def leftovers(objects: Objects, prefix: str | None, configured: Collection[Path] | None) -> Iterator[Finding]:
    """Report objects that no bridge holds; without a configuration, ``configured`` (paths) is None."""
    seen = [each for each in concerned(objects, prefix) if each.error is None and not each.live]
    unknown = [each for each in seen if each.held is None]
    idle = [each for each in seen if each.held is False]
    retired = [each for each in idle if each.snapshot is not None and each.snapshot.state == STATE_RETIRED]
    strangers = [] if configured is None else [each for each in idle if each.path not in configured]
    left = [each for each in idle if each not in retired and each not in strangers]
    if unknown:
        what = plural(len(unknown), "object")
        yield found("DOC003", f"cannot determine which process uses {what}: /proc/locks cannot be read")
    what = f"no running bridge uses {plural(len(left), 'object')}: {_names(left)}" if left else ""
    yield judged("DOC205", what, "every object belongs to a running bridge", command=_clean(left, objects))
    what = f"neither in use nor in the configuration: {_names(strangers)}" if strangers else ""
    well = "all objects belong to topics in the configuration"
    yield judged("DOC206", what, well, command=_clean(strangers, objects))
    yield judged("DOC208", f"retired: {_names(retired)}" if retired else "", "no retired objects are left")
    # A bridge that runs may be making a temporary at this moment.
    busy = {each.path.name for each in objects.objects if each.live}
    gone = [
        name
        for path in objects.temporaries
        if (name := file_name(path.name)) and name.prefix == (prefix or name.prefix) and name.item not in busy
    ]
    what = f"{plural(len(gone), 'temporary file')} of a killed bridge" if gone else ""
    command = f"rosplc clean --prefix {gone[0].prefix}" if gone else ""
    yield judged("DOC207", what, "no temporary files are left", command=command)
    without = [
        each
        for each in concerned(objects, prefix)
        if each.bridge_beats and not each.held and lock_of(each.path) not in objects.locks
    ]
    what = f"a bridge is running without a lock file: {_names(without)}" if without else ""
    yield judged("DOC213", what, "every object of a running bridge has its lock file")


def _clean(gone: Sequence[Seen], objects: Objects, *, root: bool = False) -> str:
    """Return the commands that remove objects: by prefix, by topic where a prefix has others, too."""
    paths = {seen.path for seen in gone}
    commands = []
    for prefix in sorted({seen.prefix for seen in gone}):
        topics = list(dict.fromkeys(seen.topic for seen in gone if seen.prefix == prefix))
        whole = all(seen.path in paths for seen in objects.objects if seen.prefix == prefix)
        chosen = "" if whole else "".join(f" --topic {shlex.quote(topic)}" for topic in topics)
        commands.append(f"{'sudo ' if root else ''}rosplc clean --prefix {prefix}{chosen}")
    return " && ".join(commands)


def _names(seen: Sequence[Seen]) -> str:
    return listed(
        f"{each.label} of bridge {each.description.bridge}" if each.description else each.label
        for each in seen
    )


def soundness(objects: Objects, prefix: str | None) -> Iterator[Finding]:
    """Report which objects are damaged, are no objects, or may not be looked at."""
    # Without a configuration it is unknown whether a bridge of this machine needs these names.
    level = Level.WARNING if prefix is None else None
    codes = set()
    for seen in concerned(objects, prefix):
        if (error := seen.error) is None:
            continue
        codes.add("" if error.code in _HIDDEN else error.code)
        what = f"{seen.path}: {error.what} [{error.code}]"
        if error.code in _HIDDEN:
            owner = user_name(seen.status.st_uid)
            what = f"{seen.path}, which belongs to {owner}, cannot be examined: {error.what}"
            yield found("DOC003", what)
        elif error.code == "SHM121":
            command = f"rm{'dir' if stat.S_ISDIR(seen.status.st_mode) else ''} {seen.path}"
            yield found("DOC212", what, command=command, level=level)
        else:
            yield found("DOC211", what, error.remedy, level=level)
    if "SHM121" not in codes:
        yield fine("DOC212", "plain files at the objects' names")
    if not codes - {"", "SHM121"}:
        yield fine("DOC211", "no object is damaged")


def ownership(
    objects: Objects, prefix: str | None, owners: Collection[int], *, root: bool
) -> Iterator[Finding]:
    """Report which objects are another user's, and which are open to all users.

    ``owners`` are users whose objects a bridge of this user may take over; ``root``: this user is root.
    """
    files = [seen for seen in concerned(objects, prefix) if stat.S_ISREG(seen.status.st_mode)]
    others = [] if prefix is None else [s for s in files if s.status.st_uid not in owners and not s.live]
    names = listed(sorted({user_name(seen.status.st_uid) for seen in others}))
    what = f"owned by {names}: {listed(seen.label for seen in others)}" if others else ""
    command = _clean(others, objects, root=not root)
    yield judged("DOC209", what, "no object of another user blocks the bridge", command=command)
    open_ = {seen.label: bits for seen in files if (bits := stat.S_IMODE(seen.status.st_mode) & 0o006)}
    who = "change" if max(open_.values(), default=0) & 0o002 else "read"
    what = f"all users can {who} {plural(len(open_), 'object')}: {listed(open_)}" if open_ else ""
    remedy = "Write `shm: {mode: '0660', group: GROUP}` in the configuration, and restart the bridge."
    yield judged("DOC210", what, "no object is accessible to all users", remedy)


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
        made = f"{_SIZES[size]}-bit programs" if size in _SIZES else "an unknown C library"
        what = f"sem.{name} was created by {made} ({size} bytes), but the bridge is {bits}-bit"
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
    what = f"locked at each of {_LOOKS} checks: {listed(taken)}" if taken else ""
    command = _remove(*(same[name] for name in taken)) if taken else ""
    yield judged("DOC214", what, "no semaphore of a classic topic stays locked", command=command)
    many = [f"{name} ({value})" for name, value in most.items() if value > 1]
    what = f"semaphores that admit more than one process: {listed(many)}" if many else ""
    yield judged("DOC216", what, "no semaphore admits more than one process")


def _remove(*paths: Path) -> str:
    return f"rm {' '.join(shlex.quote(str(path)) for path in paths)}"


def sizes(directory: Path, plans: Sequence[tuple[str, ClassicPlan, int]]) -> Iterator[Finding]:
    """Judge the memories' sizes; ``plans`` has topic, plan and bytes of its record."""
    small = []
    for topic, plan, record in plans:
        path = directory / plan.name
        if path.is_file() and (size := path.stat().st_size) < record:
            what = f"{topic}: {path} has {size} bytes, but the record needs {record}"
            small.append(found("DOC217", what, command=_remove(path)))
    yield from small or [fine("DOC217", "the shared memory of classic topics is large enough")]


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
                f"{user_name(owners[closed[0]])} owns {listed(closed)}; the runtime runs as {user_name(uid)}"
            )
            seen = f"fs.protected_regular is {protected}; {who}"
    yield judged("DOC218", seen, "the kernel lets the runtime open classic objects with O_CREAT")
