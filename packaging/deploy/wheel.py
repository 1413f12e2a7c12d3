"""A wheel of this checkout, for this machine or for another architecture; and running other programs."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

__all__ = ["PIP", "ROOT", "UNWANTED", "DeployError", "build_wheel", "copy_source", "project_version", "run"]

ROOT = Path(__file__).resolve().parents[2]
PIP = (sys.executable, "-m", "pip", "--disable-pip-version-check")
UNWANTED = shutil.ignore_patterns("*.so", "*.o", "__pycache__", "*.egg-info")
"""What lies about in a tree and belongs in no package."""
_VERSION = re.compile(r'(?m)^__version__ = "([^"]+)"$')


def project_version(source: Path = ROOT) -> str:
    """Return the version of a source tree, without importing it."""
    found = _VERSION.search((source / "src/rosplc/_version.py").read_text(encoding="utf-8"))
    assert found is not None
    return found[1]


def copy_source(target: Path, version: str | None = None) -> Path:
    """Copy what a wheel is built from, so that nothing that lies about in the tree gets into it.

    Args:
        target: A folder that does not exist yet.
        version: The version that the copy gets; None keeps it.

    Returns:
        The folder.
    """
    shutil.copytree(ROOT / "src", target / "src", ignore=UNWANTED)
    for name in ("pyproject.toml", "setup.py", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, target / name)
    if version is not None:
        path = target / "src/rosplc/_version.py"
        text = _VERSION.sub(f'__version__ = "{version}"', path.read_text(encoding="utf-8"))
        path.write_text(text, encoding="utf-8")
    return target


def build_wheel(
    folder: Path, *, version: str | None = None, environment: Mapping[str, str] | None = None
) -> Path:
    """Build a wheel.

    Args:
        folder: Gets the wheel, and a copy of the sources; made if it does not exist.
        version: Another version than the checkout's, to try an upgrade.
        environment: The build's environment: what makes a compiler build for another machine.

    Returns:
        The wheel.

    Raises:
        DeployError: The build failed.
    """
    folder.mkdir(parents=True, exist_ok=True)
    source = copy_source(folder / "source", version)
    command = (*PIP, "wheel", "--no-deps", "--no-build-isolation", "--wheel-dir", str(folder), ".")
    run(command, cwd=source, environment=environment)
    shutil.rmtree(source)
    (wheel,) = folder.glob("rosplc-*.whl")
    return wheel


class DeployError(Exception):
    """A step did not work; the text says which, and what it printed."""


def run(
    command: Sequence[str | Path],
    *,
    cwd: Path | None = None,
    environment: Mapping[str, str] | None = None,
    seconds: float = 900.0,
) -> str:
    """Run a program and return what it printed.

    Args:
        command: The program and its arguments.
        cwd: Where it runs.
        environment: Its environment; None for this process's own.
        seconds: When it is given up.

    Raises:
        DeployError: It does not exist, failed, or did not end in time.
    """
    words = [str(word) for word in command]
    try:
        done = subprocess.run(
            words, cwd=cwd, env=environment and dict(environment), stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, errors="replace", timeout=seconds,
            check=False,
        )  # fmt: skip
    except FileNotFoundError:
        raise DeployError(f"{words[0]} is not installed") from None
    except subprocess.TimeoutExpired:
        raise DeployError(f"{' '.join(words)}\ndid not end within {seconds:.0f} s") from None
    if done.returncode:
        raise DeployError(f"{' '.join(words)}\nended with {done.returncode}:\n{done.stdout}")
    return done.stdout
