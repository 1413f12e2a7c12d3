"""Objects as files: unused, damaged, of another user, or open to all users; and those of classic topics."""

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
"""Errors that do not concern the object: a missing permission or descriptor to examine it."""


def concerned(objects: Objects, prefix: str | None) -> tuple[Seen, ...]:
    """Return the objects to judge: those of one prefix or, without a prefix, all that belong to a bridge.

    Any program may have a file whose name looks like an object's. Without a prefix, such a file counts
    only if it is valid, has the default prefix, or has a lock file beside it.
    """
    if prefix is not None:
        return tuple(seen for seen in objects.objects if seen.prefix == prefix)
    return tuple(
        seen
        for seen in objects.objects
        if seen.error is None or seen.prefix == "rosplc" or lock_of(seen.path) in objects.locks
    )


def leftovers(objects: Objects, prefix: str | None, configured: Collection[Path] | None) -> Iterator[Finding]:
    """Report objects that no bridge holds; ``configured`` (paths) is None if there is no configuration."""
    seen = [each for each in concerned(objects, prefix) if each.error is None and not each.live]
    unknown = [each for each in seen if each.held is None]
    idle = [each for each in seen if each.held is False]
    retired = [each for each in idle if each.snapshot is not None and each.snapshot.state == STATE_RETIRED]
    strangers = [] if configured is None else [each for each in idle if each.path not in configured]
    left = [each for each in idle if each not in retired and each not in strangers]
    if unknown:
        what = plural(len(unknown), "object")
        yield found("DOC003", f"cannot determine which process uses {what}: /proc/locks cannot be read")
    what = f"these objects are not used by a running bridge: {_names(left)}" if left else ""
    yield judged("DOC205", what, "every object belongs to a running bridge", command=_clean(left, objects))
    what = f"these unused objects are not in the configuration: {_names(strangers)}" if strangers else ""
    yield judged("DOC206", what, "all objects are in the configuration", command=_clean(strangers, objects))
    what = f"retired objects: {_names(retired)}" if retired else ""
    yield judged("DOC208", what, "there are no retired objects")
    # A bridge that runs may be making a temporary at this moment.
    busy = {each.path.name for each in objects.objects if each.live}
    gone = [
        name
        for path in objects.temporaries
        if (name := file_name(path.name)) and name.prefix == (prefix or name.prefix) and name.item not in busy
    ]
    what = f"a killed bridge left {plural(len(gone), 'temporary file')} behind" if gone else ""
    command = f"rosplc clean --prefix {gone[0].prefix}" if gone else ""
    yield judged("DOC207", what, "there are no temporary files", command=command)
    without = [
        each
        for each in concerned(objects, prefix)
        if each.bridge_beats and not each.held and lock_of(each.path) not in objects.locks
    ]
    what = f"a running bridge has no lock files for {_names(without)}" if without else ""
    yield judged("DOC213", what, "every object of a running bridge has a lock file")


def _clean(gone: Sequence[Seen], objects: Objects, *, root: bool = False) -> str:
    """Return the commands that remove objects: by prefix, or by topic if the prefix has other objects."""
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
    """Report which objects are damaged, are not objects, or cannot be examined for lack of permission."""
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
        yield fine("DOC212", "all objects are plain files")
    if not codes - {"", "SHM121"}:
        yield fine("DOC211", "no object is damaged")


def ownership(
    objects: Objects, prefix: str | None, owners: Collection[int], *, root: bool
) -> Iterator[Finding]:
    """Report which objects belong to another user, and which are accessible to all users.

    ``owners`` are users whose objects a bridge of this user may take over; ``root``: this user is root.
    """
    files = [seen for seen in concerned(objects, prefix) if stat.S_ISREG(seen.status.st_mode)]
    others = [] if prefix is None else [s for s in files if s.status.st_uid not in owners and not s.live]
    names = listed(sorted({user_name(seen.status.st_uid) for seen in others}))
    what = f"these objects belong to {names}: {listed(seen.label for seen in others)}" if others else ""
    command = _clean(others, objects, root=not root)
    yield judged("DOC209", what, "no object of another user blocks the bridge", command=command)
    open_ = {seen.label: bits for seen in files if (bits := stat.S_IMODE(seen.status.st_mode) & 0o006)}
    who = "change" if max(open_.values(), default=0) & 0o002 else "read"
    what = f"all users can {who} {plural(len(open_), 'object')}: {listed(open_)}" if open_ else ""
    remedy = "Set `shm: {mode: '0660', group: GROUP}` in the configuration, and restart the bridge."
    yield judged("DOC210", what, "no object is accessible to all users", remedy)


_LOOKS = 12
_PAUSE_S = 0.05
_SIZES = {32: 64, 16: 32}  # bytes of glibc's sem_t → word size of the programs that made it


def locks(
    directory: Path, plans: Sequence[ClassicPlan], bits: int, *, sleep: Callable[[float], None] = time.sleep
) -> Iterator[Finding]:
    """Judge the semaphores of the configuration's classic topics.

    ``bits`` is the word size of the bridge, which the programs that use its semaphores must share.
    """
    paths = {plan.semaphore: directory / f"sem.{plan.semaphore}" for plan in plans if plan.semaphore}
    present = {name: path for name, path in sorted(paths.items()) if path.is_file()}
    other = {name: size for name, path in present.items() if (size := path.stat().st_size) != bits // 2}
    for name, size in other.items():
        made = f"a {_SIZES[size]}-bit program" if size in _SIZES else "an unknown C library"
        what = f"sem.{name} was created by {made} ({size} bytes), but the bridge is {bits}-bit"
        yield found("DOC215", what)
    if not other:
        yield fine("DOC215", "all semaphores have the bridge's word size")
    same = {name: path for name, path in present.items() if name not in other}
    most = dict.fromkeys(same, 0)
    for look in range(_LOOKS):
        most = {name: max(value, semaphore_value(same[name]) or 0) for name, value in most.items()}
        if all(most.values()):
            break
        if look < _LOOKS - 1:
            sleep(_PAUSE_S)
    taken = [name for name, value in most.items() if not value]
    what = f"these semaphores were locked at each of {_LOOKS} checks: {listed(taken)}" if taken else ""
    command = _remove(*(same[name] for name in taken)) if taken else ""
    yield judged("DOC214", what, "no semaphore of a classic topic stays locked", command=command)
    many = [f"{name} ({value})" for name, value in most.items() if value > 1]
    what = f"these semaphores admit more than one process: {listed(many)}" if many else ""
    yield judged("DOC216", what, "no semaphore admits more than one process")


def _remove(*paths: Path) -> str:
    return f"rm {' '.join(shlex.quote(str(path)) for path in paths)}"


def sizes(directory: Path, plans: Sequence[tuple[str, ClassicPlan, int]]) -> Iterator[Finding]:
    """Judge the sizes of classic memory; ``plans`` has topic, plan and record size in bytes."""
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
    """Judge whether the kernel lets a runtime, one of ``uids``, open another user's objects with O_CREAT."""
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
            seen = (
                f"{user_name(uid)}, the user of the runtime, cannot open {listed(closed)} with O_CREAT: "
                f"the owner is {user_name(owners[closed[0]])}, and fs.protected_regular is {protected}"
            )
    yield judged("DOC218", seen, "the kernel lets the runtime open classic objects with O_CREAT")
