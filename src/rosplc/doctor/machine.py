"""The machine itself: processor, clock, limits, logout, /dev/shm and installed packages."""

from __future__ import annotations

import configparser
import json
import os
import re
import resource
import shlex
import stat
import struct
import sys
import sysconfig
from collections.abc import Callable, Iterator, Mapping
from importlib.metadata import PackageNotFoundError, distribution, requires, version
from importlib.util import find_spec
from pathlib import Path
from urllib.parse import unquote, urlparse

from rosplc.doctor.finding import Finding, Level
from rosplc.doctor.kinds import fine, found, judged
from rosplc.doctor.rights import Mount
from rosplc.errors import RosplcError
from rosplc.harmless import plural
from rosplc.ros import BACKENDS, INSTALL
from rosplc.ros.choice import choose, why_not_installed

_TESTED = ("x86_64", "aarch64", "armv7l", "armv8l", "armv6l", "i686", "i386")
_WIDE = ("x86_64", "aarch64", "armv8l")
_RELEASED_S = 1_735_689_600  # 2025-01-01: earlier than this release
_CAP_IPC_LOCK, _CAP_SYS_NICE = 14, 23
_ENOUGH = 64 << 20
_FIRST_PERSON = 1000  # the first user number that logind takes for a person's (SYS_UID_MAX is 999)
_SERVICES = (*range(61_184, 65_520), 65_534)  # users that systemd makes for a service, and nobody
_MIB = 1 << 20


def architecture(
    machine: str, release: str, *, bits: int = struct.calcsize("P") * 8, byte_order: str = "little"
) -> Iterator[Finding]:
    """Judge the kernel (as ``uname -m`` and ``-r`` print it) and the word size of this Python."""
    seen, little = f"Linux {release} on {machine}", byte_order == "little"
    wrong = "" if machine in _TESTED else f"{seen}, on which rosplc is not tested"
    wrong = wrong if little else f"{seen}, which is big-endian"
    yield judged("DOC101", wrong, seen, level=None if little else Level.ERROR)
    mixed = f"Python is 32-bit on a 64-bit kernel ({machine})" if bits == 32 and machine in _WIDE else ""
    yield judged("DOC102", mixed, f"Python is {bits}-bit")


def clock(now_s: float) -> Iterator[Finding]:
    """Judge the time of day, in seconds since 1970."""
    unset = "the clock shows a time before 2025: it has not been set since the machine started"
    remedy = "Set the clock; a board without a battery needs NTP or PTP."
    seen = unset if now_s < _RELEASED_S else ""
    yield judged("DOC103", seen, "the clock shows a plausible time", remedy, "timedatectl set-ntp true")


def open_files(limit: int, topics: int) -> Iterator[Finding]:
    """Judge the soft limit on open files (``resource.RLIM_INFINITY``: none) for this number of topics."""
    # A lock file per topic at least; a memory, a semaphore and sockets of two ROS 1 peers at most.
    least, usual = 48 + topics, 128 + 4 * topics
    if limit == resource.RLIM_INFINITY or limit >= usual:
        allowed = "any number of" if limit == resource.RLIM_INFINITY else str(limit)
        yield fine("DOC104", f"{allowed} open files are allowed")
        return
    seen = f"{limit} open files are allowed, but {plural(topics, 'topic')} may need {least} to {usual} files"
    remedy = f"Raise the limit in the shell, or with LimitNOFILE={usual} in a systemd unit."
    level = Level.ERROR if limit < least else Level.WARNING
    yield found("DOC104", seen, remedy, f"ulimit -n {usual}", level)


def real_time(priority: int, locked: int, capabilities: int) -> Iterator[Finding]:
    """Report whether real-time priority and locked memory are permitted.

    ``priority`` and ``locked`` (bytes) are soft limits, ``resource.RLIM_INFINITY`` if unlimited;
    ``capabilities`` are the effective capabilities of the process, as a set of bits.
    """
    may_run = priority != 0 or capabilities >> _CAP_SYS_NICE & 1
    may_lock = locked == resource.RLIM_INFINITY or locked >= _ENOUGH or capabilities >> _CAP_IPC_LOCK & 1
    amount = "any amount" if locked == resource.RLIM_INFINITY else f"{locked >> 10} KiB"
    seen = f"this user may use real-time priority up to {priority} and lock {amount} of memory"
    remedy = "For real-time operation, set LimitRTPRIO= and LimitMEMLOCK= in the systemd unit."
    well = "real-time priority and locked memory are permitted"
    yield judged("DOC105", "" if may_run and may_lock else seen, well, remedy)


