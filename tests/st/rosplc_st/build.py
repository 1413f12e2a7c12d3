"""From Structured Text to a shared library or program, built once per distinct text."""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from rosplc_st.translator import Options, Translation, translate

__all__ = ["ARMHF", "Build", "Toolchain", "build"]

_HERE = Path(__file__).resolve().parent
_CACHE = _HERE.parents[2] / ".cache" / "st"
_RUNTIME = ("st_runtime.c", "st_semaphore.c")
_FLAGS = ("-std=gnu11", "-fwrapv", "-fno-strict-aliasing", "-Wall", "-Wno-unused", "-Wno-stringop-overread",
          "-Wno-attributes", "-Wno-discarded-qualifiers", "-Wno-ignored-qualifiers")  # fmt: skip


@dataclass(frozen=True)
class Toolchain:
    """A compiler, and how its programs are started."""

    compiler: str = "gcc"
    flags: tuple[str, ...] = ("-O1",)
    runner: tuple[str, ...] = ()


ARMHF = Toolchain("arm-linux-gnueabihf-gcc", ("-O1",), ("qemu-arm", "-L", "/usr/arm-linux-gnueabihf"))


@dataclass(frozen=True)
class Build:
    """A built program: what was declared, and the file."""

    translation: Translation
    path: Path
    toolchain: Toolchain


def build(
    texts: Mapping[str, str],
    options: Options | None = None,
    toolchain: Toolchain | None = None,
    *,
    program: bool = False,
) -> Build:
    """Translate and compile objects, given as texts by their names.

    Args:
        texts: The objects.
        options: What depends on the target.
        toolchain: The compiler; by default the machine's own gcc.
        program: A program that is driven through its stdin, instead of a library.

    Raises:
        TranslationError: Something is unknown, or CODESYS would refuse it.
        RuntimeError: The C text does not compile: the translator is wrong.
    """
    toolchain = toolchain or Toolchain()
    translation = translate(texts, options)
    runtime = [_HERE / "runtime" / name for name in ("st_runtime.h", *_RUNTIME, "st_main.c")]
    digest = hashlib.sha256(translation.code.encode())
    for file in runtime:
        digest.update(file.read_bytes())
    digest.update(repr((toolchain, program, _FLAGS)).encode())
    path = _CACHE / f"{digest.hexdigest()[:32]}{'' if program else '.so'}"
    if not path.exists():
        _compile(translation.code, path, toolchain, program)
    return Build(translation, path, toolchain)


def _compile(code: str, path: Path, toolchain: Toolchain, program: bool) -> None:
    compiler = shutil.which(toolchain.compiler)
    if compiler is None:
        raise RuntimeError(f"{toolchain.compiler} is missing")
    path.parent.mkdir(parents=True, exist_ok=True)
    source = path.with_suffix(f".{os.getpid()}.c")
    target = path.with_suffix(f".{os.getpid()}.tmp")
    source.write_text(code)
    sources = [str(source), *(str(_HERE / "runtime" / name) for name in _RUNTIME)]
    if program:
        sources.append(str(_HERE / "runtime" / "st_main.c"))
    shape = [] if program else ["-fPIC", "-shared"]
    command = [compiler, *_FLAGS, *toolchain.flags, *shape, "-I", str(_HERE / "runtime"), "-o", str(target)]
    done = subprocess.run(
        [*command, *sources, "-lm", "-pthread"], capture_output=True, text=True, check=False
    )
    if done.returncode:
        raise RuntimeError(f"gcc refuses {source}:\n{done.stderr[:4000]}")
    source.unlink()
    target.replace(path)
