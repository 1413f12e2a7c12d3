"""The unit of systemd that runs a bridge, and the files beside it.

One template, ``rosplc@.service``, is hardened for every bridge alike. What differs between bridges (their
configuration, user and group, real-time limits) is in a drop-in of the instance.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from rosplc.errors import SetupError

MARK = "# Written by rosplc service install; `systemctl edit` puts changes beside it."
"""The first line of every file that is ours to replace and remove."""

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,31}")
_USER = re.compile(r"[a-z_][a-z0-9_-]{0,30}")
_PATH = re.compile(r"/[A-Za-z0-9_./+@:,-]*")
_BACKOFF = 254  # systemd's version that knows RestartSteps=


@dataclass(frozen=True)
class Plan:
    """One bridge as a service, ``rosplc@NAME.service``; SYS011 if a name or path cannot be in a unit."""

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
        """Whether it needs more than an ordinary process may."""
        return bool(self.priority or self.lock_memory or self.affinity)


def _valid(what: str, value: str, pattern: re.Pattern[str]) -> None:
    if not pattern.fullmatch(value):
        remedy = "Use letters, digits, _ and -, in paths also / . + @ : and comma."
        raise SetupError("SYS011", f"{what} {value!r} cannot stand in a unit of systemd", remedy=remedy)


def sysusers(plan: Plan) -> str:
    """Return the lines that make systemd-sysusers create user and group."""
    lines = [MARK, f'u {plan.user} - "rosplc bridge"']
    if plan.group and plan.group != plan.user:
        lines += [f"g {plan.group} -", f"m {plan.user} {plan.group}"]
    return "\n".join(lines) + "\n"


def template(plan: Plan) -> str:
    """Return ``rosplc@.service``."""
    backoff = "RestartSteps=5\nRestartMaxDelaySec=30\n" if plan.systemd >= _BACKOFF else ""
    return _TEMPLATE.format(mark=MARK, program=plan.program, backoff=backoff)


def drop_in(plan: Plan) -> str:
    """Return what the instance has beside the template."""
    lines = [MARK, "[Service]", f"User={plan.user}"]
    lines += ["ExecStart=", f"ExecStart={plan.program} run --status 0 {plan.config}"]
    if plan.group and plan.group != plan.user:
        lines += ["# shm.group: shared with the PLC's runtime.", f"SupplementaryGroups={plan.group}"]
    if plan.directory != "/dev/shm":
        lines += ["# shm.directory.", f"ReadWritePaths={plan.directory}"]
    if plan.realtime:
        lines += [
            "# realtime: limits instead of capabilities; they give the right to these two things alone."
        ]
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
# DDS takes its network interface once, at the start. The PLC's runtime is not ordered: either side may
# start first, and a PLC should not wait for a network.
Wants=network-online.target
After=network-online.target
# Every attempt counts: a bridge that gives up leaves a machine without one.
StartLimitIntervalSec=0

[Service]
Type=notify
NotifyAccess=main
User=rosplc
ExecStart={program} run --status 0 /etc/rosplc/%i.yaml
# Another configuration while it runs; one that is refused changes nothing.
ExecReload=/bin/kill -HUP $MAINPID
EnvironmentFile=-/etc/rosplc/%i.env
StateDirectory=rosplc
Environment=HOME=%S/rosplc ROS_HOME=%S/rosplc PYTHONFAULTHANDLER=1 PYTHONDONTWRITEBYTECODE=1

Restart=on-failure
RestartSec=2
{backoff}# 2: the configuration is wrong, and another attempt would not help. What may come by
# itself, such as a disk or a group, ends with 1.
RestartPreventExitStatus=2
# Fed while the threads that carry and beat go round.
WatchdogSec=30
TimeoutStartSec=90
TimeoutStopSec=20

# The objects stay when the bridge stops: the PLC keeps its last values, and the next start goes on with them.
# So no DynamicUser=, which would remove them.
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
# Keeps /dev/shm.
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
# fchown: the objects' group.
SystemCallFilter=@chown
# A call that is not allowed fails as one without the right to it, and does not kill the bridge.
SystemCallErrorNumber=EPERM
LimitNOFILE=65536

[Install]
WantedBy=multi-user.target
"""
