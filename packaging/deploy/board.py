"""A board's Debian on this machine: its packages, unpacked into a folder, run by an emulator.

Nothing on this machine is changed: the folder is entered in a mount namespace, and programs run through
``qemu-user`` as they would through the board's processor. They are that machine's programs, not its speed.
Needs root, and the Debian packages mmdebstrap and qemu-user; for compiled parts a cross-compiler.
"""

from __future__ import annotations

import os
import platform
import shutil
import sys
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from deploy.wheel import PIP, DeployError, build_wheel, run

__all__ = ["ARCHITECTURES", "Architecture", "Board", "fetch_debian"]

_PACKAGES = ("python3", "python3-venv", "libpython3-dev")
_HOME = Path("opt/rosplc")
# Debian's alternatives are not configured where packages were only unpacked.
_LIBRARIES = "/usr/lib/{0}/blas:/usr/lib/{0}/lapack"
_OTHER_NAMES = {"python3-yaml": "PyYAML", "python3-markupsafe": "MarkupSafe"}
"""Debian's name of a package → PyPI's, where more than the prefix differs."""
_ONLY_HERE = {"cyclonedds": "11.0"}
"""What pyproject.toml asks for on x86-64 alone, with a version that it takes."""
_COMMAND = """#!{home}/bin/python3
import sys

from rosplc.cli import main

sys.exit(main())
"""
_ENTER = """
set -e
cd "$1"
mkdir -p lib64 usr/lib/x86_64-linux-gnu dev proc
# The emulator is this machine's program, and so are the libraries that it is linked with.
[ -e lib64/ld-linux-x86-64.so.2 ] || cp -L /lib64/ld-linux-x86-64.so.2 lib64/
touch "usr/bin/$2" etc/resolv.conf etc/hosts
mount --bind "/usr/bin/$2" "usr/bin/$2"
mount --bind /usr/lib/x86_64-linux-gnu usr/lib/x86_64-linux-gnu
mount --rbind /dev dev
mount --rbind /proc proc
for each in /etc/resolv.conf /etc/hosts; do mount --bind "$each" "${each#/}"; done
root=$1; emulator=$2; shift 2
exec chroot "$root" "/usr/bin/$emulator" "$@"
"""


@dataclass(frozen=True)
class Architecture:
    """What differs from board to board.

    Attributes:
        name: As Debian names it.
        machine: As Linux and wheels name it.
        triplet: As compilers name it.
        emulator: The program that runs its programs.
        debian: Debian packages in place of Python packages that PyPI has no wheel of.
        sources: Python packages without a wheel and without such a Debian package: they are compiled.
    """

    name: str
    machine: str
    triplet: str
    emulator: str
    debian: tuple[str, ...] = ()
    sources: tuple[str, ...] = ()


ARCHITECTURES = {
    "armhf": Architecture(
        "armhf",
        "armv7l",
        "arm-linux-gnueabihf",
        "qemu-arm",
        ("python3-numpy", "python3-lz4", "python3-zstandard", "python3-yaml", "python3-markupsafe"),
        ("backports.zstd",),
    ),
    "arm64": Architecture("arm64", "aarch64", "aarch64-linux-gnu", "qemu-aarch64"),
}