def logout(root: Path, uid: int, user: str) -> Iterator[Finding]:
    """Judge whether systemd removes the bridge's objects when their owner logs out.

    ``root`` contains ``etc`` and ``run``.
    """
    value, where = _remove_ipc(root)
    if not (root / "run/systemd/seats").is_dir():
        yield fine("DOC106", "systemd-logind is not running")
    elif not value:
        yield fine("DOC106", f"RemoveIPC=no is set in {where}")
    elif uid < _FIRST_PERSON or uid in _SERVICES:
        yield fine("DOC106", f"{user} is a system user, so systemd does not remove its objects")
    elif (root / "var/lib/systemd/linger" / user).exists():
        yield fine("DOC106", f"lingering is enabled for {user}, so systemd does not remove its objects")
    else:
        seen = f"RemoveIPC=yes ({where}), and {user} is an ordinary user"
        remedy = "Run the bridge as a system user (`rosplc service install`), or enable lingering."
        yield found("DOC106", seen, remedy, f"sudo loginctl enable-linger {user}")


def _remove_ipc(root: Path) -> tuple[bool, str]:
    """Return logind's RemoveIPC and the file that sets it; the last file wins."""
    files: dict[str, Path] = {}
    for folder in ("usr/lib", "run", "etc"):
        files |= {path.name: path for path in (root / folder / "systemd/logind.conf.d").glob("*.conf")}
    mains = [root / base / "systemd/logind.conf" for base in ("etc", "run", "usr/lib")]
    result, where = True, "systemd's default"
    for path in [path for path in mains if path.is_file()][:1] + [files[name] for name in sorted(files)]:
        parser = configparser.ConfigParser(strict=False, interpolation=None, allow_no_value=True)
        try:
            parser.read_string(path.read_text(encoding="utf-8", errors="replace"))
            value = parser.get("Login", "RemoveIPC", fallback=None)
        except configparser.Error:
            continue
        if value:
            result = value.strip().lower() not in ("no", "false", "0", "off", "n", "f")
            where = f"/{path.relative_to(root)}"
    return result, where


def mounted(directory: Path, mount: Mount | None) -> Iterator[Finding]:
    """Judge what is mounted at /dev/shm (None: nothing), and whether it contains the objects."""
    if not directory.is_dir():
        yield found("DOC201", f"{directory} is not a folder", command=f"mkdir -p {directory}")
    elif directory != Path("/dev/shm"):
        seen = f"shm.directory is {directory}, but PLCs use /dev/shm"
        yield found("DOC201", seen, "Remove shm.directory, unless this is a test.", level=Level.WARNING)
    elif mount is None or mount.point != "/dev/shm" or mount.kind not in ("tmpfs", "ramfs"):
        what = f"it is {mount.kind}" if mount and mount.point == "/dev/shm" else "nothing is mounted there"
        mend = "sudo mount -t tmpfs -o mode=1777 tmpfs /dev/shm"
        yield found("DOC201", f"/dev/shm is not a memory file system: {what}", command=mend)
    else:
        seen = "/dev/shm is mounted read-only" if mount.read_only else ""
        mend = "sudo mount -o remount,rw /dev/shm"
        yield judged("DOC201", seen, "/dev/shm is a memory file system", command=mend)


def mode(directory: Path, *, writable: bool) -> Iterator[Finding]:
    """Judge the directory's mode; ``writable``: this user may create files in it."""
    bits = stat.S_IMODE(directory.stat().st_mode)
    seen = f"{directory} has mode {bits:04o}"
    what = seen if writable else f"{seen}, and this user may not create files there"
    level = Level.WARNING if writable else Level.ERROR
    command = f"sudo chmod 1777 {directory}"
    yield judged("DOC202", "" if bits == 0o1777 else what, seen, command=command, level=level)


