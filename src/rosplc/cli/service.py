"""``rosplc service``: a bridge that starts with the machine, as a hardened service of systemd.

rosplc service install cell1 --dry-run  —  show every file and command for /etc/rosplc/cell1.yaml

rosplc service install cell1  —  install the service, so that the bridge starts at every boot

rosplc service status  —  list the bridges installed as services, with their status

rosplc service uninstall cell1  —  stop and remove the service; keep the user, configuration and objects

Installing and removing a service requires root. The service runs as a dedicated user, without capabilities.
If the configuration has `realtime:`, the service also gets the limits that these settings need.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Literal

import typer

from rosplc.cli.text import print_json, say, table, warn
from rosplc.cli.verb import verb
from rosplc.errors import SetupError
from rosplc.service.install import (
    Run,
    Step,
    Write,
    execute,
    in_words,
    install_steps,
    plan_service,
    require_systemd,
    service_states,
    uninstall_steps,
)


@verb
def command(
    what: Literal["install", "uninstall", "status"],
    name: str | None = None,
    /,
    *,
    config: Path | None = None,
    user: str = "rosplc",
    root: Path = Path("/"),
    dry_run: bool = False,
    as_json: bool = False,
) -> None:
    """Run a bridge as a systemd service: install it, remove it, or show its status.

    Options:
        what WHAT: `install`, `uninstall` or `status`.
        name: The service's name; by default the name of the configuration file.
        config FILE: The configuration; /etc/rosplc/NAME.yaml by default.
        user NAME: The user that runs the bridge; created if missing.
        root DIR: Install into this folder instead of /, to prepare a machine image.
        dry_run: Show what would be done.
    """
    root = root.absolute()
    if what == "status":
        _show(service_states(root, name), as_json=as_json)
        return
    if not dry_run and root == Path("/") and os.geteuid() != 0:
        raise SetupError(
            "SYS011",
            f"only root may {what} a service",
            remedy="Run this command with sudo. --dry-run shows the steps and needs no privileges.",
        )
    notes: tuple[str, ...] = ()
    if what == "install":
        plan, notes = plan_service(name, config, user, root, Path(sys.argv[0]))
        steps = install_steps(plan, root)
    else:
        if name is None:
            raise typer.BadParameter("specify the service to remove", param_hint="NAME")
        steps = uninstall_steps(name, root)
    if not dry_run and root == Path("/"):
        require_systemd()
    if as_json:
        print_json({"done": not dry_run, "steps": [_facts(step) for step in steps], "notes": list(notes)})
    elif dry_run:
        _explain(steps)
    for note in notes:
        if not as_json:
            warn(f"Note: {note}")
    if dry_run:
        return
    execute(steps, (lambda _: None) if as_json else say)
    if what == "install" and not as_json:
        say(f"\nThe service starts at boot. To start it now: systemctl start {plan.unit}")


def _facts(step: Step) -> dict[str, object]:
    if isinstance(step, Run):
        return {"run": list(step.argv)}
    path = str(step.path)
    return {"write": path, "text": step.text} if isinstance(step, Write) else {"remove": path}


def _explain(steps: list[Step]) -> None:
    for step in steps:
        say(in_words(step))
        if isinstance(step, Write):
            say("".join(f"    {line}\n" for line in step.text.splitlines()))


def _show(states: list[dict[str, object]], *, as_json: bool) -> None:
    if as_json:
        print_json({"services": states})
        return
    if not states:
        say("No bridge is installed as a service.")
        return
    rows = [(s["unit"], s["enabled"], s["active"], s["restarts"], s["status"]) for s in states]
    table(rows, header=("service", "at boot", "now", "restarts", "status"))
