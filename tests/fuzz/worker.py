"""``python -m tests.fuzz.worker TARGET COUNTS [libFuzzer's arguments]``: one Python target under atheris."""

from __future__ import annotations

import resource
import shlex
import sys
from pathlib import Path
from types import ModuleType

from tests.fuzz.counts import Counter
from tests.fuzz.targets import TARGETS, load

__all__ = ["limit_memory"]

MEMORY = 3 << 30
"""Bytes of address space that a target may take; what needs more has no bound."""


def limit_memory() -> None:
    """Let an allocation without bounds fail here, and not the machine."""
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def _atheris() -> ModuleType:
    try:
        import atheris
    except ImportError:
        sys.exit("atheris is missing: pip install 'atheris>=3,<4'")
    module: ModuleType = atheris
    return module


def main() -> None:
    """Fuzz until libFuzzer has had its time; it ends the process itself."""
    name, counts, *arguments = sys.argv[1:]
    atheris = _atheris()
    counter = Counter(Path(counts))
    with atheris.instrument_imports(include=list(TARGETS[name].instrument), enable_loader_override=False):
        check = load(name).check

    def one(data: bytes) -> None:
        counter.add(len(data))
        check(data)

    limit_memory()
    # libFuzzer starts itself anew to merge corpora, by a shell.
    command = f"{shlex.quote(sys.executable)} -m tests.fuzz.worker {name} {shlex.quote(counts)}"
    atheris.Setup([command, *arguments], one)
    atheris.Fuzz()


if __name__ == "__main__":
    main()