def room(directory: Path, space: os.statvfs_result, needed: int, present: int) -> Iterator[Finding]:
    """Judge the space for objects.

    ``needed`` is the size of all objects of the configuration in bytes (0 without a configuration),
    ``present`` the allocated size of those that exist already.
    """
    size, free = space.f_blocks * space.f_frsize, space.f_bavail * space.f_frsize
    seen = f"{directory} has {_mib(free)} of {_mib(size)} free"
    missing = max(0, needed - present)
    if missing > free:
        # A bridge makes a new object beside the old one, so twice the need is required.
        mib = -(-(size + 2 * missing) // _MIB)
        remedy = f"Enlarge {directory} (containers: --shm-size), or lower the limits or depth of topics."
        command = f"sudo mount -o remount,size={mib}m {directory}"
        what = f"{seen}; the configuration's objects need another {_mib(missing)}"
        yield found("DOC203", what, remedy, command)
    elif size and free < size / 10:
        yield found("DOC204", seen, command=f"ls -lS {directory}")
    else:
        more = f"; the configuration's objects need {_mib(needed)}" if needed else ""
        yield fine("DOC203", seen + more)


def _mib(count: int) -> str:
    return f"{count / _MIB:.0f} MiB" if count >= 10 * _MIB else f"{count / _MIB:.1f} MiB"


_OPTIONAL = ("cyclonedds", "eclipse-zenoh")
_DDS_MACHINES = ("x86_64",)
_ZENOH_MACHINES = ("x86_64", "i686", "aarch64", "armv7l", "armv6l")


def needed() -> list[str]:
    """Return the names of the packages that rosplc requires, from its own metadata."""
    try:
        lines = requires("rosplc") or []
    except PackageNotFoundError:
        return []
    return [name[0] for line in lines if ";" not in line and (name := re.match(r"[\w.-]+", line.strip()))]


def packages(
    names: list[str], python: str, release: str, *, version_of: Callable[[str], str] = version
) -> Iterator[Finding]:
    """Report the versions of installed packages, and which of the required ``names`` are missing.

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
        yield found("DOC110", f"required packages are not installed: {', '.join(missing)}", command=command)
    yield fine("DOC110", f"rosplc {release}, Python {python}, {', '.join(present) or 'no other packages'}")


def wheels(machine: str, python: tuple[int, int]) -> Iterator[Finding]:
    """Report which backends have no wheel on PyPI for this machine (``uname -m``) and Python version."""
    missing = []
    if machine not in _DDS_MACHINES:
        missing.append(f"cyclonedds for {machine}")
    elif python >= (3, 14):
        missing.append(f"cyclonedds for Python {python[0]}.{python[1]}")
    if machine not in _ZENOH_MACHINES:
        missing.append(f"eclipse-zenoh for {machine}")
    remedy = "Use a ROS 2 installation (backend rclpy) or Zenoh, or build the package from source."
    well = "PyPI has wheels of cyclonedds and eclipse-zenoh for this machine"
    yield judged("DOC111", f"PyPI has no wheel of {', '.join(missing)}" if missing else "", well, remedy)


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

    ``wanted`` is ``ros.backend``; without a configuration, an unusable choice is only a warning; ``missing``
    returns why a backend cannot be imported, or an empty text if it can.
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
    ways = ", ".join(name for name in BACKENDS if name != "memory" and not missing(name))
    yield fine("DOC112", f"backend auto selects {choice.name}, because {choice.why}; usable backends: {ways}")


def pip_here(text: str) -> str:
    """Return a text whose ``pip install`` and ``'rosplc[EXTRA]'`` fit the way in which rosplc is installed.

    A virtual environment has its own pip, and one created by pipx uses ``pipx inject``. A new virtual
    environment is needed if the system manages Python (PEP 668) or the environment has no pip, as that of the
    Debian package. An editable installation is specified by the path of its checkout.
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
