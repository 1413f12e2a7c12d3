"""A Debian package: an environment of Debian's Python with rosplc and all it needs, in /opt/rosplc.

``make deb`` builds one for this machine; ``make deb DEB_OPTIONS="--board armhf"`` (or ``arm64``) for a
board, in an emulated Debian. Python's minor version is part of what the package depends on, so it fits
the Debian release that it was built on.
"""

from __future__ import annotations

import argparse
import gzip
import os
import re
import shutil
import struct
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from deploy.board import ARCHITECTURES, Board
from deploy.wheel import PIP, ROOT, UNWANTED, DeployError, build_wheel, project_version, run

__all__ = [
    "EXTRAS", "Target", "build_for_board", "build_here", "debian_version", "install_into", "main",
    "make_environment", "pack", "pack_board",
]  # fmt: skip

EXTRAS = ("zenoh", "views")
"""What the package has beside the base: the way into ROS that every architecture has, and the views."""
SHARED = ("python3-numpy",)
"""Debian's packages in place of PyPI's, whose wheel brings a library of linear algebra of its own."""
_PYTHON = Path("/usr/bin/python3")
_HOME = Path("opt/rosplc")
_SCRIPTS = ROOT / "packaging" / "debian"
_MAINTAINER_SCRIPTS = ("postinst", "prerm", "postrm")
_CONFFILE_FOLDER = Path("etc/rosplc")
_PAGES = ("README.md", "docs/**/*.md", "spec/*.md")
_UNUSED = (
    # What programs are built or checked with, and what tests the packages themselves.
    *(f"**/*.{suffix}" for suffix in ("a", "c", "h", "pc", "pxd", "pyi", "pyx")),
    "**/tests/**/*", "*.dist-info/sboms/*",
    # Programs, and second copies: cyclonedds loads what is in cyclonedds.libs, CPython zstandard's backend_c.
    "apsw/sqlite_extra_binaries/*", "cyclonedds/.libs/*", "cyclonedds/tools/**/*", "zstandard/_cffi.*.so",
)  # fmt: skip
"""Files below site-packages, rosplc's own and licences apart, that nothing loads at run time."""
_UNCOMPILED = "pygments/(lexers|styles)/|textual/demo/|pydantic/v1/"
"""Modules that no verb imports: they work without bytecode, only slower."""


@dataclass(frozen=True)
class Target:
    """What a package is for.

    Attributes:
        architecture: As Debian names it: amd64, arm64, armhf.
        python: Minor version of Python 3 there.
        libc: Version of the C library there.
        packages: Debian packages that take the place of Python packages.
        strip: The program that takes symbols out of libraries.
    """

    architecture: str
    python: int
    libc: str
    packages: tuple[str, ...] = ()
    strip: str = "strip"

    @classmethod
    def here(cls) -> Target:
        """Return this machine.

        Raises:
            DeployError: It is no Debian, or has no Python of Debian's.
        """
        if not _PYTHON.exists():
            raise DeployError("Debian's python3 is missing: apt-get install python3 python3-venv")
        minor = int(run([_PYTHON, "-c", "import sys; print(sys.version_info[1])"]))
        architecture = run(["dpkg", "--print-architecture"]).strip()
        libc = (os.confstr("CS_GNU_LIBC_VERSION") or "glibc 2.36").split()[-1]
        return cls(architecture, minor, libc, SHARED)

    def depends(self) -> str:
        """Return the package's ``Depends``."""
        python = f"python3 (>= 3.{self.python}~), python3 (<< 3.{self.python + 1})"
        return ", ".join((python, f"libc6 (>= {self.libc})", "libstdc++6", "passwd", *self.packages))


def debian_version(version: str) -> str:
    """Return a Python version as Debian orders it: ``1.0rc1`` comes before ``1.0``."""
    return re.sub(r"\.?(dev|a|b|rc)(\d+)", r"~\1\2", version)


def make_environment(stage: Path) -> Path:
    """Make an empty environment of Debian's Python where the package will have it.

    Args:
        stage: The folder that stands for the machine's root.
    """
    home = stage / _HOME
    home.parent.mkdir(parents=True)
    run([_PYTHON, "-m", "venv", "--without-pip", home])
    return home


def install_into(stage: Path, wheel: Path, extras: Sequence[str] = EXTRAS, *, alone: bool = False) -> None:
    """Install a wheel into a stage's environment.

    Args:
        stage: Where :func:`make_environment` made it.
        wheel: The wheel.
        extras: Which of rosplc's extras.
        alone: Without what it needs, which is there already.
    """
    what = f"{wheel}[{','.join(extras)}]" if extras else str(wheel)
    options = ["--no-deps", "--force-reinstall"] if alone else []
    command: list[str | Path] = [*PIP, "--python", stage / _HOME / "bin/python", "install", "--quiet"]
    run([*command, "--no-compile", "--only-binary=:all:", *options, what])


