"""Running other programs, with their output in the error."""

from __future__ import annotations

import subprocess
from collections.abc import Mapping, Sequence
from pathlib import Path

__all__ = ["DeployError", "run"]


class DeployError(Exception):
    """A step did not work; the text says which, and what it printed."""


def run(
    command: Sequence[str | Path],
    *,
    cwd: Path | None = None,
    environment: Mapping[str, str] | None = None,
    seconds: float = 900.0,
) -> str:
    """Run a program and return what it printed.

    Args:
        command: The program and its arguments.
        cwd: Where it runs.
        environment: Its environment; None for this process's own.
        seconds: When it is given up.

    Raises:
        DeployError: It does not exist, failed, or did not end in time.
    """
    words = [str(word) for word in command]
    try:
        done = subprocess.run(
            words,
            cwd=cwd,
            env=None if environment is None else dict(environment),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
            timeout=seconds,
            check=False,
        )
    except FileNotFoundError:
        raise DeployError(f"{words[0]} is not installed") from None
    except subprocess.TimeoutExpired:
        raise DeployError(f"{' '.join(words)}\ndid not end within {seconds:.0f} s") from None
    if done.returncode:
        raise DeployError(f"{' '.join(words)}\nended with {done.returncode}:\n{done.stdout}")
    return done.stdout
