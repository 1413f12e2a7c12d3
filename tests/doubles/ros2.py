"""Puts the double of rclpy onto a test's machine, and takes it off again without a trace."""

from __future__ import annotations

import contextlib
import importlib
import os
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from rosplc.model import TypeStore

FOLDER = str(Path(__file__).parent)
_OURS = ("rclpy", "rosplc.ros.rclpy", "launch", "launch_ros", "rosplc_bridge")


@contextlib.contextmanager
def double(distro: str = "jazzy", paths: Iterable[str] = ()) -> Iterator[Any]:
    """Make ``import rclpy`` find the double, as on a machine with that ROS 2 distribution.

    Args:
        distro: ``humble`` or ``jazzy``; it is also in ``ROS_DISTRO``.
        paths: Further folders to import from.
    """
    before = os.environ.get("ROS_DISTRO")
    store = TypeStore.bundled("jazzy")
    packages = {name.split("/")[0] for name in (*store.names(), *store.services(), *store.actions())}
    others = {name: sys.modules.pop(name) for name in list(sys.modules) if name.split(".")[0] in packages}
    os.environ["ROS_DISTRO"] = distro
    sys.path[:0] = [FOLDER, *paths]
    try:
        module = importlib.import_module("rclpy")
        messages = importlib.import_module("rclpy._messages")
        yield module
        messages.uninstall()
    finally:
        for folder in (FOLDER, *paths):
            sys.path.remove(folder)
        for name in [n for n in sys.modules if n in _OURS or n.startswith(tuple(f"{o}." for o in _OURS))]:
            del sys.modules[name]
        sys.modules.update(others)  # of ROS 1, if this machine has it
        if before is None:
            del os.environ["ROS_DISTRO"]
        else:
            os.environ["ROS_DISTRO"] = before


@contextlib.contextmanager
def installed(store: TypeStore, without: Iterable[str] = ()) -> Iterator[None]:
    """Let the message packages have these definitions, or be missing."""
    messages = importlib.import_module("rclpy._messages")
    before = messages._installation.store
    messages.change(store, without)
    try:
        yield
    finally:
        messages.change(before)
