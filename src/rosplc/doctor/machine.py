"""The computer itself: processor, word size, clock, limits, log-out."""

from __future__ import annotations

import configparser
import resource
import struct
from collections.abc import Callable, Iterator
from pathlib import Path

from rosplc.doctor.finding import Finding, Level
from rosplc.doctor.kinds import kind

__all__ = ["architecture", "capabilities", "clock", "logout", "open_files", "real_time"]

_TESTED = ("x86_64", "aarch64", "armv7l", "armv8l", "armv6l", "i686", "i386")
_WIDE = ("x86_64", "aarch64")
# Earlier than this release, whose year it is.
_RELEASED_S = 1_735_689_600  # 2025-01-01
_CAP_IPC_LOCK, _CAP_SYS_NICE = 14, 23
_ENOUGH = 64 << 20
_FIRST_PERSON = 1000
"""The first user number that logind takes for a person's (SYS_UID_MAX is 999)."""
_SERVICES = (*range(61_184, 65_520), 65_534)
"""Users that systemd makes for a service, and nobody."""


def architecture(
    machine: str, release: str, *, bits: int = struct.calcsize("P") * 8, byte_order: str = "little"
) -> Iterator[Finding]:
    """Judge kernel and word size.

    Args:
        machine: The kernel's architecture, as ``uname -m`` prints it.
        release: The kernel's release.
        bits: Word size of this Python.
        byte_order: ``little`` or ``big``.
    """
    seen = f"Linux {release} on {machine}"
    if byte_order != "little":
        yield kind("DOC101").found(f"{seen}, which is big-endian", level=Level.ERROR)
    elif machine not in _TESTED:
        yield kind("DOC101").found(f"{seen}, which rosplc is not tested on")
    else:
        yield kind("DOC101").fine(seen)
    if bits == 32 and machine in (*_WIDE, "armv8l"):
        yield kind("DOC102").found(f"Python has 32 bits on a kernel of 64 ({machine})")
    else:
        yield kind("DOC102").fine(f"Python has {bits} bits")


def clock(now_s: float) -> Iterator[Finding]:
    """Judge the time of day, in seconds since 1970."""
    if now_s < _RELEASED_S:
        yield kind("DOC103").found(
            "the clock is before 2025: it has not been set since the start of the machine",
            "Set the clock; a board without a battery needs NTP or PTP.",
            "timedatectl set-ntp true",
        )
    else:
        yield kind("DOC103").fine("the clock is plausible")


def open_files(limit: int, topics: int) -> Iterator[Finding]:
    """Judge the limit on open files.

    Args:
        limit: The soft limit; ``resource.RLIM_INFINITY`` for none.
        topics: How many topics the configuration has.
    """
    # A lock file per topic at least; a memory, a semaphore and sockets of two ROS 1 peers at most.
    least, usual = 48 + topics, 128 + 4 * topics
    if limit != resource.RLIM_INFINITY and limit < usual:
        yield kind("DOC104").found(
            f"{limit} open files are allowed; {topics} topics take {least} to {usual}",
            f"Raise the limit in the shell, or with LimitNOFILE={usual} in a systemd unit.",
            f"ulimit -n {usual}",
            level=Level.ERROR if limit < least else Level.WARNING,
        )
    else:
        allowed = "any number of" if limit == resource.RLIM_INFINITY else str(limit)
        yield kind("DOC104").fine(f"{allowed} open files are allowed")


def real_time(priority: int, locked: int, capabilities: int) -> Iterator[Finding]:
    """Tell whether real-time priority and locked memory may be had.

    Args:
        priority: Soft limit RLIMIT_RTPRIO; ``resource.RLIM_INFINITY`` for none.
        locked: Soft limit RLIMIT_MEMLOCK in bytes.
        capabilities: The process's effective capabilities, as a set of bits.
    """
    may_run = priority != 0 or capabilities >> _CAP_SYS_NICE & 1
    may_lock = locked == resource.RLIM_INFINITY or locked >= _ENOUGH or capabilities >> _CAP_IPC_LOCK & 1
    if may_run and may_lock:
        yield kind("DOC105").fine("real-time priority and locked memory may be had")
        return
    amount = "any" if locked == resource.RLIM_INFINITY else f"{locked >> 10} KiB"
    seen = f"highest real-time priority {priority}, {amount} of locked memory"
    remedy = "Nothing, unless it matters; then LimitRTPRIO= and LimitMEMLOCK= of the systemd unit."
    yield kind("DOC105").found(seen, remedy)


def capabilities(status: Path) -> int:
    """Return the effective capabilities in a process's ``status``; 0 if it does not tell."""
    for line in status.read_text(encoding="utf-8", errors="replace").splitlines():
        if line.startswith("CapEff:"):
            return int(line.split()[1], 16)
    return 0


def logout(
    root: Path, uid: int, user: str, listing: Callable[[Path], list[Path]] | None = None
) -> Iterator[Finding]:
    """Judge whether systemd removes the bridge's objects when a user logs out.

    Args:
        root: Where ``etc`` and ``run`` stand.
        uid: Whose objects it would be about.
        user: That user's name.
        listing: Lists a folder's ``.conf`` files in their order; for tests.
    """
    if not (root / "run/systemd/seats").is_dir():
        yield kind("DOC106").fine("no systemd-logind runs here")
        return
    value, where = _remove_ipc(root, listing or _conf_files)
    if not value:
        yield kind("DOC106").fine(f"RemoveIPC=no in {where}")
    elif uid < _FIRST_PERSON or uid in _SERVICES:
        yield kind("DOC106").fine(f"{user} is a system user, whose objects systemd leaves alone")
    elif (root / "var/lib/systemd/linger" / user).exists():
        yield kind("DOC106").fine(f"{user} lingers, and is never logged out altogether")
    else:
        yield kind("DOC106").found(
            f"RemoveIPC=yes ({where}), and {user} is an ordinary user",
            "Run the bridge as a system user (`rosplc service install`), or let this one linger.",
            f"sudo loginctl enable-linger {user}",
        )


def _conf_files(folder: Path) -> list[Path]:
    return sorted(folder.glob("*.conf")) if folder.is_dir() else []


def _remove_ipc(root: Path, listing: Callable[[Path], list[Path]]) -> tuple[bool, str]:
    """Return logind's RemoveIPC and where it stands; the last file that sets it wins."""
    files: dict[str, Path] = {}
    for folder in ("usr/lib/systemd/logind.conf.d", "run/systemd/logind.conf.d", "etc/systemd/logind.conf.d"):
        files.update({path.name: path for path in listing(root / folder)})
    result, where = True, "systemd's default"
    main = next(
        (
            path
            for base in ("etc", "run", "usr/lib")
            if (path := root / base / "systemd/logind.conf").is_file()
        ),
        None,
    )
    for path in ([main] if main else []) + [files[name] for name in sorted(files)]:
        parser = configparser.ConfigParser(strict=False, interpolation=None, allow_no_value=True)
        try:
            parser.read_string(path.read_text(encoding="utf-8", errors="replace"))
            value = parser.get("Login", "RemoveIPC", fallback=None)
        except configparser.Error:
            continue
        if value:
            result = value.strip().lower() not in ("no", "false", "0", "off", "n", "f")
            where = f"/{path.relative_to(root)}"
    return result, where
