"""Build the peers, once per content; what is missing is said as the Debian package to install."""

from __future__ import annotations

import fcntl
import hashlib
import shutil
import subprocess
from pathlib import Path

__all__ = ["KINDS", "MissingPackageError", "build"]

HERE = Path(__file__).parent
CACHE = HERE.parents[2] / ".cache" / "interop"

KINDS = ("cyclone", "cyclone-untyped", "fastdds")
"""Peers to build. `untyped` announces no XTypes information, as ROS 2's own layers on Cyclone do not."""

_NEEDS = {
    "cyclone": {"idlc": "cyclonedds-tools", "gcc": "gcc", "/usr/include/dds/dds.h": "cyclonedds-dev"},
    "fastdds": {
        "fastddsgen": "fastddsgen",
        "g++": "g++",
        "/usr/include/fastrtps/Domain.h": "libfastrtps-dev",
        "/usr/include/fastcdr/Cdr.h": "libfastcdr-dev",
    },
}


class MissingPackageError(Exception):
    """A Debian package is needed that is not installed."""


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
    """Return the peer program of a kind, with preprocessor macros such as ``OTHER_DEFINITION``.

    Raises:
        MissingPackageError: Its text is the name of the Debian package.
    """
    family = kind.partition("-")[0]
    for needed, package in _NEEDS[family].items():
        if not (Path(needed).exists() if needed.startswith("/") else shutil.which(needed)):
            raise MissingPackageError(package)
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
