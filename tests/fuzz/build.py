"""The C targets: built with clang for libFuzzer, or with gcc to replay files, always under sanitizers."""

from __future__ import annotations

import random
import shutil
import subprocess
from collections.abc import Iterator
from functools import cache
from pathlib import Path

from tests.fuzz.export_plans import every_type, export

__all__ = ["CORE", "NATIVE", "Unbuildable", "build", "plans_and_seeds", "seeds"]

NATIVE = Path(__file__).resolve().parent / "native"
CORE = NATIVE.parents[2] / "src/rosplc"
_FLAGS = ["-std=gnu11", "-g", "-O1", "-Wall", "-Wextra", "-Werror", "-fno-sanitize-recover=all"]
_LONGEST = 2000  # bytes of a message that becomes a seed


class Unbuildable(Exception):
    """A compiler or its runtime is missing; the text names the Debian package."""


def build(name: str, folder: Path, *, fuzzing: bool, core: Path = CORE) -> Path:
    """Compile a target into ``folder`` and return the program.

    Args:
        name: The target.
        folder: Where the program goes.
        fuzzing: For libFuzzer, with clang; otherwise a program that runs files, with gcc.
        core: The folder with the C core (``_core``) and its headers (``include``).

    Raises:
        Unbuildable: A Debian package is missing.
    """
    compiler, program = ("clang", folder / name) if fuzzing else ("gcc", folder / f"{name}_replay")
    if shutil.which(compiler) is None:
        raise Unbuildable(f"Debian package {compiler} is missing")
    sanitizers = "-fsanitize=address,undefined" + (",fuzzer" if fuzzing else "")
    sources = [NATIVE / f"{name}_fuzz.c", *([] if fuzzing else [NATIVE / "replay_main.c"])]
    command = [
        compiler,
        *_FLAGS,
        sanitizers,
        f"-I{core}/_core",
        f"-I{core}/include",
        f"-I{NATIVE}",
        *map(str, sources),
    ]
    done = subprocess.run(
        [*command, "-o", str(program), "-lpthread"], capture_output=True, text=True, check=False
    )
    if "libclang_rt" in done.stderr and "cannot find" in done.stderr:
        raise Unbuildable("Debian package libclang-rt-14-dev is missing")
    if done.returncode:
        raise RuntimeError(f"{name} does not compile:\n{done.stderr}")
    return program


@cache
def plans_and_seeds(path: Path) -> list[list[bytes]]:
    """Write the plans that both targets use; return messages of each type to begin with."""
    return export(path, every_type(), 1)


def seeds(name: str, plans: Path) -> Iterator[bytes]:
    """Yield inputs to begin with: for the codec a message and a record of every type."""
    if name == "channel":
        # Steps by chance: a program of them is what no mutation makes out of nothing.
        yield from (random.Random(number).randbytes(40 + 8 * number) for number in range(60))
        return
    for number, messages in enumerate(plans_and_seeds(plans)):
        kind = number.to_bytes(2, "little")
        for message in messages:
            yield kind + b"\0" + message[:_LONGEST]
        yield kind + b"\5" + b"\xff" * _LONGEST  # a record whose counts are all too large
