"""Installation and removal of a systemd service: the unit's files, the steps and their execution.

One hardened template, ``rosplc@.service``, serves all bridges. The settings that differ between bridges
(configuration, user and group, real-time limits) are in a drop-in of the instance. Nothing is done that is
not in the steps.
"""

from __future__ import annotations

import grp
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from rosplc.bridge.realtime import contention
from rosplc.config.file import Config, read_config
from rosplc.config.resolve import open_doors
from rosplc.errors import SetupError

MARK = "# Written by rosplc service install; `systemctl edit` puts changes beside it."
"""The first line of every file that rosplc may replace and remove."""

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,31}")
_USER = re.compile(r"[a-z_][a-z0-9_-]{0,30}")
_PATH = re.compile(r"/[A-Za-z0-9_./+@:,-]*")
_BACKOFF = 254  # systemd's version that knows RestartSteps=


@dataclass(frozen=True)
class Plan:
    """One bridge as a service, ``rosplc@NAME.service``; SYS011 if a name or path is not valid in a unit."""

    name: str
    user: str
    config: Path  # absolute
    program: Path  # the rosplc command, absolute
    group: str = ""  # of the objects; empty for the user's own
    directory: str = "/dev/shm"  # of the objects
    priority: int = 0  # of SCHED_FIFO; 0 for none
    lock_memory: bool = False
    affinity: bool = False  # whether threads are to be kept on processors
    systemd: int = 0  # the version that will read the files; 0 if unknown

    def __post_init__(self) -> None:
        _valid("name", self.name, _NAME)
        _valid("user", self.user, _USER)
        if self.group:
            _valid("group", self.group, _USER)
        for what, path in (("config", self.config), ("program", self.program), ("directory", self.directory)):
            _valid(what, str(path), _PATH)

    @property
    def unit(self) -> str:
        """The instance's full name."""
        return f"rosplc@{self.name}.service"

    @property
    def realtime(self) -> bool:
        """Whether the service needs permissions that an ordinary process lacks."""
        return bool(self.priority or self.lock_memory or self.affinity)


def _valid(what: str, value: str, pattern: re.Pattern[str]) -> None:
    if not pattern.fullmatch(value):
        remedy = "Use only letters, digits, _ and -; paths may also contain / . + @ : and commas."
        raise SetupError("SYS011", f"{what} {value!r} cannot be used in a systemd unit", remedy=remedy)


def sysusers(plan: Plan) -> str:
    """Return the lines with which systemd-sysusers creates the user and group."""
    lines = [MARK, f'u {plan.user} - "rosplc bridge"']
    if plan.group and plan.group != plan.user:
        lines += [f"g {plan.group} -", f"m {plan.user} {plan.group}"]
    return "\n".join(lines) + "\n"


def template(plan: Plan) -> str:
    """Return the text of ``rosplc@.service``."""
    backoff = "RestartSteps=5\nRestartMaxDelaySec=30\n" if plan.systemd >= _BACKOFF else ""
    return _TEMPLATE.format(mark=MARK, program=plan.program, backoff=backoff)


def drop_in(plan: Plan) -> str:
    """Return the text of the instance's drop-in."""
    lines = [MARK, "[Service]", f"User={plan.user}"]
    lines += ["ExecStart=", f"ExecStart={plan.program} run --status 0 {plan.config}"]
    if plan.group and plan.group != plan.user:
        lines += ["# shm.group, which the PLC runtime shares.", f"SupplementaryGroups={plan.group}"]
    if plan.directory != "/dev/shm":
        lines += ["# shm.directory.", f"ReadWritePaths={plan.directory}"]
    if plan.realtime:
        lines += ["# realtime: these limits permit less than capabilities would."]
        lines += ["SystemCallFilter=@resources @memlock"]
    if plan.priority:
        lines += ["RestrictRealtime=no", f"LimitRTPRIO={plan.priority}"]
    if plan.lock_memory:
        lines += ["LimitMEMLOCK=infinity"]
    return "\n".join(lines) + "\n"


