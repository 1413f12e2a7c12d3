"""``rosplc reload``: tell a running bridge to read its configuration again.

rosplc reload  —  reload the bridge of ./rosplc.yaml

rosplc reload cell1.yaml  —  check this file, then tell its bridge to read it again

rosplc reload --prefix line3  —  reload the bridge with this `prefix:`

A file with an error is not applied. The bridge logs the result. For a service, use `systemctl reload`.
"""

from __future__ import annotations

import os
import signal
from pathlib import Path

from rosplc.cli.options import ConfigFile, Directory, config_file, default_config
from rosplc.cli.text import say
from rosplc.cli.verb import verb
from rosplc.config.resolve import load_project
from rosplc.doctor.objects import lock_holders
from rosplc.errors import ChannelError, SetupError
from rosplc.proc import held_files, status_mask


@verb
def command(
    config: ConfigFile = None, *, prefix: str | None = None, directory: Directory = "/dev/shm"
) -> None:
    """Apply a changed configuration to a running bridge, without stopping it.

    Options:
        prefix NAME: The bridge's `prefix:`, instead of a configuration.
    """
    if prefix is None:
        settings = load_project(config_file(config or default_config())).config.settings
        prefix, directory = settings.prefix, settings.shm.directory
    held = held_files() or {}
    pids = [pid for pid in lock_holders(Path(directory), prefix, held) if _handles_reload(pid)]
    if not pids:
        raise ChannelError(
            "SHM101",
            f"no bridge with the prefix {prefix} is running on this machine",
            where=directory,
            remedy="Start it with `rosplc run`; `rosplc status` lists the bridges on this machine. Reload "
            "a bridge in a container from inside that container.",
        )
    for pid in pids:
        try:
            os.kill(pid, signal.SIGUSR1)
        except PermissionError as error:
            raise SetupError(
                "SYS013",
                f"this user is not permitted to signal the bridge (process {pid})",
                remedy="Run this as the bridge's user or with sudo; for a service, use systemctl reload.",
            ) from error
        say(f"The bridge with prefix {prefix} (process {pid}) is reloading; its log shows the result.")


def _handles_reload(pid: int) -> bool:
    """Return whether a process handles SIGUSR1; it would end any other, as one with ``rosplc.bind``."""
    try:
        caught = status_mask(Path(f"/proc/{pid}/status"), "SigCgt")
    except OSError:
        return False
    return bool(caught >> (signal.SIGUSR1 - 1) & 1)
