"""/dev/shm itself: what is mounted there, its mode, and the room in it."""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator
from pathlib import Path

from rosplc.doctor.finding import Finding, Level
from rosplc.doctor.kinds import kind
from rosplc.doctor.processes import Mount

__all__ = ["mode", "mounted", "room"]

_TMPFS = ("tmpfs", "ramfs")
_MIB = 1 << 20


def mounted(directory: Path, mount: Mount | None) -> Iterator[Finding]:
    """Judge what is mounted at /dev/shm.

    Args:
        directory: Where the objects lie.
        mount: What the kernel says is mounted there; None if nothing.
    """
    check = kind("DOC201")
    mend = "mount -t tmpfs -o mode=1777 tmpfs /dev/shm"
    if not directory.is_dir():
        yield check.found(f"{directory} is no folder", command=f"mkdir -p {directory}")
    elif directory != Path("/dev/shm"):
        seen = f"shm.directory is {directory}, where a PLC does not look"
        yield check.found(seen, "Remove shm.directory, unless it is for a test.", level=Level.WARNING)
    elif mount is None or mount.point != "/dev/shm" or mount.kind not in _TMPFS:
        what = (
            "nothing is mounted there"
            if mount is None or mount.point != "/dev/shm"
            else f"it is {mount.kind}"
        )
        yield check.found(f"/dev/shm is no memory file system: {what}", command=f"sudo {mend}")
    elif mount.read_only:
        yield check.found("/dev/shm is mounted read-only", command="sudo mount -o remount,rw /dev/shm")
    else:
        yield check.fine("/dev/shm is a memory file system")


def mode(directory: Path, *, writable: bool) -> Iterator[Finding]:
    """Judge the directory's mode.

    Args:
        directory: Where the objects lie.
        writable: Whether this user may make files there.
    """
    bits = stat.S_IMODE(directory.stat().st_mode)
    seen = f"{directory} has mode {bits:04o}"
    if bits == 0o1777:
        yield kind("DOC202").fine(seen)
        return
    level = Level.WARNING if writable else Level.ERROR
    what = "" if writable else ", and this user may not make files there"
    yield kind("DOC202").found(f"{seen}{what}", command=f"sudo chmod 1777 {directory}", level=level)


def room(directory: Path, space: os.statvfs_result, needed: int, present: int) -> Iterator[Finding]:
    """Judge the room for objects.

    Args:
        directory: Where the objects lie.
        space: What ``os.statvfs`` says of it.
        needed: Bytes of all of the configuration's objects; 0 without one.
        present: Bytes of those that are there already, as they are allocated.
    """
    size, free = space.f_blocks * space.f_frsize, space.f_bavail * space.f_frsize
    seen = f"{directory} has {_mib(free)} of {_mib(size)} free"
    missing = max(0, needed - present)
    if missing > free:
        # A bridge makes an object anew beside the old one, so twice the need is what serves.
        mib = -(-(size + 2 * missing) // _MIB)
        yield kind("DOC203").found(
            f"{seen}; the configuration's objects need {_mib(missing)} more",
            "Enlarge it, or lower limits and depth; a container takes --shm-size.",
            f"sudo mount -o remount,size={mib}m {directory}",
        )
    elif size and free < size / 10:
        yield kind("DOC204").found(seen, command=f"ls -lS {directory}")
    else:
        more = f"; the configuration's objects take {_mib(needed)}" if needed else ""
        yield kind("DOC203").fine(seen + more)


def _mib(count: int) -> str:
    return f"{count / _MIB:.0f} MiB" if count >= 10 * _MIB else f"{count / _MIB:.1f} MiB"
