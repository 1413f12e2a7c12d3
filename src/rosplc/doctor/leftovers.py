"""Objects as files: left behind, damaged, somebody else's, open to everybody."""

from __future__ import annotations

import shlex
import stat
from collections.abc import Collection, Iterator, Sequence
from pathlib import Path

from rosplc.doctor.finding import Finding, Level
from rosplc.doctor.kinds import kind
from rosplc.doctor.objects import Objects, Seen
from rosplc.doctor.words import listed, user_name
from rosplc.harmless import plural
from rosplc.shm.constants import STATE_RETIRED

__all__ = ["concerned", "leftovers", "ownership", "soundness"]

_HIDDEN = ("SHM102", "SHM123")
"""Errors that say nothing about an object: no right, or no descriptor, to look at it."""


def concerned(objects: Objects, prefix: str | None) -> tuple[Seen, ...]:
    """Return the objects to judge: of one prefix, or, without one, whatever is a bridge's.

    Any program may have a file whose name looks like an object's. Without a prefix it counts only if
    it is sound, has the default prefix, or has a lock file beside it.
    """
    if prefix is not None:
        return tuple(seen for seen in objects.objects if seen.prefix == prefix)
    return tuple(
        seen
        for seen in objects.objects
        if seen.error is None or seen.prefix == "rosplc" or _lock(seen.path) in objects.locks
    )


def _lock(path: Path) -> Path:
    return path.parent / path.name.replace(".t.", ".l.", 1)


def leftovers(objects: Objects, prefix: str | None, configured: Collection[Path] | None) -> Iterator[Finding]:
    """Tell what nobody holds.

    Args:
        objects: What was found.
        prefix: The configuration's; None without one.
        configured: The paths of the configuration's objects; None without one.
    """
    seen = [each for each in concerned(objects, prefix) if each.error is None and not each.live]
    unknown = [each for each in seen if each.held is None]
    idle = [each for each in seen if each.held is False]
    retired = [each for each in idle if each.snapshot is not None and each.snapshot.state == STATE_RETIRED]
    strangers = [] if configured is None else [each for each in idle if each.path not in configured]
    left = [each for each in idle if each not in retired and each not in strangers]
    if unknown:
        text = f"not visible: who holds {plural(len(unknown), 'object')}, since /proc/locks cannot be read"
        yield kind("DOC003").found(text)
    if left:
        what = f"no bridge holds {plural(len(left), 'object')}: {listed(map(_from, left))}"
        yield kind("DOC205").found(what, command=_clean(left, objects))
    else:
        yield kind("DOC205").fine("a bridge holds every object that is there")
    if strangers:
        what = f"not in the configuration, and held by nobody: {listed(map(_from, strangers))}"
        yield kind("DOC206").found(what, command=_clean(strangers, objects))
    else:
        yield kind("DOC206").fine("no object is left of topics that the configuration does not have")
    if retired:
        yield kind("DOC208").found(f"retired: {listed(map(_from, retired))}")
    else:
        yield kind("DOC208").fine("no retired object is left")
    yield from _temporaries(objects, prefix)
    yield from _lock_files(objects, prefix)


def _clean(gone: Sequence[Seen], objects: Objects, *, root: bool = False) -> str:
    """Return the commands that remove objects: by prefix, by topic where a prefix has others, too."""
    paths = {seen.path for seen in gone}
    commands = []
    for prefix in sorted({seen.prefix for seen in gone}):
        topics = [seen.topic for seen in gone if seen.prefix == prefix]
        whole = all(seen.path in paths for seen in objects.objects if seen.prefix == prefix)
        chosen = "" if whole else "".join(f" --topic {shlex.quote(topic)}" for topic in topics)
        commands.append(f"{'sudo ' if root else ''}rosplc clean --prefix {prefix}{chosen}")
    return " && ".join(commands)


def _from(seen: Seen) -> str:
    bridge = f" of bridge {seen.description.bridge}" if seen.description else ""
    return f"{seen.topic}{bridge}"


