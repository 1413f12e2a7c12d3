"""How the installed services stand, as systemd tells it."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

from rosplc.errors import SetupError
from rosplc.service.install import instances

__all__ = ["service_states"]

_PROPERTIES = ("ActiveState", "SubState", "UnitFileState", "NRestarts", "StatusText")


def service_states(root: Path, name: str | None = None) -> list[dict[str, object]]:
    """Return a dictionary for each installed bridge: name, unit, enabled, active, restarts, status.

    Args:
        root: Where ``/etc`` lies.
        name: Only this one.

    Raises:
        SetupError: SYS011 if that one is not installed.
    """
    names = instances(root)
    if name is not None and name not in names:
        there = f"; there are: {', '.join(names)}" if names else ""
        raise SetupError(
            "SYS011",
            f"no service rosplc@{name} is installed{there}",
            remedy="Install it: rosplc service install.",
        )
    return [_state(each, root) for each in names if name in (None, each)]


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
    try:
        said = subprocess.run(
            ["systemctl", "show", f"--property={','.join(_PROPERTIES)}", unit],
            capture_output=True,
            text=True,
            timeout=10,
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired):
        return {}
    return dict(line.partition("=")[::2] for line in said.stdout.splitlines())
