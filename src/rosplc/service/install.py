"""Installing and removing a bridge's service: first a list of steps, then their execution.

The list is what ``--dry-run`` shows. Nothing is done that is not in it.
"""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from rosplc.errors import SetupError
from rosplc.service.unit import MARK, Plan, drop_in, sysusers, template

__all__ = [
    "Remove",
    "Run",
    "Step",
    "Write",
    "execute",
    "install_steps",
    "instances",
    "service_states",
    "uninstall_steps",
]

_TEMPLATE = Path("/etc/systemd/system/rosplc@.service")
_DROP_IN = "10-rosplc.conf"
_TIMEOUT_S = 60
_PROPERTIES = ("ActiveState", "SubState", "UnitFileState", "NRestarts", "StatusText")


@dataclass(frozen=True)
class Write:
    """Write a file, unless it stands there just so."""

    path: Path
    text: str


@dataclass(frozen=True)
class Remove:
    """Remove a file, and its folder if nothing else is in it."""

    path: Path


@dataclass(frozen=True)
class Run:
    """Run a command."""

    argv: tuple[str, ...]


Step = Write | Remove | Run


def install_steps(plan: Plan, root: Path) -> list[Step]:
    """Return what is to be done for a bridge to run as a service.

    Args:
        plan: The bridge.
        root: Where ``/etc`` lies; ``/`` for this machine.

    Raises:
        SetupError: SYS011 if a file of somebody else stands at one of the names.
    """
    steps: list[Step] = [
        Write(_at(root, _sysusers_file(plan.name)), sysusers(plan)),
        Write(_at(root, _TEMPLATE), template(plan)),
        Write(_at(root, _drop_in_file(plan.name)), drop_in(plan)),
        Run(("systemd-sysusers", *_root_option(root), _sysusers_file(plan.name).name)),
    ]
    for step in steps:
        if isinstance(step, Write):
            _refuse_foreign(step.path)
    if root == Path("/"):
        steps.append(Run(("systemctl", "daemon-reload")))
    steps.append(Run(("systemctl", *_root_option(root), "enable", plan.unit)))
    return steps


def uninstall_steps(name: str, root: Path) -> list[Step]:
    """Return what is to be done to take a bridge's service away again.

    User and group stay, as files may be theirs; so do configuration and objects.

    Raises:
        SetupError: SYS011 if there is no such service, or a file of it is somebody else's.
    """
    others = [each for each in _installed(root, name) if each != name]
    unit = f"rosplc@{name}.service"
    now = ("--now",) if root == Path("/") else ()
    steps: list[Step] = [Run(("systemctl", *_root_option(root), "disable", *now, unit))]
    files = [_at(root, _drop_in_file(name)), _at(root, _sysusers_file(name))]
    for path in files if others else [*files, _at(root, _TEMPLATE)]:
        _refuse_foreign(path)
        steps.append(Remove(path))
    if root == Path("/"):
        steps.append(Run(("systemctl", "daemon-reload")))
    return steps


def instances(root: Path) -> list[str]:
    """Return the names of the bridges that are installed as services, sorted."""
    found = _at(root, _TEMPLATE.parent).glob(f"rosplc@*.service.d/{_DROP_IN}")
    return sorted(path.parent.name.removeprefix("rosplc@").removesuffix(".service.d") for path in found)


def _installed(root: Path, name: str | None) -> list[str]:
    """Return the names of the installed bridges; SYS011 if this one is not among them."""
    names = instances(root)
    if name is not None and name not in names:
        there = f"; there are: {', '.join(names)}" if names else ""
        raise SetupError(
            "SYS011",
            f"no service rosplc@{name} is installed{there}",
            where=str(_at(root, _drop_in_file(name))),
            remedy="`rosplc service status` lists what is installed, `rosplc service install` installs one.",
        )
    return names


def execute(steps: list[Step], tell: Callable[[str], None]) -> None:
    """Do the steps, in order.

    Args:
        steps: What to do.
        tell: Gets a line for each step.

    Raises:
        SetupError: SYS011 if a file cannot be written or a command fails; the steps before stay done,
            and the next attempt goes on from there.
    """
    for step in steps:
        tell(in_words(step))
        try:
            if isinstance(step, Write):
                _write(step)
            elif isinstance(step, Remove):
                step.path.unlink(missing_ok=True)
                with suppress(OSError):
                    if step.path.parent.name.endswith(".service.d"):
                        step.path.parent.rmdir()
            else:
                _run(step.argv)
        except OSError as error:
            remedy = "Run it as root (sudo)." if isinstance(error, PermissionError) else ""
            what = f"cannot {in_words(step)}: {error.strerror}"
            raise SetupError("SYS011", what, remedy=remedy) from error