def _slim(packages: Path, target: Target) -> None:
    """Leave out of site-packages what Debian has or nothing loads at run time, and symbols of libraries."""
    for name in (package.removeprefix("python3-") for package in target.packages):
        for kind in ("", ".libs", "-*.dist-info"):
            for path in packages.glob(name + kind):
                shutil.rmtree(path)
    for path in {path for pattern in _UNUSED for path in packages.glob(pattern)}:
        if path.is_file() and packages / "rosplc" not in path.parents and "licen" not in path.name.lower():
            path.unlink()
    for folder in sorted((path for path in packages.rglob("*") if path.is_dir()), reverse=True):
        if not any(folder.iterdir()):
            folder.rmdir()
    for path in packages.rglob("*.so*"):
        stripped = path.with_name("stripped")
        run([target.strip, "--strip-unneeded", "-o", stripped, path])
        # strip breaks some libraries that patchelf has rewritten for a wheel; they stay as they are.
        if _loads(stripped.read_bytes()):
            stripped.replace(path)
        else:
            stripped.unlink()


def _loads(elf: bytes) -> bool:
    """Return whether each segment of a library lies where its address wants it, as the loader demands."""
    wide = elf[4] == 2
    (start,) = struct.unpack_from("<Q" if wide else "<I", elf, 32 if wide else 28)
    size, count = struct.unpack_from("<HH", elf, 54 if wide else 42)
    for place in range(start, start + size * count, size):
        kind, *rest = struct.unpack_from("<I4x6Q" if wide else "<8I", elf, place)
        if kind == 1 and (rest[0] - rest[1]) % rest[-1]:
            return False
    return True


def _settle(stage: Path) -> None:
    """Make the environment one that was made at its place on the machine."""
    home = stage / _HOME
    for path in (home / "bin").iterdir():
        if not path.name.startswith(("python", "rosplc")):
            path.unlink()
        elif path.is_file() and not path.is_symlink():
            path.write_bytes(path.read_bytes().replace(str(stage).encode(), b""))
    settings = home / "pyvenv.cfg"
    text = re.sub(r"(?m)^command.*\n", "", settings.read_text(encoding="utf-8"))
    # For what Debian brings. Not before: pip would leave out everything that this machine has of Debian's.
    text = re.sub(r"(?m)^(include-system-site-packages = ).*", r"\1true", text)
    settings.write_text(text, encoding="utf-8")
    for path in home.rglob("direct_url.json"):  # where the wheel was installed from
        path.unlink()
    # Compiled now, as the service may not write there; each file with the name that it will have.
    run([_PYTHON, "-m", "compileall", "-q", "-x", _UNCOMPILED, "-s", stage, "-p", "/", home / "lib"])
    for path in home.rglob("*"):
        if path.is_file() and not path.is_symlink() and str(stage).encode() in path.read_bytes():
            raise DeployError(f"{path} still names the folder that the package was built in")


def pack(stage: Path, folder: Path, version: str, target: Target) -> Path:
    """Make a package of a stage.

    Args:
        stage: The folder that stands for the machine's root, with the environment in it.
        folder: Gets the package.
        version: rosplc's version.
        target: What the package is for.
    """
    (packages,) = (stage / _HOME).glob("lib/python3*/site-packages")
    _slim(packages, target)
    _settle(stage)
    (stage / "usr/bin").mkdir(parents=True, exist_ok=True)
    link = stage / "usr/bin/rosplc"
    if not link.is_symlink():
        link.symlink_to("/opt/rosplc/bin/rosplc")
    (stage / _CONFFILE_FOLDER).mkdir(parents=True, exist_ok=True)
    _write_documents(stage / "usr/share/doc/rosplc")
    _write_headers(stage, version)
    run([sys.executable, ROOT / "tools/man_pages.py", stage, version])
    control = stage / "DEBIAN"
    control.mkdir(exist_ok=True)
    for name in _MAINTAINER_SCRIPTS:
        shutil.copy(_SCRIPTS / name, control / name)
        (control / name).chmod(0o755)
    size = sum(path.lstat().st_size for path in stage.rglob("*")) // 1024
    text = (_SCRIPTS / "control.in").read_text(encoding="utf-8")
    name, machine = debian_version(version), target.architecture
    text = text.format(version=name, architecture=machine, size=size, depends=target.depends())
    (control / "control").write_text(text, encoding="utf-8")
    folder.mkdir(parents=True, exist_ok=True)
    package = folder / f"rosplc_{name}_{machine}.deb"
    run(["dpkg-deb", "--root-owner-group", "--build", stage, package])
    return package


