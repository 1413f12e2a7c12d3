"""Runs a command within what the service's unit allows: its system calls, its sockets, no new privileges.

systemd does this for a real service; here libseccomp does it from the unit's own text, so that the filter is
tried where no systemd runs. As a program: ``python sandbox.py UNIT USER COMMAND...``.
"""

from __future__ import annotations

import ctypes
import errno
import os
import re
import subprocess
import sys
from pathlib import Path

_ALLOW = 0x7FFF0000
_ERRNO = 0x00050000
_EQUAL = 4
_PR_SET_NO_NEW_PRIVS, _PR_SET_MDWE, _REFUSE_EXEC_GAIN = 38, 65, 1
_FAMILIES = {"AF_UNIX": 1, "AF_INET": 2, "AF_INET6": 10, "AF_NETLINK": 16}


class _Compare(ctypes.Structure):
    _fields_ = (
        ("arg", ctypes.c_uint),
        ("op", ctypes.c_int),
        ("a", ctypes.c_uint64),
        ("b", ctypes.c_uint64),
    )


def groups() -> dict[str, set[str]]:
    """Return systemd's groups of system calls, each with its members, groups among them."""
    said = subprocess.run(
        ["systemd-analyze", "syscall-filter"], capture_output=True, text=True, check=True
    ).stdout
    found: dict[str, set[str]] = {}
    current = ""
    for line in said.splitlines():
        if line.startswith("@"):
            current = line.strip()
            found[current] = set()
        elif (word := line.strip()) and not word.startswith("#") and current:
            found[current].add(word)
        elif line.startswith("# Ungrouped"):
            current = ""
    return found


def allowed(unit: str) -> set[str]:
    """Return the system calls that a unit's ``SystemCallFilter=`` lines leave."""
    known = groups()

    def members(word: str) -> set[str]:
        if not word.startswith("@"):
            return {word}
        return set().union(*(members(each) for each in known[word]))

    calls = members("@default")
    for line in re.findall(r"^SystemCallFilter=(.*)$", unit, re.MULTILINE):
        words = set().union(*(members(word) for word in line.lstrip("~").split()))
        calls = calls - words if line.startswith("~") else calls | words
    return calls


def families(unit: str) -> list[int]:
    """Return the numbers of the address families that a unit leaves."""
    (line,) = re.findall(r"^RestrictAddressFamilies=(.*)$", unit, re.MULTILINE)
    return [_FAMILIES[word] for word in line.split()]


def confine(unit: str) -> None:
    """Put this process under what a unit allows, for good."""
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.prctl(_PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0):
        raise OSError(ctypes.get_errno(), "no_new_privs")
    if "MemoryDenyWriteExecute=yes" in unit and libc.prctl(_PR_SET_MDWE, _REFUSE_EXEC_GAIN, 0, 0, 0):
        print("this kernel has no PR_SET_MDWE", file=sys.stderr)
    seccomp = ctypes.CDLL("libseccomp.so.2")
    seccomp.seccomp_init.restype = ctypes.c_void_p
    context = ctypes.c_void_p(seccomp.seccomp_init(_ERRNO | errno.EPERM))
    for name in allowed(unit) - {"socket"}:
        number = seccomp.seccomp_syscall_resolve_name(name.encode())
        if number >= 0:  # others are of other architectures
            seccomp.seccomp_rule_add_array(context, _ALLOW, number, 0, None)
    socket = seccomp.seccomp_syscall_resolve_name(b"socket")
    for family in families(unit):
        compare = _Compare(0, _EQUAL, family, 0)
        seccomp.seccomp_rule_add_array(context, _ALLOW, socket, 1, ctypes.byref(compare))
    if seccomp.seccomp_load(context):
        raise OSError("the filter could not be loaded")


if __name__ == "__main__":
    text = Path(sys.argv[1]).read_text(encoding="utf-8")
    calls = allowed(text)  # while programs may still be run as before
    os.umask(0o077)
    confine(text)
    os.execvp(sys.argv[2], sys.argv[2:])
