"""The machine that was measured on: without it no figure says anything."""

from __future__ import annotations

import os
import platform
import subprocess
from collections.abc import Mapping
from datetime import datetime, timezone
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

_PACKAGES = ("rosplc", "pymodbus", "asyncua", "posix_ipc", "iceoryx2", "cyclonedds", "numpy")


def describe() -> dict[str, Any]:
    """Return processor, kernel, governor, versions and load, as JSON holds them."""
    return {
        "when": datetime.now(timezone.utc).isoformat(timespec="seconds"),
        "processor": _processor(),
        "architecture": platform.machine(),
        "cores": len(os.sched_getaffinity(0)),
        "threads_of_one_core": _threads_of_one_core(),
        "virtual": " hypervisor " in _read("/proc/cpuinfo"),
        "governor": _read("/sys/devices/system/cpu/cpu0/cpufreq/scaling_governor").strip() or "unknown",
        "kernel": f"{platform.system()} {platform.release()} {platform.version()}",
        "memory_mib": os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") // 2**20,
        "python": platform.python_version(),
        "compiler": _first_line("gcc", "--version"),
        "libmodbus": _first_line("pkg-config", "--modversion", "libmodbus"),
        "versions": {name: _version(name) for name in _PACKAGES},
        "load_before": load_average(),
    }


def load_average() -> list[float]:
    """Return the load of the last 1, 5 and 15 minutes."""
    return [round(value, 2) for value in os.getloadavg()]


def cores_text(facts: Mapping[str, Any]) -> str:
    """Return how many cores there are, as people write it."""
    return "1 core" if facts["cores"] == 1 else f"{facts['cores']} cores"


def busy(facts: Mapping[str, Any]) -> str:
    """Return a remark if other programs ran when the measurement began; else nothing.

    Args:
        facts: What :func:`describe` has returned.
    """
    load = facts["load_before"][0]
    if load <= facts["cores"] / 2:
        return ""
    return (
        f"Other programs were running (load average {load:.1f} before the run). They delay contenders that "
        "sleep, and long turns, more than short turns that spin: repeat this on an idle machine before "
        "you rely on a ratio."
    )


def _read(path: str) -> str:
    try:
        return Path(path).read_text(encoding="utf-8", errors="replace")
    except OSError:
        return ""


def _processor() -> str:
    for line in _read("/proc/cpuinfo").splitlines():
        if line.startswith(("model name", "Model")):
            return line.partition(":")[2].strip()
    return _read("/proc/device-tree/model").strip("\0\n ") or platform.machine()


def _threads_of_one_core() -> bool:
    """Return whether the two processors that are measured on are threads of one core, as the kernel knows."""
    used = sorted(os.sched_getaffinity(0))[:2]
    siblings = _read(f"/sys/devices/system/cpu/cpu{used[0]}/topology/thread_siblings_list").strip()
    together: set[int] = set()
    for part in filter(None, siblings.split(",")):
        first, _, last = part.partition("-")
        together.update(range(int(first), int(last or first) + 1))
    return len(used) == 2 and used[1] in together


def _first_line(*command: str) -> str:
    try:
        found = subprocess.run(command, capture_output=True, text=True, check=True)
        return found.stdout.splitlines()[0]
    except (OSError, subprocess.CalledProcessError, IndexError):
        return "none"


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "none"
