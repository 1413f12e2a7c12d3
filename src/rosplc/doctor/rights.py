"""Processes of a CODESYS runtime, from /proc alone: their user, their permissions and their /dev/shm."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from rosplc.doctor.finding import Finding, Level, group_name, user_name
from rosplc.doctor.kinds import fine, found, judged
from rosplc.harmless import listed, plural

_SHARE = (
    "Start both containers with docker run --ipc=host or -v /dev/shm:/dev/shm. With compose, set `ipc: host` "
    "for both, or `ipc: shareable` for one container and `ipc: service:NAME` for the other."
)
_NAME = "codesyscontrol"


@dataclass(frozen=True)
class Mount:
    """A mounted file system: its device and the folder in it (``0:27 /``), its type and its mount point."""

    device: str
    kind: str
    point: str
    read_only: bool = False


@dataclass(frozen=True)
class Runtime:
    """A process of a PLC runtime: its effective user and groups, and what is mounted at its /dev/shm.

    ``bits`` is the word size of its program; 0, and None for ``shm``, if this user may not read it.
    """

    pid: int
    name: str
    bits: int
    uid: int
    gids: frozenset[int]
    shm: Mount | None


def find_runtimes(proc: Path) -> list[Runtime]:
    """Return the processes named codesyscontrol*, without those that end during the search."""
    found = []
    for folder in proc.glob("[0-9]*"):
        with suppress(OSError, ValueError):
            if (name := _name(folder)) is not None:
                found.append(_runtime(folder, name))
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
    with suppress(OSError):
        first = (folder / "cmdline").read_bytes().split(b"\0")[0]
        candidates += [Path(os.fsdecode(first))] if first.startswith(b"/") else []
    for path in candidates:
        with suppress(OSError), path.open("rb") as file:
            head = file.read(5)
            if head[:4] == b"\x7fELF":
                return {1: 32, 2: 64}.get(head[4], 0)
    return 0


def shm_mount(mountinfo: Path) -> Mount | None:
    """Return what is mounted at /dev/shm according to a process's mountinfo; None if nothing is.

    Raises OSError if the file cannot be read.
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


@dataclass(frozen=True)
class File:
    """An object as a file, existing or as the configuration would create it."""

    name: str
    uid: int
    gid: int
    mode: int


def runtimes(seen: Sequence[Runtime], machine_bits: int, *, classic: bool) -> Iterator[Finding]:
    """Report which PLC runtimes run here, and their word size.

    ``classic``: the configuration has classic topics with a lock.
    """
    if not seen:
        yield found("DOC301", "no process named codesyscontrol* is running here")
        return
    who = (f"{each.name} (process {each.pid}, user {user_name(each.uid)})" for each in seen)
    yield fine("DOC301", f"running: {listed(who)}")
    for each in (each for each in seen if not each.bits):
        yield found("DOC003", f"cannot determine the word size of process {each.pid} ({each.name})")
    narrow = [each for each in seen if each.bits == 32 and machine_bits == 64]
    what = f"{narrow[0].name} (process {narrow[0].pid}) is 32-bit on a 64-bit kernel" if narrow else ""
    level = Level.ERROR if classic else None
    yield judged("DOC302", what, "the runtime has the kernel's word size", level=level)


def may_use(file: File, uid: int, gids: frozenset[int]) -> bool:
    """Return whether a user may open a file for reading and writing, by the kernel's rules."""
    needed = 0o600 if uid == file.uid else 0o060 if file.gid in gids else 0o006
    return uid == 0 or file.mode & needed == needed


def rights(files: Sequence[File], uid: int, gids: frozenset[int]) -> Iterator[Finding]:
    """Judge whether the PLC's user may open the objects, as they are or as they will be."""
    user = user_name(uid)
    closed = [file for file in files if not may_use(file, uid, gids)]
    if not closed:
        yield fine("DOC303", f"{user} may open {plural(len(files), 'object')}")
        return
    first = closed[0]
    group = group_name(first.gid)
    owner = f"{user_name(first.uid)}:{group} {first.mode:04o}"
    what = f"{user} may not open {listed(file.name for file in closed)} ({owner})"
    make, shared = "", "shm: {group: plc, mode: '0660'}"
    remedy = f"Add {user} to the group {group}, and restart the runtime."
    if first.gid == 0 or first.mode & 0o060 != 0o060:
        make, group = "sudo groupadd --force plc && ", "plc"
        remedy = f"Create a group that contains {user}, and give the objects to it with {shared}."
    yield found("DOC303", what, remedy, f"{make}sudo usermod --append --groups {group} {user}")


def same_memory(seen: Sequence[Runtime], own: Mount | None) -> Iterator[Finding]:
    """Judge whether the runtimes have the same /dev/shm as a bridge on this machine.

    The mount decides, not the IPC namespace: POSIX shared memory consists of files.
    """
    hidden = [each for each in seen if each.shm is None]
    for each in hidden:
        yield found("DOC003", f"cannot determine which /dev/shm process {each.pid} ({each.name}) uses")
    for each in seen:
        if each.shm is not None and own is not None and each.shm.device != own.device:
            yield found("DOC304", f"{each.name} (process {each.pid}) has its own /dev/shm", _SHARE)
            return
    if seen and not hidden:
        yield fine("DOC304", "the runtime uses the same /dev/shm")


def container(root: Path, environment_word: str, *, runtime_seen: bool) -> Iterator[Finding]:
    """Report whether the doctor runs in a container, which files or the variable ``container`` indicate.

    ``root`` contains ``run`` and ``proc``; ``runtime_seen``: a PLC runtime is running in it, too.
    """
    sign = _container_sign(root, environment_word)
    alone = f"the doctor runs in a container ({sign}) without a PLC runtime"
    well = f"the doctor and the PLC runtime are in a container ({sign})" if sign else "no container detected"
    yield judged("DOC305", alone if sign and not runtime_seen else "", well, _SHARE)


def _container_sign(root: Path, environment_word: str) -> str:
    for name in ("run/.containerenv", ".dockerenv"):
        if (root / name).exists():
            return f"/{name}"
    if environment_word:
        return f"container={environment_word}"
    try:
        text = (root / "proc/1/cgroup").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return ""
    return next((word for word in ("docker", "kubepods", "libpod", "lxc", "containerd") if word in text), "")
