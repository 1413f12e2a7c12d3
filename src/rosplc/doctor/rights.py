"""Who the PLC's runtime is, what it may open, and whether it sees the same /dev/shm."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from rosplc.doctor.finding import Finding, Level
from rosplc.doctor.kinds import kind
from rosplc.doctor.processes import Mount, Runtime
from rosplc.doctor.words import group_name, listed, user_name
from rosplc.harmless import plural

__all__ = ["File", "container", "may_use", "rights", "runtimes", "same_memory"]

_SHARE = (
    "Start both containers with one /dev/shm: docker run --ipc=host, or in compose `ipc: host` "
    "(or `ipc: shareable` on one and `ipc: service:NAME` on the other), or -v /dev/shm:/dev/shm."
)


@dataclass(frozen=True)
class File:
    """An object as a file, there already or as the configuration would make it."""

    name: str
    uid: int
    gid: int
    mode: int


def runtimes(found: Sequence[Runtime], machine_bits: int, *, classic: bool) -> Iterator[Finding]:
    """Tell which PLC runtimes run here, and their word size.

    Args:
        found: The processes.
        machine_bits: Word size of the kernel.
        classic: Whether the configuration has classic topics with a lock.
    """
    if not found:
        yield kind("DOC301").found("no process named codesyscontrol* runs here")
        return
    who = (f"{each.name} (process {each.pid}, user {user_name(each.uid)})" for each in found)
    yield kind("DOC301").fine(f"running: {listed(who)}")
    narrow = [each for each in found if each.bits == 32]
    for each in (each for each in found if not each.bits):
        yield kind("DOC003").found(f"not visible: the word size of process {each.pid} ({each.name})")
    if narrow and machine_bits == 64:
        what = f"{narrow[0].name} (process {narrow[0].pid}) has 32 bits on a kernel of 64"
        yield kind("DOC302").found(what, level=Level.ERROR if classic else None)
    else:
        yield kind("DOC302").fine("the runtime has the kernel's word size")


def may_use(file: File, uid: int, gids: frozenset[int]) -> bool:
    """Return whether a user may open a file for reading and writing, by the kernel's rules."""
    if uid == 0:
        return True
    if uid == file.uid:
        return file.mode & 0o600 == 0o600
    if file.gid in gids:
        return file.mode & 0o060 == 0o060
    return file.mode & 0o006 == 0o006


def rights(files: Sequence[File], uid: int, gids: frozenset[int]) -> Iterator[Finding]:
    """Judge whether the PLC's user may open the objects.

    Args:
        files: The objects, as they are or will be.
        uid: The user of the runtime.
        gids: All of its groups.
    """
    user = user_name(uid)
    closed = [file for file in files if not may_use(file, uid, gids)]
    if not closed:
        yield kind("DOC303").fine(f"{user} may open {plural(len(files), 'object')}")
        return
    first = closed[0]
    owner = f"{user_name(first.uid)}:{group_name(first.gid)} {first.mode:04o}"
    what = f"{user} may not open {listed(file.name for file in closed)} ({owner})"
    if first.gid != 0 and first.mode & 0o060 == 0o060:
        group = group_name(first.gid)
        remedy = f"Put {user} into the group {group}, and start the runtime again."
        yield kind("DOC303").found(what, remedy, f"sudo usermod --append --groups {group} {user}")
        return
    remedy = (
        f"Make a group that {user} is in, and give it the objects with shm: {{group: plc, mode: '0660'}}."
    )
    command = f"sudo groupadd --force plc && sudo usermod --append --groups plc {user}"
    yield kind("DOC303").found(what, remedy, command)


def same_memory(found: Sequence[Runtime], own: Mount | None) -> Iterator[Finding]:
    """Judge whether the runtimes see the /dev/shm that a bridge here would use.

    The mount decides, not the IPC namespace: POSIX shared memory lies in files.
    """
    apart = [
        each for each in found if each.shm is not None and own is not None and each.shm.device != own.device
    ]
    hidden = [each for each in found if each.shm is None]
    for each in hidden:
        yield kind("DOC003").found(f"not visible: what process {each.pid} ({each.name}) has at /dev/shm")
    if apart:
        what = f"{apart[0].name} (process {apart[0].pid}) has a /dev/shm of its own"
        yield kind("DOC304").found(what, _SHARE)
    elif found and not hidden:
        yield kind("DOC304").fine("the runtime sees the same /dev/shm")


def container(root: Path, environment_word: str, *, runtime_seen: bool) -> Iterator[Finding]:
    """Tell whether this is a container.

    Args:
        root: Where ``run`` and ``proc`` stand.
        environment_word: The variable ``container``, which some set.
        runtime_seen: Whether a PLC runtime runs in it, too.
    """
    sign = _container_sign(root, environment_word)
    if not sign:
        yield kind("DOC305").fine("no sign of a container")
    elif runtime_seen:
        yield kind("DOC305").fine(f"a container ({sign}), with the PLC runtime in it")
    else:
        yield kind("DOC305").found(
            f"the doctor runs in a container ({sign}), and no PLC runtime in it", _SHARE
        )


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
