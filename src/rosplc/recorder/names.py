"""What files are called: never a name that is taken."""

from __future__ import annotations

import time
from pathlib import Path

__all__ = ["SUFFIX", "base_of", "dated", "file_name", "free_name"]

SUFFIX = ".mcap"


def base_of(output: Path) -> Path:
    """Return a path without its ``.mcap``."""
    return output.with_name(output.name.removesuffix(SUFFIX)) if output.name != SUFFIX else output


def dated(base: Path, time_ns: int) -> Path:
    """Return ``base_2026-03-28_14-05-09``, by local time."""
    text = time.strftime("%Y-%m-%d_%H-%M-%S", time.localtime(time_ns / 1e9))
    return base.with_name(f"{base.name}_{text}")


def free_name(base: Path) -> Path:
    """Return a base that neither a file nor a folder has; a number is put behind it if need be."""
    taken, number = base, 1
    while any(_exists(one) for one in (taken, file_name(taken), file_name(taken, 0))):
        number += 1
        taken = base.with_name(f"{base.name}-{number}")
    return taken


def file_name(base: Path, part: int | None = None) -> Path:
    """Return the file of a base, or one of its parts: ``base_0.mcap``."""
    return base.with_name(f"{base.name}{'' if part is None else f'_{part}'}{SUFFIX}")


def _exists(path: Path) -> bool:
    return path.exists() or path.is_symlink()