def in_words(step: Step) -> str:
    """Return a step as a line."""
    if isinstance(step, Write):
        same = step.path.exists() and _read(step.path) == step.text
        return f"{'keep' if same else 'write'} {step.path}"
    if isinstance(step, Remove):
        return f"remove {step.path}"
    return f"run {' '.join(step.argv)}"


def _write(step: Write) -> None:
    if _read(step.path) == step.text:
        return
    step.path.parent.mkdir(mode=0o755, parents=True, exist_ok=True)
    # A name of its own and a rename: a machine that loses power in between has the old file or the new.
    temporary = step.path.with_name(f".{step.path.name}.new")
    temporary.unlink(missing_ok=True)
    fd = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o644)
    with os.fdopen(fd, "w", encoding="utf-8") as file:
        os.fchmod(fd, 0o644)
        file.write(step.text)
        file.flush()
        os.fsync(fd)
    temporary.replace(step.path)


def _run(argv: tuple[str, ...]) -> None:
    if shutil.which(argv[0]) is None:
        raise SetupError(
            "SYS011",
            f"there is no {argv[0]} on this machine",
            remedy="Install the Debian package systemd, or run the bridge under another service manager.",
        )
    try:
        done = subprocess.run(argv, capture_output=True, text=True, timeout=_TIMEOUT_S, check=False)
    except subprocess.TimeoutExpired:
        what = f"{' '.join(argv)} did not end within {_TIMEOUT_S} s"
        raise SetupError("SYS011", what, remedy="See `systemctl list-jobs` for what it waits for.") from None
    if done.returncode:
        said = " ".join((done.stderr or done.stdout).split()) or f"exit status {done.returncode}"
        raise SetupError("SYS011", f"{' '.join(argv)} failed: {said}")


def _refuse_foreign(path: Path) -> None:
    text = _read(path)
    if text is not None and not text.startswith(MARK):
        raise SetupError(
            "SYS011",
            "this file was not written by rosplc service install, or its first line was removed",
            where=str(path),
            remedy="Move it away; changes of your own belong into `systemctl edit`'s files.",
        )


def _read(path: Path) -> str | None:
    try:
        return path.read_text(encoding="utf-8", errors="replace")
    except OSError:
        return None


def _at(root: Path, path: Path) -> Path:
    return root / path.relative_to("/")


def _root_option(root: Path) -> tuple[str, ...]:
    return () if root == Path("/") else (f"--root={root}",)


def _sysusers_file(name: str) -> Path:
    return Path(f"/etc/sysusers.d/rosplc-{name}.conf")


def _drop_in_file(name: str) -> Path:
    return _TEMPLATE.parent / f"rosplc@{name}.service.d" / _DROP_IN


def service_states(root: Path, name: str | None = None) -> list[dict[str, object]]:
    """Return a dictionary for each installed bridge: name, unit, enabled, active, restarts, status.

    Args:
        root: Where ``/etc`` lies.
        name: Only this one.

    Raises:
        SetupError: SYS011 if that one is not installed.
    """
    return [_state(each, root) for each in _installed(root, name) if name in (None, each)]


def _state(name: str, root: Path) -> dict[str, object]:
    unit = f"rosplc@{name}.service"
    enabled = root / f"etc/systemd/system/multi-user.target.wants/{unit}"
    found = _ask(unit) if root == Path("/") else {}
    active = "/".join(found[key] for key in ("ActiveState", "SubState") if found.get(key))
    return {
        "name": name,
        "unit": unit,
        "enabled": found.get("UnitFileState") or ("enabled" if enabled.is_symlink() else "disabled"),
        "active": active or "unknown: systemd does not run here",
        "restarts": int(found["NRestarts"]) if found.get("NRestarts", "").isdigit() else 0,
        "status": found.get("StatusText", ""),
    }


def _ask(unit: str) -> dict[str, str]:
    if shutil.which("systemctl") is None or not Path("/run/systemd/system").is_dir():
        return {}
    command = ["systemctl", "show", f"--property={','.join(_PROPERTIES)}", unit]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=10, check=False)
    except (OSError, subprocess.TimeoutExpired):
        return {}
    return dict(line.partition("=")[::2] for line in done.stdout.splitlines())
