"""From Structured Text to a shared library or program, built once per distinct text."""

from __future__ import annotations

import fcntl
import hashlib
import pickle
import shutil
import subprocess
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

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
    progress: Callable[[int, int], None] | None = None,
) -> Build:
    """Translate and compile objects, given as texts by their names.

    Args:
        texts: The objects.
        options: What depends on the target.
        toolchain: The compiler; by default the machine's own gcc.
        program: A program that is driven through its stdin, instead of a library.
        progress: Called with how many unknown texts are parsed, and of how many.

    Raises:
        TranslationError: Something is unknown, or CODESYS would refuse it.
        RuntimeError: The C text does not compile: the translator is wrong.
    """
    toolchain, options = toolchain or Toolchain(), options or Options()
    digest = hashlib.sha256(repr((list(texts.items()), options, toolchain, program, _FLAGS)).encode())
    digest.update(_sources())
    path = _CACHE / f"{digest.hexdigest()[:32]}{'' if program else '.so'}"
    declared = path.with_suffix(".pickle")
    _CACHE.mkdir(parents=True, exist_ok=True)
    # Other processes are likely to want the same at the same time.
    with path.with_suffix(".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not declared.exists():
            translation = translate(texts, options, progress)
            _compile(translation.code, path, toolchain, program)
            temporary = path.with_suffix(".new")
            with temporary.open("wb") as file:
                _WithoutTrees(file, protocol=5).dump(translation)
            temporary.replace(declared)
    return Build(pickle.loads(declared.read_bytes()), path, toolchain)


@cache
def _sources() -> bytes:
    """Return a digest of the translator and of the runtime."""
    files = sorted([*_HERE.glob("translator/*.py"), *_HERE.glob("runtime/*")])
    return hashlib.sha256(b"".join(file.read_bytes() for file in files)).digest()


class _WithoutTrees(pickle.Pickler):
    """Leaves out the syntax trees: who runs a program needs its variables, and not the parser."""

    def reducer_override(self, obj: Any) -> Any:
        parsed = type(obj).__module__.partition(".")[0] in ("blark", "lark")
        return (type(None), ()) if parsed else NotImplemented


def _compile(code: str, path: Path, toolchain: Toolchain, program: bool) -> None:
    compiler = shutil.which(toolchain.compiler)
    if compiler is None:
        raise RuntimeError(f"{toolchain.compiler} is missing")
    source, target = path.with_suffix(".c"), path.with_suffix(".tmp")
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
