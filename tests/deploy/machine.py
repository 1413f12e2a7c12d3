"""A machine to install on: this one, but what is written to it is forgotten."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path
from types import TracebackType

import pytest

__all__ = ["Machine", "need_namespaces"]

_MOUNT = """
set -e
mount -t tmpfs -o mode=755 rosplc "$1"
mkdir "$1/upper" "$1/work" "$1/root"
mount -t overlay -o "lowerdir=/,upperdir=$1/upper,workdir=$1/work" rosplc "$1/root"
mount --rbind /dev "$1/root/dev"
mount --rbind /proc "$1/root/proc"
echo ready
read end
"""


def need_namespaces() -> None:
    """Skip the test where this process may not make namespaces with mounts of their own."""
    if shutil.which("unshare") is None:
        pytest.skip("Debian package util-linux is missing")
    if os.geteuid() != 0 or subprocess.run(["unshare", "--mount", "true"], check=False).returncode:
        pytest.skip("only root may make namespaces")


class Machine:
    """This machine's files under a layer that takes all changes; a context manager.

    Args:
        folder: An empty folder of the test's.

    Attributes:
        root: The machine's root, as programs outside do not see it.
    """

    def __init__(self, folder: Path) -> None:
        self.root = folder / "root"
        command = ["unshare", "--mount", "sh", "-c", _MOUNT, "sh", str(folder)]
        self._holder = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )

    def __enter__(self) -> Machine:
        assert self._holder.stdout is not None and self._holder.stderr is not None
        if self._holder.stdout.readline() != "ready\n":
            why = self._holder.stderr.read()
            self.__exit__(None, None, None)
            raise AssertionError(why)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._holder.communicate("end\n")

    def command(self, *words: object) -> list[str]:
        """Return the command line that runs a program on the machine."""
        enter = ["nsenter", f"--target={self._holder.pid}", "--mount", "chroot", str(self.root)]
        return [*enter, *map(str, words)]

    def run(self, *words: object, status: int = 0, text: str | None = None) -> str:
        """Run a program on the machine, and return what it printed."""
        clean = {"PATH": "/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin", "LC_ALL": "C.UTF-8"}
        done = subprocess.run(
            self.command(*words),
            input=text or "",
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            env=clean,
            timeout=300,
            check=False,
        )
        assert done.returncode == status, f"{words}: {done.returncode}\n{done.stdout}"
        return done.stdout

    def write(self, path: str, text: str, mode: str = "644") -> None:
        """Write a file on the machine."""
        self.run(
            "sh", "-c", f'mkdir -p "$(dirname {path})" && cat > {path} && chmod {mode} {path}', text=text
        )
