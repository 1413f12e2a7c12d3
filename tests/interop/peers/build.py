"""Build the peers, once per content; and keep them in .cache."""

from __future__ import annotations

import fcntl
import hashlib
import shutil
import subprocess
from pathlib import Path

__all__ = ["KINDS", "NEEDS", "build"]

HERE = Path(__file__).parent
CACHE = HERE.parents[2] / ".cache" / "interop"

KINDS = ("cyclone", "cyclone-untyped", "fastdds")
"""Peers to build. `untyped` announces no XTypes information, as ROS 2's own layers on Cyclone do not."""

NEEDS = {
    "cyclone": ("cyclonedds-tools", "cyclonedds-dev"),
    "fastdds": ("fastddsgen", "g++", "libfastrtps-dev", "libfastcdr-dev"),
}
"""Debian packages by the first part of a kind's name."""


def _run(*command: str | Path, directory: Path) -> str:
    done = subprocess.run(
        [str(part) for part in command],
        cwd=directory,
        capture_output=True,
        text=True,
        check=False,
        timeout=240,
    )
    if done.returncode:
        raise RuntimeError(f"{command[0]} failed:\n{done.stdout}\n{done.stderr}")
    return done.stdout


def build(kind: str, *defines: str) -> Path:
    """Return the peer program of a kind, with preprocessor macros such as ``OTHER_DEFINITION``."""
    family = kind.partition("-")[0]
    digest = hashlib.sha256(repr((kind, defines)).encode())
    for source in sorted(HERE.iterdir()):
        if source.is_file():
            digest.update(source.read_bytes())
    for tool in ("idlc", "gcc") if family == "cyclone" else ("fastddsgen", "g++"):
        digest.update(str(Path(shutil.which(tool) or tool).stat().st_mtime_ns).encode())
    folder = CACHE / f"{kind}-{digest.hexdigest()[:16]}"
    folder.mkdir(parents=True, exist_ok=True)
    program = folder / "peer"
    with (folder / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not program.exists():
            _compile(family, kind, defines, folder)
            (folder / "new").rename(program)
    return program


def _compile(family: str, kind: str, defines: tuple[str, ...], folder: Path) -> None:
    macros = [f"-D{name}" for name in defines]
    idl = folder / "ros_types.idl"
    idl.write_text(_run("cpp", "-P", "-x", "c", *macros, HERE / "ros_types.idl", directory=folder))
    if family == "cyclone":
        untyped = ["-t"] if kind.endswith("untyped") else []
        _run("idlc", "-l", "c", *untyped, idl, directory=folder)
        _run(
            *("gcc", "-std=gnu11", "-O1", "-Wall", "-Wextra", "-Werror", *macros, "-I.", "-o", "new"),
            *(HERE / "cyclone_peer.c", "ros_types.c", "-lddsc"),
            directory=folder,
        )
    else:
        _run("fastddsgen", "-replace", "-ppDisable", idl, directory=folder)
        _run(
            *("g++", "-std=c++17", "-O1", *macros, "-I.", "-o", "new", HERE / "fastdds_peer.cpp"),
            *("ros_types.cxx", "ros_typesPubSubTypes.cxx", "-lfastrtps", "-lfastcdr"),
            directory=folder,
        )