class Board:
    """A board's Debian in a folder.

    Args:
        root: The folder.
        architecture: What kind of board.

    Raises:
        DeployError: This machine cannot do it, with what is missing.
    """

    def __init__(self, root: Path, architecture: Architecture) -> None:
        self.root = root.absolute()
        self.architecture = architecture
        if platform.machine() != "x86_64":
            raise DeployError("boards are emulated on x86-64 only")
        if os.geteuid() != 0:
            raise DeployError("only root may enter another Debian's folder")
        for program, package in (
            ("mmdebstrap", "mmdebstrap"),
            (architecture.emulator, "qemu-user"),
            (f"{architecture.triplet}-gcc", f"gcc-{architecture.triplet}"),
        ):
            if shutil.which(program) is None:
                raise DeployError(f"Debian package {package} is missing")

    def make(self, suite: str = "bookworm", more: Sequence[str] = ()) -> None:
        """Fetch Debian's packages for the board, and unpack them.

        Args:
            suite: Debian's release.
            more: Packages beside those that rosplc needs.
        """
        packages = ",".join((*_PACKAGES, *self.architecture.debian, *more))
        architecture = f"--architectures={self.architecture.name}"
        fetch_debian(self.root, suite, "--variant=extract", architecture, f"--include={packages}")

    def command(self, *words: object, argv0: str = "") -> list[str]:
        """Return the command line that runs a program of the board.

        Args:
            words: The program, by its path on the board, and its arguments.
            argv0: What the program is told that it was called as.
        """
        called = ["-0", argv0] if argv0 else []
        enter = ["unshare", "--mount", "sh", "-c", _ENTER, "sh", str(self.root), self.architecture.emulator]
        return [*enter, *called, *map(str, words)]

    @property
    def environment(self) -> dict[str, str]:
        """The environment that programs of the board run in."""
        kept = {key: value for key, value in os.environ.items() if key.startswith("ROS_")}
        libraries = _LIBRARIES.format(self.architecture.triplet)
        return {
            **kept,
            "PATH": "/usr/sbin:/usr/bin:/sbin:/bin",
            "LD_LIBRARY_PATH": libraries,
            "LC_ALL": "C.UTF-8",
        }

    def python(self, *arguments: object) -> list[str]:
        """Return the command line of the board's Python, in rosplc's environment there.

        By the interpreter's own path and not the environment's link, as nothing registers the emulator.
        """
        return self.command("/usr/bin/python3", *arguments, argv0=f"/{_HOME}/bin/python3")

    def run(self, *arguments: object, seconds: float = 900.0) -> str:
        """Run the board's Python to its end, and return what it printed."""
        return run(self.python(*arguments), environment=self.environment, seconds=seconds)

    def install(self, wheels: Path, extras: Sequence[str] = ("zenoh",), version: str | None = None) -> Path:
        """Install rosplc into an environment of the board's Python at ``/opt/rosplc``.

        What has to be compiled is compiled here, for the board, and everything else comes from PyPI.

        Args:
            wheels: A folder for the wheels that are built.
            extras: Which of rosplc's extras.
            version: Another version than the checkout's.

        Returns:
            rosplc's wheel.
        """
        environment = self._cross()
        wheel = build_wheel(wheels, version=version, environment=environment)
        for source in self.architecture.sources:
            command = (*PIP, "wheel", "--quiet", "--no-deps", "--no-build-isolation", "--no-binary", source)
            run([*command, "--wheel-dir", wheels, source], environment=environment)
        # pip asks this machine, not the board, whether a condition such as platform_machine holds.
        absent = {name: _placeholder(wheels, name, version) for name, version in _ONLY_HERE.items()}
        for package in self.architecture.debian:
            name = _OTHER_NAMES.get(package, package.removeprefix("python3-"))
            found = next((self.root / "usr/lib/python3/dist-packages").glob(f"{name}-*-info"))
            absent[name] = _placeholder(wheels, name, found.name.split("-")[1].rpartition(".")[0])
        home = self.root / _HOME
        if not home.exists():
            self.run_plain("-m", "venv", "--without-pip", "--system-site-packages", f"/{_HOME}")
        # This machine's pip chooses and unpacks, for the board; the board's own would take minutes.
        packages = home / f"lib/python{'.'.join(map(str, self.python_version()))}/site-packages"
        what = f"{wheel}[{','.join(extras)}]" if extras else str(wheel)
        where: list[str | Path] = ["--target", packages, "--upgrade", "--find-links", wheels]
        run([*PIP, "install", "--quiet", "--no-compile", *self._platform(), *where, what])
        for name, placeholder in absent.items():
            placeholder.unlink()
            for path in packages.glob(f"{name}-*.dist-info"):
                shutil.rmtree(path)
        shutil.rmtree(packages / "bin", ignore_errors=True)
        command_file = home / "bin/rosplc"
        command_file.write_text(_COMMAND.format(home=f"/{_HOME}"), encoding="utf-8")
        command_file.chmod(0o755)
        return wheel

    def _platform(self) -> list[str]:
        """Return pip's options that make it install for the board."""
        minor, machine = self.python_version()[1], self.architecture.machine
        libc = int(self.libc().split(".")[1])
        tags = [f"manylinux_2_{number}_{machine}" for number in range(libc, 16, -1)]
        options = ["--only-binary=:all:", "--implementation=cp", f"--python-version=3.{minor}"]
        options += [f"--abi={abi}" for abi in (f"cp3{minor}", "abi3", "none")]
        return options + [
            f"--platform={tag}" for tag in (*tags, f"manylinux2014_{machine}", f"linux_{machine}")
        ]

    def run_plain(self, *arguments: object) -> str:
        """Run the board's Python outside any environment, and return what it printed."""
        return run(self.command("/usr/bin/python3", *arguments), environment=self.environment)

    def _cross(self) -> dict[str, str]:
        """Return the environment in which this Python builds wheels for the board's."""
        python = self.python_version()
        if python != sys.version_info[:2]:
            here = ".".join(map(str, sys.version_info[:2]))
            raise DeployError(f"the board has Python {python[0]}.{python[1]}; build with it, not {here}")
        triplet, root = self.architecture.triplet, self.root
        name = f"_sysconfigdata__{triplet}"
        library = root / f"usr/lib/python{python[0]}.{python[1]}"
        # Alone in a folder: the board's whole library would hide this Python's own.
        data = root / "tmp/sysconfig"
        data.mkdir(parents=True, exist_ok=True)
        shutil.copy(library / f"{name}.py", data)
        include = root / f"usr/include/python{python[0]}.{python[1]}"
        compiler = f"{triplet}-gcc"
        return {
            **os.environ,
            "PYTHONPATH": str(data),
            "_PYTHON_SYSCONFIGDATA_NAME": name,
            "_PYTHON_HOST_PLATFORM": f"linux-{self.architecture.machine}",
            "CC": compiler,
            "LDSHARED": f"{compiler} -shared",
            "CFLAGS": f"-I{include} -I{root}/usr/include",
        }

    def python_version(self) -> tuple[int, int]:
        """Return major and minor version of the board's Python."""
        words = os.readlink(self.root / "usr/bin/python3").removeprefix("python").split(".")  # noqa: PTH115
        return int(words[0]), int(words[1])

    def libc(self) -> str:
        """Return the version of the board's C library."""
        found = self.run_plain("-c", "import os; print(os.confstr('CS_GNU_LIBC_VERSION'))")
        return found.split()[-1]


