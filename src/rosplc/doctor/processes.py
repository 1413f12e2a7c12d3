"""Processes of a CODESYS runtime, and how they see this machine, from /proc alone."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

__all__ = ["Mount", "Runtime", "find_runtimes", "shm_mount"]

_NAME = "codesyscontrol"


@dataclass(frozen=True)
class Mount:
    """A mounted file system: device and folder in it (``0:27 /``), its type, and its mount point."""

    device: str
    kind: str
    point: str
    read_only: bool = False


@dataclass(frozen=True)
class Runtime:
    """A process of a PLC runtime.

    Attributes:
        pid: Its number.
        name: Its name.
        bits: Word size of its program; 0 if that may not be seen.
        uid: The user that it acts as.
        gids: The groups that it acts with.
        shm: What it sees at /dev/shm; None if that may not be seen.
    """

    pid: int
    name: str
    bits: int
    uid: int
    gids: frozenset[int]
    shm: Mount | None


def find_runtimes(proc: Path) -> list[Runtime]:
    """Return the processes named codesyscontrol*; those that end meanwhile are left out."""
    found = []
    for folder in proc.iterdir():
        if folder.name.isdigit():
            try:
                name = _name(folder)
                if name is not None:
                    found.append(_runtime(folder, name))
            except (OSError, ValueError):
                continue
    return sorted(found, key=lambda runtime: runtime.pid)


def _name(folder: Path) -> str | None:
    """Return the process's name if it is a runtime's; its own name is cut off at 15 characters."""
    names = [(folder / "comm").read_text(encoding="utf-8", errors="replace").strip()]
    line = (folder / "cmdline").read_bytes().split(b"\0")[0].decode("utf-8", "replace")
    names.append(line.rpartition("/")[2])
    return next((name for name in reversed(names) if name.lower().startswith(_NAME)), None)


def _runtime(folder: Path, name: str) -> Runtime:
    fields: dict[str, list[str]] = {}
    for line in (folder / "status").read_text(encoding="utf-8", errors="replace").splitlines():
        key, _, value = line.partition(":")
        fields[key] = value.split()
    # The second number is the effective one: it decides what may be opened.
    uid, gid = int(fields["Uid"][1]), int(fields["Gid"][1])
    groups = frozenset({gid, *map(int, fields.get("Groups", []))})
    try:
        mount = shm_mount(folder / "mountinfo")
    except OSError:
        mount = None
    return Runtime(int(folder.name), name, _bits(folder), uid, groups, mount)


def _bits(folder: Path) -> int:
    """Return the word size that the program's file states (ELF, EI_CLASS); 0 if it may not be read."""
    candidates = [folder / "exe"]
    try:
        first = (folder / "cmdline").read_bytes().split(b"\0")[0]
        if first.startswith(b"/"):
            candidates.append(Path(os.fsdecode(first)))
    except OSError:
        pass
    for path in candidates:
        try:
            with path.open("rb") as file:
                head = file.read(5)
        except OSError:
            continue
        if head[:4] == b"\x7fELF":
            return {1: 32, 2: 64}.get(head[4], 0)
    return 0


def shm_mount(mountinfo: Path) -> Mount | None:
    """Return what is mounted at /dev/shm according to a process's mountinfo; None if nothing is.

    Raises:
        OSError: If the file cannot be read.
    """
    best: Mount | None = None
    for line in mountinfo.read_text(encoding="utf-8", errors="replace").splitlines():
        words, _, rest = line.partition(" - ")
        fields = words.split()
        if len(fields) < 6:
            continue
        point = fields[4]
        # The longest mount point wins, and of equal ones the last, which covers the others.
        if point in ("/dev/shm", "/dev", "/") and (best is None or len(point) >= len(best.point)):
            best = Mount(f"{fields[2]} {fields[3]}", rest.split(" ")[0], point, "ro" in fields[5].split(","))
    return best
