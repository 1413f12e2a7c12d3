"""Inputs worth keeping: which there are, and how a small part of them is chosen for the repository.

``corpus/TARGET`` is that small part, ``regressions/TARGET`` are inputs that once found a
defect, under names that say which. What a fuzzer finds on its way lies in ``.cache/fuzz``.
"""

from __future__ import annotations

import hashlib
import shutil
from pathlib import Path

__all__ = ["CACHE", "CORPUS", "MOST_BYTES", "REGRESSIONS", "inputs", "replace", "work_folder"]

_HERE = Path(__file__).resolve().parent
CORPUS = _HERE / "corpus"
REGRESSIONS = _HERE / "regressions"
CACHE = _HERE.parents[1] / ".cache/fuzz"

MOST_BYTES = 300_000
"""What the corpora in the repository may have together."""
_MOST_OF_ONE = 18_000
_MOST_FILES = 80


def inputs(name: str) -> list[Path]:
    """Return the inputs of a target that are in the repository."""
    return [
        path
        for top in (CORPUS, REGRESSIONS)
        for path in sorted((top / name).glob("*"))
        if path.is_file() and not path.name.startswith(".")
    ]


def work_folder(name: str, cache: Path = CACHE) -> Path:
    """Return where a target's inputs grow, and make it."""
    folder = cache / name / "corpus"
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def replace(name: str, merged: Path) -> int:
    """Make the repository's corpus of a target from a minimal one; return how many files it has.

    Args:
        name: The target.
        merged: A folder with inputs that each cover something that no other does.
    """
    folder = CORPUS / name
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    # By content, so that the choice is the same everywhere; from all sizes, since small inputs alone
    # would never get beyond the first checks.
    found = sorted(
        (path.read_bytes() for path in merged.iterdir()), key=lambda data: (len(data), _name(data))
    )
    step = max(1, -(-len(found) // _MOST_FILES))
    room, kept = _MOST_OF_ONE, 0
    for data in found[::step]:
        if len(data) <= room:
            room -= len(data)
            kept += 1
            (folder / _name(data)).write_bytes(data)
    return kept


def _name(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()[:12]
