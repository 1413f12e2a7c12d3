"""The contenders in C are compiled on the machine that they are measured on, and kept."""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from pathlib import Path

import rosplc
from rosplc.errors import SetupError
from rosplc_bench.run import Context, Missing

SOURCES = Path(__file__).resolve().parent / "c"
CORE = Path(rosplc.__file__).resolve().parent / "include"
FLAGS = ("-std=gnu11", "-O2")


def compile_program(
    name: str, cache: Path, *, extra: Sequence[Path] = (), options: Sequence[str] = ()
) -> Path:
    """Return the program that ``c/NAME.c`` becomes; an earlier one of the same sources is used again.

    Args:
        name: The source's name.
        cache: Where programs are kept.
        extra: Further sources.
        options: What else the compiler needs: folders of headers, libraries.

    Raises:
        Missing: There is no compiler.
        SetupError: SYS009, it does not compile; SYS005, the cache cannot be written.
    """
    compiler = shutil.which("gcc")
    if compiler is None:
        raise Missing("gcc is missing", "sudo apt-get install gcc libc6-dev")
    command = [compiler, *FLAGS, f"-I{CORE}", f"-I{SOURCES}"]
    sources = [SOURCES / f"{name}.c", *extra]
    tail = [*map(str, sources), *options, "-pthread", "-lrt"]
    program = cache / f"{name}-{_fingerprint(command + tail, sources)}"
    if program.is_file():
        return program
    try:
        cache.mkdir(parents=True, exist_ok=True)
        # Two runs may compile at once: each renames a finished program into its place.
        fd, made = tempfile.mkstemp(prefix=f".{name}-", dir=cache)
    except OSError as error:
        raise SetupError("SYS005", f"cannot write: {error.strerror}", where=str(cache)) from error
    os.close(fd)
    try:
        done = subprocess.run([*command, "-o", made, *tail], capture_output=True, text=True, check=False)
        if done.returncode:
            raise SetupError("SYS009", f"gcc cannot compile {name}.c:\n{done.stderr.strip()}")
        Path(made).rename(program)
    finally:
        Path(made).unlink(missing_ok=True)
    return program


def _fingerprint(command: Sequence[str], sources: Sequence[Path]) -> str:
    found = hashlib.sha256("\0".join(command).encode())
    for path in (*sources, *sorted(SOURCES.glob("*.h")), *sorted(CORE.glob("rosplc/*.h"))):
        found.update(path.read_bytes())
    return found.hexdigest()[:16]


def find_library(name: str, package: str) -> tuple[str, ...]:
    """Return what the compiler needs for a library, as pkg-config knows it.

    Raises:
        Missing: The library is not installed; the remedy names its Debian package.
    """
    remedy = f"sudo apt-get install {package} pkg-config"
    try:
        found = subprocess.run(
            ["pkg-config", "--cflags", "--libs", name], capture_output=True, text=True, check=False
        )
    except OSError:
        raise Missing("pkg-config is missing", remedy) from None
    if found.returncode:
        raise Missing(f"{package} is missing", remedy)
    return tuple(found.stdout.split())


def compile_with_modbus(context: Context, what: str, name: str) -> tuple[Path | None, bool]:
    """Return a program, None without a compiler, and whether it knows Modbus; note what is missing."""
    options: tuple[str, ...] = ()
    with context.leaving_out(f"{what} over libmodbus"):
        options = ("-DWITH_MODBUS", *find_library("libmodbus", "libmodbus-dev"))
    try:
        return compile_program(name, context.cache, options=options), bool(options)
    except Missing as missing:
        context.skip(f"{what} in C", missing.reason, missing.remedy)
        return None, False