def _write_headers(stage: Path, version: str) -> None:
    """Put the C headers where compilers look, and a file for pkg-config beside them."""
    headers = stage / "usr/include/rosplc"
    shutil.rmtree(headers, ignore_errors=True)
    (installed,) = (stage / _HOME).glob("lib/python3*/site-packages/rosplc/include/rosplc")
    shutil.copytree(installed, headers)
    folder = stage / "usr/share/pkgconfig"
    folder.mkdir(parents=True, exist_ok=True)
    text = (_SCRIPTS / "rosplc.pc.in").read_text(encoding="utf-8")
    (folder / "rosplc.pc").write_text(text.format(version=version), encoding="utf-8")


def _write_documents(folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    licence = (ROOT / "LICENSE").read_text(encoding="utf-8")
    intro = (
        "rosplc, copyright The rosplc developers, is under the licence below. What it runs with lies in\n"
        "/opt/rosplc/lib, each package with its own licence in the folder NAME.dist-info.\n\n"
    )
    (folder / "copyright").write_text(intro + licence, encoding="utf-8")
    changes = (ROOT / "CHANGELOG.md").read_bytes()
    (folder / "changelog.gz").write_bytes(gzip.compress(changes, mtime=0))
    for page in (page for pattern in _PAGES for page in ROOT.glob(pattern)):
        copy = folder / page.relative_to(ROOT)
        copy.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(page, copy)
    shutil.copytree(ROOT / "examples", folder / "examples", ignore=UNWANTED, dirs_exist_ok=True)


def build_for_board(folder: Path, name: str, suite: str) -> Path:
    """Build the package for a board, in that board's Debian.

    Args:
        folder: Gets the package.
        name: The board's architecture: a key of :data:`deploy.board.ARCHITECTURES`.
        suite: The board's release of Debian.

    Returns:
        The package.

    Raises:
        DeployError: A step failed, or something is missing.
    """
    with tempfile.TemporaryDirectory(prefix="rosplc-deb-") as work:
        board = Board(Path(work) / "board", ARCHITECTURES[name])
        print(f"[1/3] fetching Debian {suite} for {name}", flush=True)
        board.make(suite)
        print("[2/3] building and installing rosplc and what it needs there", flush=True)
        board.install(Path(work) / "wheels")
        print("[3/3] packing", flush=True)
        return pack_board(board, Path(work) / "stage", folder, project_version())


def pack_board(board: Board, stage: Path, folder: Path, version: str) -> Path:
    """Make a package of what is installed on a board.

    Args:
        board: The board, with rosplc installed.
        stage: A folder that does not exist yet.
        folder: Gets the package.
        version: rosplc's version.
    """
    os.umask(0o022)
    shutil.copytree(board.root / _HOME, stage / _HOME, symlinks=True)
    minor = board.python_version()[1]
    kind = board.architecture
    target = Target(kind.name, minor, board.libc(), kind.debian, f"{kind.triplet}-strip")
    return pack(stage, folder, version, target)


def build_here(folder: Path, extras: Sequence[str] = EXTRAS) -> Path:
    """Build the package for this machine.

    Args:
        folder: Gets the package.
        extras: Which of rosplc's extras it has.

    Returns:
        The package.

    Raises:
        DeployError: A step failed, or something is missing.
    """
    target = Target.here()
    with tempfile.TemporaryDirectory(prefix="rosplc-deb-") as name:
        work = Path(name)
        print("[1/4] building the wheel", flush=True)
        wheel = build_wheel(work / "wheel")
        print("[2/4] making an environment of Debian's Python", flush=True)
        stage = work / "stage"
        make_environment(stage)
        print("[3/4] installing rosplc and what it needs into it", flush=True)
        install_into(stage, wheel, extras)
        print("[4/4] packing", flush=True)
        os.umask(0o022)
        return pack(stage, folder, project_version(), target)


def main(arguments: Sequence[str] | None = None) -> int:
    """Build a package, and print its name."""
    parser = argparse.ArgumentParser(prog="python -m deploy.deb", description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "dist", help="where it goes (default: dist)")
    parser.add_argument("--extras", default=",".join(EXTRAS), help="comma-separated (default: %(default)s)")
    parser.add_argument(
        "--board", choices=sorted(ARCHITECTURES), help="build for this, in an emulated Debian"
    )
    parser.add_argument("--suite", default="bookworm", help="the board's Debian (default: %(default)s)")
    options = parser.parse_args(arguments)
    extras = tuple(word for word in options.extras.split(",") if word)
    folder = options.out.absolute()
    try:
        on_board = options.board
        print(build_for_board(folder, on_board, options.suite) if on_board else build_here(folder, extras))
    except DeployError as error:
        print(f"deploy: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
