"""Run a program in a world of its own: an empty ``/dev/shm``, and a network that is the loopback interface.

``isolated.py COMMAND…`` makes the namespaces, ``isolated.py --join PID COMMAND…`` enters those of a process.
Only Linux' own calls are used; without root a user namespace is needed, which some machines forbid
(:func:`possible`).
"""

from __future__ import annotations

import ctypes
import fcntl
import functools
import os
import shutil
import socket
import struct
import subprocess
import sys
from pathlib import Path

__all__ = ["ROOT", "command", "mounted", "possible"]

ROOT = Path(__file__).resolve().parents[2]
_NEWNS, _NEWUSER, _NEWNET = 0x00020000, 0x10000000, 0x40000000
_PRIVATE, _RECURSIVE = 1 << 18, 1 << 14
_SIOCSIFFLAGS, _IFF_UP, _IFF_MULTICAST = 0x8914, 0x1, 0x1000
_libc = ctypes.CDLL(None, use_errno=True)


def command(join: int | None = None) -> list[str]:
    """Return what to put before a command; ``join`` is a process whose world it shall share."""
    return [sys.executable, str(Path(__file__)), *(["--join", str(join)] if join is not None else [])]


@functools.cache
def possible() -> bool:
    """Return whether this user may make such a world."""
    return subprocess.run([*command(), "true"], capture_output=True, check=False).returncode == 0


def mounted(place: Path | str, options: str, line: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run a shell's line with a small disk at ``place``; skip the test where that is not permitted.

    Args:
        place: The folder over which a tmpfs is mounted.
        options: Its mount options, such as ``size=128k``.
        line: What the shell runs; ``$0``, ``$1`` … are the arguments.
        arguments: See there.
    """
    import pytest  # the program that this module is as well does without

    script = f"mount -t tmpfs -o {options} tmpfs {place} && echo mounted >&2 || exit 77; {line}"
    if (unshare := shutil.which("unshare")) is None:
        pytest.skip("Debian package util-linux is missing")
    command = [unshare, "-rm", "sh", "-c", script, *arguments]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=ROOT)
    if not done.stderr.startswith("mounted"):
        pytest.skip(f"this machine permits no mount of one's own: {done.stderr.strip()}")
    return done


def _call(function: str, *arguments: object) -> None:
    if getattr(_libc, function)(*arguments):
        raise OSError(ctypes.get_errno(), f"{function}: {os.strerror(ctypes.get_errno())}")


def _make() -> None:
    user, group = os.geteuid(), os.getegid()
    _call("unshare", _NEWNS | _NEWNET | (_NEWUSER if user else 0))
    if user:
        Path("/proc/self/setgroups").write_text("deny")
        Path("/proc/self/uid_map").write_text(f"{user} {user} 1")
        Path("/proc/self/gid_map").write_text(f"{group} {group} 1")
    _call("mount", b"none", b"/", None, _PRIVATE | _RECURSIVE, None)
    _call("mount", b"tmpfs", b"/dev/shm", b"tmpfs", 0, b"mode=1777")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        fcntl.ioctl(probe, _SIOCSIFFLAGS, struct.pack("16sh", b"lo", _IFF_UP | _IFF_MULTICAST))


def _join(pid: str) -> None:
    for kind in (*(["user"] if os.geteuid() else []), "net", "mnt"):
        with Path(f"/proc/{pid}/ns/{kind}").open("rb") as namespace:
            _call("setns", namespace.fileno(), 0)


if __name__ == "__main__":
    if sys.argv[1] == "--join":
        folder = Path.cwd()
        _join(sys.argv[2])
        os.chdir(folder)  # entering a mount namespace ends in its root
        os.execvp(sys.argv[3], sys.argv[3:])
    _make()
    os.execvp(sys.argv[1], sys.argv[1:])