_TEMPLATE = """\
{mark}
[Unit]
Description=rosplc bridge %i between ROS and the PLC
# DDS selects its network interface once, at the start. There is no ordering with the PLC's runtime: either
# side may start first, and a PLC should not wait for a network.
Wants=network-online.target
After=network-online.target
# Never stop trying: a bridge that gives up leaves the machine without a bridge.
StartLimitIntervalSec=0

[Service]
Type=notify
NotifyAccess=main
User=rosplc
ExecStart={program} run --status 0 /etc/rosplc/%i.yaml
# Reloads the configuration; a rejected configuration changes nothing.
ExecReload=/bin/kill -HUP $MAINPID
EnvironmentFile=-/etc/rosplc/%i.env
StateDirectory=rosplc
Environment=HOME=%S/rosplc ROS_HOME=%S/rosplc PYTHONFAULTHANDLER=1 PYTHONDONTWRITEBYTECODE=1

Restart=on-failure
RestartSec=2
{backoff}# Exit status 2: the configuration is invalid, so a restart would not help. If a disk or group is
# missing, the exit status is 1, and the service is restarted because the resource may appear later.
RestartPreventExitStatus=2
# The bridge resets the watchdog while its threads for messages and heartbeats are running.
WatchdogSec=30
TimeoutStartSec=90
TimeoutStopSec=20

# The objects remain when the bridge stops: the PLC keeps its last values, and the next start reuses the
# objects. DynamicUser= would remove them.
RemoveIPC=no
ReadWritePaths=/dev/shm
PrivateIPC=yes
UMask=0077

NoNewPrivileges=yes
CapabilityBoundingSet=
AmbientCapabilities=
ProtectSystem=strict
ProtectHome=yes
PrivateTmp=yes
# This setting does not hide /dev/shm.
PrivateDevices=yes
DevicePolicy=closed
ProtectProc=invisible
ProtectClock=yes
ProtectControlGroups=yes
ProtectHostname=yes
ProtectKernelLogs=yes
ProtectKernelModules=yes
ProtectKernelTunables=yes
RestrictAddressFamilies=AF_UNIX AF_INET AF_INET6 AF_NETLINK
RestrictNamespaces=yes
RestrictRealtime=yes
RestrictSUIDSGID=yes
KeyringMode=private
LockPersonality=yes
MemoryDenyWriteExecute=yes
SystemCallArchitectures=native
SystemCallFilter=@system-service
SystemCallFilter=~@privileged @resources
# fchown sets the objects' group.
SystemCallFilter=@chown
# A system call that is not allowed fails with EPERM and does not kill the bridge.
SystemCallErrorNumber=EPERM
LimitNOFILE=65536

[Install]
WantedBy=multi-user.target
"""


_UNIT = Path("/etc/systemd/system/rosplc@.service")
_DROP_IN = "10-rosplc.conf"
_TIMEOUT_S = 60
_HIDDEN = ("/home", "/root", "/run/user", "/tmp", "/var/tmp")
"""Folders that ProtectHome= and PrivateTmp= hide from the service."""
_PROPERTIES = ("ActiveState", "SubState", "UnitFileState", "NRestarts", "StatusText")


@dataclass(frozen=True)
class Write:
    """Write a file, unless it has this content already."""

    path: Path
    text: str


@dataclass(frozen=True)
class Remove:
    """Remove a file, and its folder if that is then empty."""

    path: Path


@dataclass(frozen=True)
class Run:
    """Run a command."""

    argv: tuple[str, ...]


Step = Write | Remove | Run