def _temporaries(objects: Objects, prefix: str | None) -> Iterator[Finding]:
    # A bridge that runs may be making one at this moment.
    busy = {_lock(seen.path).name.partition(".l.")[2] for seen in objects.objects if seen.live}
    left = [
        path
        for path in objects.temporaries
        if prefix is None or path.name.startswith(f"{prefix}.n.")
        if path.name.partition(".n.")[2].rpartition(".")[0] not in busy
    ]
    if left:
        what = f"{plural(len(left), 'temporary')} of a bridge that was killed"
        yield kind("DOC207").found(what, command=f"rosplc clean --prefix {left[0].name.partition('.n.')[0]}")
    else:
        yield kind("DOC207").fine("no temporaries are left")


def _lock_files(objects: Objects, prefix: str | None) -> Iterator[Finding]:
    without = [
        seen
        for seen in concerned(objects, prefix)
        if seen.bridge_beats and not seen.held and _lock(seen.path) not in objects.locks
    ]
    if without:
        yield kind("DOC213").found(
            f"a bridge beats, but there is no lock file: {listed(map(_from, without))}"
        )
    else:
        yield kind("DOC213").fine("every object that a bridge beats in has its lock file")


def soundness(objects: Objects, prefix: str | None) -> Iterator[Finding]:
    """Tell which objects are damaged, are no objects, or may not be looked at."""
    bad = [seen for seen in concerned(objects, prefix) if seen.error is not None]
    # Without a configuration nobody says that a bridge of this machine needs these names.
    level = Level.WARNING if prefix is None else None
    for seen in bad:
        error = seen.error
        assert error is not None
        what = f"{seen.path}: {error.what} [{error.code}]"
        if error.code in _HIDDEN:
            owner = user_name(seen.status.st_uid)
            text = f"not visible: what stands in {seen.path}, which belongs to {owner} ({error.what})"
            yield kind("DOC003").found(text)
        elif error.code == "SHM121":
            folder = stat.S_ISDIR(seen.status.st_mode)
            command = f"rm{'dir' if folder else ''} {seen.path}"
            yield kind("DOC212").found(what, command=command, level=level)
        else:
            yield kind("DOC211").found(what, error.remedy, level=level)
    if not any(seen.error and seen.error.code == "SHM121" for seen in bad):
        yield kind("DOC212").fine("plain files stand at the objects' names")
    if not any(seen.error and seen.error.code not in (*_HIDDEN, "SHM121") for seen in bad):
        yield kind("DOC211").fine("no object is damaged")


def ownership(
    objects: Objects, prefix: str | None, owners: Collection[int], *, root: bool
) -> Iterator[Finding]:
    """Tell which objects are another user's, and which are open to everybody.

    Args:
        objects: What was found.
        prefix: The configuration's; None without one.
        owners: Users whose objects a bridge of this user may take over.
        root: Whether this user is root.
    """
    files = [seen for seen in concerned(objects, prefix) if stat.S_ISREG(seen.status.st_mode)]
    others = [] if prefix is None else [s for s in files if s.status.st_uid not in owners and not s.live]
    if others:
        names = {user_name(seen.status.st_uid) for seen in others}
        what = f"{listed(sorted(names))} owns {listed(seen.topic for seen in others)}"
        yield kind("DOC209").found(what, command=_clean(others, objects, root=not root))
    else:
        yield kind("DOC209").fine("no object of another user is in the way")
    open_ = [seen for seen in files if stat.S_IMODE(seen.status.st_mode) & 0o006]
    if open_:
        worst = max(stat.S_IMODE(seen.status.st_mode) & 0o006 for seen in open_)
        who = "change" if worst & 0o002 else "read"
        what = f"everybody may {who} {plural(len(open_), 'object')}: {listed(seen.topic for seen in open_)}"
        yield kind("DOC210").found(
            what, "In the configuration: shm: {mode: '0660', group: GROUP}; then restart it."
        )
    else:
        yield kind("DOC210").fine("no object is open to everybody")
