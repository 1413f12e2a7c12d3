"""Which backend ``ros.backend: auto`` selects on this machine, and why.

docs/explanation/decisions.md gives the reasons: the ROS graph determines which backends can reach it,
the machine which ones are installed; a backend that would reach no node is not selected.
"""

from __future__ import annotations

import importlib
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from rosplc.errors import BackendError

BACKENDS: dict[str, str] = {
    "dds": "rosplc.ros.dds",
    "rclpy": "rosplc.ros.rclpy",
    "zenoh": "rosplc.ros.zenoh",
    "rospy": "rosplc.ros.rospy",
    "memory": "rosplc.ros.memory",
}
"""Backend name → the module whose ``open_backend`` opens the backend; imported on demand."""

INSTALL: dict[str, str] = {
    "dds": "pip install 'cyclonedds>=11,<12' (x86-64, Python before 3.14)",
    "rclpy": "install ROS 2, source its setup.bash and use the Python that its packages are built for",
    "zenoh": "pip install 'rosplc[zenoh]'",
    "rospy": "reinstall rosplc, which includes this backend",
}
"""Backend name → how to install its package."""

ROS1 = "noetic"
"""The only ROS 1 distribution; all others are ROS 2."""

# The RMW implementations that the DDS backend is tested against; the empty name is ROS 2's default.
_PLAIN_DDS = ("", "rmw_fastrtps_cpp", "rmw_fastrtps_dynamic_cpp", "rmw_cyclonedds_cpp")


@dataclass(frozen=True)
class Choice:
    """A selected backend."""

    name: str  # the backend
    why: str  # what decided, in words
    passed_over: Mapping[str, str] = field(default_factory=dict)  # backend → why it was not taken

    def __str__(self) -> str:
        others = "; ".join(f"{name}: {why}" for name, why in self.passed_over.items())
        return f"{self.name}, because {self.why}" + (f" (passed over: {others})" if others else "")


def load(name: str) -> Any:
    """Import a backend's module; ImportError if its package is missing."""
    return importlib.import_module(BACKENDS[name])


def why_not_installed(name: str) -> str:
    """Return why a backend cannot be imported here; empty if it can."""
    try:
        load(name)
    except ImportError as error:
        return str(error)
    return ""


def choose(
    distro: str,
    environment: Mapping[str, str] | None = None,
    *,
    zenoh_settings: bool = False,
    services: bool = False,
    missing: Callable[[str], str] = why_not_installed,
) -> Choice:
    """Select a backend for the ROS distribution whose definitions the configuration uses.

    The environment variables ``RMW_IMPLEMENTATION`` and ``ROS_SECURITY_ENABLE`` are considered.
    ``zenoh_settings``: the configuration has settings for Zenoh; ``services``: it has services or actions,
    which ``rclpy`` carries with any middleware; ``missing`` returns why a backend cannot be imported, or an
    empty text. Raises BackendError ROS001, with installation commands, if no usable backend is installed.
    """
    variables = os.environ if environment is None else environment
    wanted, why, unfit = _candidates(distro, variables, zenoh_settings, services)
    passed_over = {}
    for place, name in enumerate(wanted):
        if reason := missing(name):
            passed_over[name] = f"not installed: {reason}"
            continue
        # In the order of BACKENDS, so that the same machine always says the same.
        others = passed_over | unfit | dict.fromkeys(wanted[place + 1 :], f"has lower priority than {name}")
        return Choice(name, why, {other: others[other] for other in BACKENDS if other in others})
    everything = {**passed_over, **unfit}
    tried = "; ".join(f"{name} ({everything[name]})" for name in INSTALL if name in everything)
    raise BackendError(
        "ROS001",
        f"ros.backend: auto found no usable backend ({why}): {tried}",
        where="ros.backend",
        remedy="Install one: "
        + "; ".join(f"for {name}: {INSTALL[name]}" for name in wanted)
        + ". Or set another backend in ros.backend.",
    )


def _candidates(
    distro: str, variables: Mapping[str, str], zenoh_settings: bool, services: bool
) -> tuple[tuple[str, ...], str, dict[str, str]]:
    """Return the possible backends in order of preference, the reason, and why the others are excluded."""
    rmw = variables.get("RMW_IMPLEMENTATION", "").strip()
    secured = variables.get("ROS_SECURITY_ENABLE", "") == "true"  # as rcl compares: nothing else enables it
    if distro == ROS1:
        why = f"{distro} is ROS 1"
        return ("rospy",), why, dict.fromkeys(("dds", "rclpy", "zenoh"), "is for ROS 2")
    unfit = {"rospy": "is for ROS 1"}
    if secured:
        why = "ROS_SECURITY_ENABLE is true"
        return ("rclpy",), why, unfit | dict.fromkeys(("dds", "zenoh"), "does not support ROS 2 security")
    if zenoh_settings:
        why = "the configuration has settings in ros.zenoh"
        return ("zenoh",), why, unfit | dict.fromkeys(("dds", "rclpy"), "does not read ros.zenoh")
    if rmw == "rmw_zenoh_cpp":
        return ("zenoh", "rclpy"), f"RMW_IMPLEMENTATION is {rmw}", unfit | {"dds": "does not support Zenoh"}
    unfit["zenoh"] = "does not support DDS, and RMW_IMPLEMENTATION is not rmw_zenoh_cpp"
    if rmw not in _PLAIN_DDS:
        why = f"RMW_IMPLEMENTATION is {rmw}"
        return ("rclpy",), why, unfit | {"dds": f"may not be compatible with {rmw}"}
    why = f"RMW_IMPLEMENTATION is {rmw}" if rmw else "ROS 2 uses DDS unless RMW_IMPLEMENTATION is set"
    if services:
        why += "; rclpy is preferred: dds exchanges service calls only with rmw_cyclonedds"
        return ("rclpy", "dds"), why, unfit
    return ("dds", "rclpy"), why, unfit
