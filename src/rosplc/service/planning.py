"""What a service needs, from its configuration and this machine."""

from __future__ import annotations

import grp
import shutil
import subprocess
import sys
from pathlib import Path

from rosplc.bridge.realtime import contention
from rosplc.config.file import Config, read_config
from rosplc.config.resolve import open_doors
from rosplc.errors import SetupError
from rosplc.service.unit import Plan

__all__ = ["plan_service", "require_systemd", "systemd_version"]

_HIDDEN = ("/home", "/root", "/run/user", "/tmp", "/var/tmp")
"""What ProtectHome= and PrivateTmp= keep from the service."""


def plan_service(
    name: str | None, config: Path | None, user: str, root: Path, program: Path
) -> tuple[Plan, tuple[str, ...]]:
    """Return the service of a configuration, and what a person should know about it.

    Args:
        name: The instance's name; None takes the file's.
        config: The configuration; None for ``/etc/rosplc/NAME.yaml``.
        user: Who runs it.
        root: Where ``/etc`` lies; the configuration is looked for there too.
        program: The rosplc command, as it was called.

    Raises:
        SetupError: SYS011 if the name or a path is not usable, or neither name nor file was given.
        ConfigErrors: The configuration is wrong.
    """
    if config is None:
        if name is None:
            raise SetupError(
                "SYS011",
                "it is not said which bridge",
                remedy="Give --config FILE, or a name for /etc/rosplc/NAME.yaml.",
            )
        config = Path(f"/etc/rosplc/{name}.yaml")
    config = Path(config if config.is_absolute() else config.absolute())
    found = root / config.relative_to("/")
    settings = read_config(found if found.exists() else config)
    realtime, shm = settings.settings.realtime, settings.settings.shm
    plan = Plan(
        name=config.stem if name is None else name,
        user=user,
        config=config,
        program=_absolute(program),
        group=_group_name(shm.group),
        directory=shm.directory,
        priority=realtime.priority if realtime.policy else 0,
        lock_memory=realtime.lock_memory,
        affinity=bool(realtime.affinity),
        systemd=systemd_version(),
    )
    return plan, tuple(_notes(plan, settings))


def systemd_version() -> int:
    """Return the version of this machine's systemd; 0 if there is none."""
    if shutil.which("systemctl") is None:
        return 0
    try:
        command = ["systemctl", "--version"]
        done = subprocess.run(command, capture_output=True, text=True, timeout=10, check=False)
        return int(done.stdout.split()[1])
    except (OSError, subprocess.TimeoutExpired, ValueError, IndexError):
        return 0


def require_systemd() -> None:
    """Raise SYS011 unless systemd runs this machine."""
    if not Path("/run/systemd/system").is_dir():
        raise SetupError(
            "SYS011",
            "systemd does not run this machine",
            remedy="In a container let its manager run `rosplc run FILE`; --root DIR prepares an image.",
        )


def _absolute(program: Path) -> Path:
    if program.name == "rosplc":
        return Path(shutil.which(str(program)) or program).absolute()
    beside = Path(sys.executable).with_name("rosplc")  # python -m rosplc
    found = str(beside) if beside.exists() else shutil.which("rosplc")
    if found is None:
        raise SetupError("SYS011", "the rosplc command is not on the PATH", remedy="Call it by its path.")
    return Path(found).absolute()


def _group_name(group: str | int | None) -> str:
    if not isinstance(group, int):
        return group or ""
    try:
        return grp.getgrgid(group).gr_name
    except KeyError:
        what = f"shm.group {group} has no name on this machine"
        raise SetupError("SYS011", what, remedy="Name the group; it is created.") from None


def _notes(plan: Plan, config: Config) -> list[str]:
    notes = [*open_doors(config), *contention(config)]
    for what, path in (("the rosplc command", plan.program), ("the configuration", plan.config)):
        if any(path.is_relative_to(hidden) for hidden in _HIDDEN):
            notes.append(f"{what} is {path}, which the service cannot see; install into /opt, /usr or /etc")
    owner = config.settings.shm.owner
    if owner not in (None, plan.user):
        notes.append(
            f"shm.owner is {owner}: only root can give objects away, and the service runs as {plan.user}"
        )
    if not plan.group:
        notes.append(
            f"shm.group is not set: only {plan.user} and root can use the objects; a PLC runtime of another "
            "user needs a common group"
        )
    return notes