def fetch_debian(target: Path, suite: str, *options: str) -> None:
    """Fetch a Debian's packages from where this machine has its own, with mmdebstrap.

    Args:
        target: Gets them: a folder, or a file that ends in ``.tar``.
        suite: Debian's release.
        options: mmdebstrap's.
    """
    # One source, that of the release itself: two that are updated at different times may disagree.
    sources = run(
        [
            "apt-get", "indextargets", "Created-By: Packages", "Origin: Debian", f"Codename: {suite}",
            "--format", "deb $(REPO_URI) $(RELEASE) $(COMPONENT)",
        ]
    ).split("\n")  # fmt: skip
    source = sorted({line for line in sources if line})[:1]
    run(["mmdebstrap", "--quiet", *options, suite, target, *source])


def _placeholder(folder: Path, name: str, version: str) -> Path:
    """Write an empty wheel, for a package that pip must not look for, and return it."""
    information = f"{name}-{version}.dist-info"
    path = folder / f"{name}-{version}-py3-none-any.whl"
    with zipfile.ZipFile(path, "w") as wheel:
        wheel.writestr(
            f"{information}/METADATA", f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n"
        )
        wheel.writestr(
            f"{information}/WHEEL", "Wheel-Version: 1.0\nRoot-Is-Purelib: true\nTag: py3-none-any\n"
        )
        wheel.writestr(f"{information}/RECORD", "")
    return path
