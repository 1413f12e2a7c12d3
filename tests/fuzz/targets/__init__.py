"""Which targets there are; the Python ones are loaded by name, so that they can be instrumented first."""

from __future__ import annotations

import importlib
import importlib.util
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, cast

__all__ = ["TARGETS", "Entry", "Target", "load", "missing"]

_DEBIAN = (Path("/opt/ros/noetic/lib/python3/dist-packages"), Path("/usr/lib/python3/dist-packages"))
_DDS = ("cyclonedds", "the wheel cyclonedds is missing")
_ZENOH = ("zenoh", "the wheel eclipse-zenoh is missing")


class Target(Protocol):
    """A target's module."""

    check: Callable[[bytes], None]
    """Does with an input what rosplc does with it; raises for what must not happen."""
    seeds: Callable[[], Iterable[bytes]]
    """Yields inputs to begin with."""


@dataclass(frozen=True)
class Entry:
    """One target.

    Attributes:
        what: What is fed, in words.
        module: The Python module; empty for a target in C.
        instrument: Packages whose coverage guides the fuzzer.
        longest: The longest input, in bytes.
        needs: A module that must be there, and what to say where it is not.
    """

    what: str
    module: str = ""
    instrument: tuple[str, ...] = ()
    longest: int = 4096
    needs: tuple[str, str] = ("", "")


TARGETS: dict[str, Entry] = {
    "codec": Entry(
        "CDR and ROS 1 bytes, records and damaged conversion plans, for every bundled type", longest=2048
    ),
    "channel": Entry("memory regions that change while the C core reads and writes them", longest=4096),
    "definition": Entry(
        "`.msg` text from files, objects and the network",
        "definition",
        ("rosplc.model", "rosplc.layout", "rosplc.codec", "rosbags.typesys"),
    ),
    "configuration": Entry(
        "`rosplc.yaml`: YAML, settings, types, layouts, the output of `rosplc check`, the PLC project",
        "configuration",
        ("rosplc.config", "rosplc.bridge.ros_side"),
    ),
    "object": Entry(
        "objects in shared memory: headers, self-descriptions and slots, read by all tools",
        "object",
        ("rosplc.shm", "rosplc.described", "rosplc.api", "rosplc.monitor.watch", "rosplc.doctor.objects"),
        8192,
    ),
    "classic": Entry(
        "classic memory and semaphores created by another program",
        "classic",
        ("rosplc.shm", "rosplc.layout"),
        1024,
    ),
    "ros1": Entry(
        "ROS 1: connection headers with definitions, responses and calls of nodes and masters",
        "ros1",
        ("rosplc.ros.rospy", "rosplc.model"),
    ),
    "zenoh": Entry("Zenoh: liveliness tokens, attachments, samples", "zenoh", ("rosplc.ros",), 2048, _ZENOH),
    "dds": Entry("DDS: node announcements, type names, user data", "dds", ("rosplc.ros",), 2048, needs=_DDS),
    "plc": Entry(
        "names, constants, default values and safe messages that try to inject PLC code",
        "plc",
        ("rosplc.plc", "rosplc.layout"),
        1024,
    ),
    "recording": Entry(
        "recordings: MCAP files, as `rosplc replay` opens them", "recording", ("rosplc.recorder", "mcap")
    ),
    "files": Entry(
        "files other than configurations: PLC code and its manifest, folders of `.msg` files, tokens",
        "files",
        ("rosplc.plc.delivery", "rosplc.doctor.code", "rosplc.model", "rosplc.web.access"),
        2048,
    ),
    "arguments": Entry(
        "ROS command-line arguments, ROS environment variables, names",
        "arguments",
        ("rosplc.ros", "rosplc.shm.names"),
        1024,
        _DDS,
    ),
    "page": Entry(
        "browser requests to `rosplc web`",
        "page",
        ("rosplc.web", "rosplc.layout"),
        2048,
        ("aiohttp", "aiohttp is missing: pip install 'rosplc[views]'"),
    ),
}
"""By name."""


def load(name: str) -> Target:
    """Import a Python target's module."""
    return cast(Target, importlib.import_module(f"tests.fuzz.targets.{TARGETS[name].module}"))


def missing(name: str) -> str:
    """Return what keeps a target from running; empty if nothing does."""
    module, why = TARGETS[name].needs
    if not module or importlib.util.find_spec(module) is not None:
        return ""
    if any((place / module).exists() for place in _DEBIAN):
        return ""
    return why
