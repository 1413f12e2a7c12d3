"""What is installed: Python, the packages that rosplc needs, and the ways into ROS."""

from __future__ import annotations

import json
import re
import shlex
import sys
import sysconfig
from collections.abc import Callable, Iterator, Mapping
from importlib.metadata import PackageNotFoundError, distribution, requires, version
from importlib.util import find_spec
from pathlib import Path
from urllib.parse import unquote, urlparse

from rosplc.doctor.finding import Finding, Level
from rosplc.doctor.kinds import fine, found, judged
from rosplc.errors import RosplcError
from rosplc.ros import BACKENDS, INSTALL
from rosplc.ros.choice import choose, why_not_installed

_OPTIONAL = ("cyclonedds", "eclipse-zenoh")
_DDS_MACHINES = ("x86_64",)
_ZENOH_MACHINES = ("x86_64", "i686", "aarch64", "armv7l", "armv6l")


def needed() -> list[str]:
    """Return the names of the packages that rosplc cannot do without, from its own metadata."""
    try:
        lines = requires("rosplc") or []
    except PackageNotFoundError:
        return []
    return [name[0] for line in lines if ";" not in line and (name := re.match(r"[\w.-]+", line.strip()))]


def packages(
    names: list[str], python: str, release: str, *, version_of: Callable[[str], str] = version
) -> Iterator[Finding]:
    """Report the versions of what is installed, and what is missing of the required ``names``.

    ``version_of`` returns a package's version, or raises PackageNotFoundError.
    """
    present, missing = [], []
    for name in (*_OPTIONAL, *names):
        try:
            present.append(f"{name} {version_of(name)}")
        except PackageNotFoundError:
            missing += [] if name in _OPTIONAL else [name]
    if missing:
        command = pip_here(f"pip install {' '.join(missing)}")
        yield found("DOC110", f"not installed: {', '.join(missing)}", command=command)
    yield fine("DOC110", f"rosplc {release}, Python {python}, {', '.join(present) or 'nothing else'}")


def wheels(machine: str, python: tuple[int, int]) -> Iterator[Finding]:
    """Report which ways into ROS have no wheel on PyPI for this machine (``uname -m``) and Python."""
    missing = []
    if machine not in _DDS_MACHINES:
        missing.append(f"cyclonedds has none for {machine}")
    elif python >= (3, 14):
        missing.append(f"cyclonedds has none for Python {python[0]}.{python[1]}")
    if machine not in _ZENOH_MACHINES:
        missing.append(f"eclipse-zenoh has none for {machine}")
    remedy = "Use an installed ROS 2 (backend rclpy), Zenoh, or build the package."
    well = "PyPI has a wheel of cyclonedds and of eclipse-zenoh for this machine"
    yield judged("DOC111", f"wheels on PyPI: {'; '.join(missing)}" if missing else "", well, remedy)


def backend(
    distro: str,
    wanted: str,
    environment: Mapping[str, str],
    *,
    zenoh_settings: bool = False,
    services: bool = False,
    configured: bool = True,
    missing: Callable[[str], str] = why_not_installed,
) -> Iterator[Finding]:
    """Report which backend a bridge would use here, and why.

    ``wanted`` is ``ros.backend``; without a configuration a bad choice is only a warning; ``missing`` returns
    why a backend cannot be imported, empty if it can.
    """
    if wanted != "auto":
        reason = missing(wanted)
        seen = f"ros.backend is {wanted}, which is not installed: {reason}" if reason else ""
        remedy = f"For {wanted}: {INSTALL.get(wanted, 'a complete rosplc')}."
        yield judged("DOC113", seen, f"backend {wanted} is installed", remedy)
        return
    try:
        choice = choose(
            distro, environment, zenoh_settings=zenoh_settings, services=services, missing=missing
        )
    except RosplcError as error:
        level = Level.ERROR if configured else Level.WARNING
        yield found("DOC112", error.what, error.remedy, level=level)
        return
    usable = ", ".join(name for name in BACKENDS if name != "memory" and not missing(name))
    yield fine("DOC112", f"backend auto is {choice.name}, because {choice.why}; usable: {usable}")


def pip_here(text: str) -> str:
    """Return a text whose ``pip install`` and ``'rosplc[EXTRA]'`` are what works where rosplc is installed.

    That is the pip of a virtual environment, ``pipx inject`` in one that pipx made, a new virtual environment
    where the system manages Python (PEP 668) or the environment has no pip, as the Debian package's, and the
    checkout's path for an editable installation.
    """
    python, prefix = shlex.quote(sys.executable), Path(sys.prefix)
    pip = prefix / "bin" / "pip"
    managed = Path(sysconfig.get_path("stdlib"), "EXTERNALLY-MANAGED").exists()
    command = f"{shlex.quote(str(pip)) if pip.exists() else f'{python} -m pip'} install"
    if (prefix / "pipx_metadata.json").exists():
        command = f"pipx inject {shlex.quote(prefix.name)}"
        text = re.sub(r"'rosplc\[(\w+)\]'", lambda found: _brought_by(found[1]), text)
    elif (sys.prefix == sys.base_prefix and managed) or find_spec("pip") is None:
        command = f"{python} -m venv ~/rosplc-env && ~/rosplc-env/bin/pip install"
        command += "" if "'rosplc[" in text else " rosplc"
    text = re.sub(r"(?<![\w/-])pip install", lambda _: command, text)
    try:
        origin = json.loads(distribution("rosplc").read_text("direct_url.json") or "{}")
    except (PackageNotFoundError, ValueError):
        return text
    if not origin.get("dir_info", {}).get("editable"):
        return text
    folder = unquote(urlparse(origin["url"]).path)
    return re.sub(r"'rosplc(\[\w+\])'", lambda found: f"-e {shlex.quote(folder + found[1])}", text)


def _brought_by(extra: str) -> str:
    lines = [line.partition(";") for line in requires("rosplc") or []]
    return " ".join(shlex.quote(name.strip()) for name, _, when in lines if f'extra == "{extra}"' in when)