def install_steps(plan: Plan, root: Path) -> list[Step]:
    """Return the installation's steps; ``root`` contains ``etc``. SYS011 if a file there is not rosplc's."""
    steps: list[Step] = [
        Write(_at(root, _sysusers_file(plan.name)), sysusers(plan)),
        Write(_at(root, _UNIT), template(plan)),
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
    """Return the steps that remove a bridge's service.

    User and group remain, since they may own files; so do configuration and objects. Raises SetupError SYS011
    if there is no such service, or if one of its files is not from rosplc.
    """
    others = [each for each in _installed(root, name) if each != name]
    unit = f"rosplc@{name}.service"
    now = ("--now",) if root == Path("/") else ()
    steps: list[Step] = [Run(("systemctl", *_root_option(root), "disable", *now, unit))]
    files = [_at(root, _drop_in_file(name)), _at(root, _sysusers_file(name))]
    for path in files if others else [*files, _at(root, _UNIT)]:
        _refuse_foreign(path)
        steps.append(Remove(path))
    if root == Path("/"):
        steps.append(Run(("systemctl", "daemon-reload")))
    return steps


def _installed(root: Path, name: str | None) -> list[str]:
    """Return the names of the installed bridges, sorted; SYS011 if ``name`` is not one of them."""
    found = _at(root, _UNIT.parent).glob(f"rosplc@*.service.d/{_DROP_IN}")
    names = sorted(path.parent.name.removeprefix("rosplc@").removesuffix(".service.d") for path in found)
    if name is not None and name not in names:
        there = f"; installed: {', '.join(names)}" if names else ""
        what, where = f"service rosplc@{name} is not installed{there}", str(_at(root, _drop_in_file(name)))
        remedy = "`rosplc service status` lists installed services; `rosplc service install` adds one."
        raise SetupError("SYS011", what, where=where, remedy=remedy)
    return names


def execute(steps: list[Step], tell: Callable[[str], None]) -> None:
    """Execute the steps in order; ``tell`` is called with one line for each.

    Raises SetupError SYS011 if a file cannot be written or a command fails; the previous steps are not
    undone, and the next attempt continues after them.
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
            remedy = "Run the command as root (sudo)." if isinstance(error, PermissionError) else ""
            what = f"cannot {in_words(step)}: {error.strerror}"
            raise SetupError("SYS011", what, remedy=remedy) from error


def in_words(step: Step) -> str:
    """Return a step as one line of text."""
    if isinstance(step, Write):
        same = step.path.exists() and _read(step.path) == step.text
        return f"{'keep' if same else 'write'} {step.path}"
    return f"remove {step.path}" if isinstance(step, Remove) else f"run {' '.join(step.argv)}"


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
        remedy = "Install the Debian package systemd, or run the bridge under another service manager."
        raise SetupError("SYS011", f"{argv[0]} is not installed on this machine", remedy=remedy)
    try:
        done = subprocess.run(argv, capture_output=True, text=True, timeout=_TIMEOUT_S, check=False)
    except subprocess.TimeoutExpired:
        what = f"{' '.join(argv)} did not end within {_TIMEOUT_S} s"
        raise SetupError("SYS011", what, remedy="See `systemctl list-jobs` for pending jobs.") from None
    if done.returncode:
        said = " ".join((done.stderr or done.stdout).split()) or f"exit status {done.returncode}"
        raise SetupError("SYS011", f"{' '.join(argv)} failed: {said}")


def _refuse_foreign(path: Path) -> None:
    text = _read(path)
    if text is not None and not text.startswith(MARK):
        what = "this file was not written by rosplc service install, or its first line was removed"
        remedy = "Move the file away, and make your own changes with `systemctl edit`."
        raise SetupError("SYS011", what, where=str(path), remedy=remedy)


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
    return _UNIT.parent / f"rosplc@{name}.service.d" / _DROP_IN


def service_states(root: Path, name: str | None = None) -> list[dict[str, object]]:
    """Return the state of each installed service, or of one; SYS011 if ``name`` is not installed."""
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
        "active": active or "unknown: systemd is not running",
        "restarts": int(found["NRestarts"]) if found.get("NRestarts", "").isdigit() else 0,
        "status": found.get("StatusText", ""),
    }


def _ask(unit: str) -> dict[str, str]:
    if not Path("/run/systemd/system").is_dir():
        return {}
    lines = _systemctl("show", f"--property={','.join(_PROPERTIES)}", unit).splitlines()
    return dict(line.partition("=")[::2] for line in lines)


def _systemctl(*arguments: str) -> str:
    """Return the output of systemctl; empty if it is not installed or does not answer."""
    command = ["systemctl", *arguments]
    try:
        return subprocess.run(command, capture_output=True, text=True, timeout=10, check=False).stdout
    except (OSError, subprocess.TimeoutExpired):
        return ""


def plan_service(
    name: str | None, config: Path | None, user: str, root: Path, program: Path
) -> tuple[Plan, tuple[str, ...]]:
    """Return the service of a configuration, and notes for the user.

    If ``name`` is None, the file's name is used; if ``config`` is None, ``/etc/rosplc/NAME.yaml``, also below
    ``root``. Raises SetupError SYS011 if neither was given, or a name or path is not usable; ConfigErrors.
    """
    if config is None:
        if name is None:
            remedy = "Specify --config FILE, or the NAME of /etc/rosplc/NAME.yaml."
            raise SetupError("SYS011", "no bridge was specified", remedy=remedy)
        config = Path(f"/etc/rosplc/{name}.yaml")
    config = Path(config if config.is_absolute() else config.absolute())
    found = root / config.relative_to("/")
    settings = read_config(found if found.exists() else config)
    realtime, shm = settings.settings.realtime, settings.settings.shm
    version = re.match(r"systemd (\d+)", _systemctl("--version"))
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
        systemd=int(version[1]) if version else 0,
    )
    return plan, tuple(_notes(plan, settings))


def require_systemd() -> None:
    """Raise SYS011 unless systemd is running on this machine."""
    if not Path("/run/systemd/system").is_dir():
        remedy = "In a container, run `rosplc run FILE` instead. To prepare an image, use --root DIR."
        raise SetupError("SYS011", "systemd is not running on this machine", remedy=remedy)


def _absolute(program: Path) -> Path:
    if program.name == "rosplc":
        return Path(shutil.which(str(program)) or program).absolute()
    beside = Path(sys.executable).with_name("rosplc")  # python -m rosplc
    found = str(beside) if beside.exists() else shutil.which("rosplc")
    if found is None:
        raise SetupError("SYS011", "the rosplc command is not on the PATH", remedy="Use its full path.")
    return Path(found).absolute()


def _group_name(group: str | int | None) -> str:
    if not isinstance(group, int):
        return group or ""
    try:
        return grp.getgrgid(group).gr_name
    except KeyError:
        what = f"this machine has no group with the ID {group} (shm.group)"
        raise SetupError("SYS011", what, remedy="Set shm.group to a name; the group is created.") from None


def _notes(plan: Plan, config: Config) -> list[str]:
    notes = [*open_doors(config), *contention(config)]
    for what, path in (("the rosplc command", plan.program), ("the configuration", plan.config)):
        if any(path.is_relative_to(hidden) for hidden in _HIDDEN):
            notes.append(f"the service cannot access {what} {path}; move it to /opt, /usr or /etc")
    owner = config.settings.shm.owner
    if owner not in (None, plan.user):
        notes.append(
            f"shm.owner is {owner}, but only root can change owners, and the service runs as {plan.user}"
        )
    if not plan.group:
        notes.append(
            f"shm.group is not set: only {plan.user} and root can use the objects; a PLC runtime that runs "
            "as another user needs to share a group with the bridge"
        )
    return notes
