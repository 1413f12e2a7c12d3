"""What the doctor's tests are given: a folder that stands for the machine, plans, objects."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from rosplc.config import Project, parse_config, resolve
from rosplc.doctor import Finding, Level
from rosplc.shm import Namespace

MOUNT = "30 25 0:27 / /dev/shm rw,relatime - tmpfs tmpfs rw\n"
OTHER_MOUNT = "30 25 0:99 / /dev/shm rw,relatime - tmpfs shm rw,size=65536k\n"


class Stage:
    """A made-up machine.

    Attributes:
        root: Its root folder.
        namespace: A real namespace in /dev/shm.
    """

    def __init__(self, root: Path, namespace: Namespace) -> None:
        self.root = root
        self.namespace = namespace
        self.kept: list[Any] = []

    def file(self, path: str, content: str | bytes = "", mode: int = 0o644) -> Path:
        """Write a file below the root."""
        target = self.root / path
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_bytes(content.encode() if isinstance(content, str) else content)
        target.chmod(mode)
        return target

    def process(
        self,
        pid: int = 4711,
        *,
        name: str = "codesyscontrol.bin",
        bits: int = 64,
        uid: int = 1234,
        groups: Iterable[int] = (1234,),
        mount: str = MOUNT,
    ) -> None:
        """Let a process run."""
        base = f"proc/{pid}"
        self.file(f"{base}/comm", name[:15] + "\n")
        self.file(f"{base}/cmdline", f"/opt/codesys/bin/{name}\0-d\0")
        numbers = "\t".join([str(uid)] * 4)
        self.file(
            f"{base}/status",
            f"Name:\t{name[:15]}\nUid:\t{numbers}\nGid:\t{numbers}\nGroups:\t{' '.join(map(str, groups))} \n",
        )
        self.file(f"{base}/exe", b"\x7fELF" + {32: b"\1", 64: b"\2", 0: b"\0"}[bits])
        self.file(f"{base}/mountinfo", mount)

    def project(self, topics: str, **settings: str) -> Project:
        """Return a configuration's project; the prefix is the namespace's unless given."""
        lines = {"prefix": self.namespace.prefix, "bridge": "cell", **settings}
        head = "".join(f"{key}: {value}\n" for key, value in lines.items())
        return resolve(parse_config(f"{head}topics:\n{topics}"))


def problems(findings: Iterable[Finding]) -> dict[str, Finding]:
    """Return what is worse than fine, by code."""
    return {finding.code: finding for finding in findings if finding.level > Level.OK}


def space(total: int, free: int) -> os.statvfs_result:
    """Return what statvfs would say of so many bytes."""
    return os.statvfs_result((4096, 4096, total // 4096, free // 4096, free // 4096, 0, 0, 0, 0, 255))


def variables(**given: str) -> Mapping[str, str]:
    """Return an environment."""
    return given
