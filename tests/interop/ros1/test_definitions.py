"""Services and actions against the classes in Debian's packages, which ROS 1's generator has written."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path

import pytest

from rosplc.model import TypeStore

PACKAGES = (
    "python3-actionlib", "python3-diagnostic-msgs", "python3-dynamic-reconfigure", "python3-map-msgs",
    "python3-move-base-msgs", "python3-nav-msgs", "python3-pcl-msgs", "python3-roscpp-msg",
    "python3-sensor-msgs", "python3-std-srvs", "python3-tf2-msgs",
)  # fmt: skip
pytestmark = [pytest.mark.needs(*PACKAGES), pytest.mark.verifies("ros1", real="Debian's message classes")]

STORE = TypeStore.bundled("noetic")
GENERATED = Path("/usr/lib/python3/dist-packages")
WITHOUT_PACKAGE = {"actionlib_tutorials", "roscpp_tutorials", "rospy_tutorials", "turtlesim"}


@cache
def published(package: str) -> dict[str, str]:
    """Return type → MD5 sum of every class that a package's modules define."""
    found = {}
    for file in (GENERATED / package).glob("*/_*.py"):
        for text in file.read_text("utf-8").split("\nclass ")[1:]:
            marks = [
                re.search(rf"^  {mark}\s*= ['\"](\S+)['\"]", text, re.M) for mark in ("_type", "_md5sum")
            ]
            if all(marks):
                found[marks[0][1]] = marks[1][1]  # type: ignore[index]
    return found


def names(every: tuple[str, ...]) -> list[tuple[str, str, str]]:
    """Return full name, package and base name of those with a package."""
    split = [(name, name.split("/")[0], name.split("/")[2]) for name in every]
    return [each for each in split if each[1] not in WITHOUT_PACKAGE]


def test_services() -> None:
    """The sums of every service, of its request and of its response are those of ROS 1's generator."""
    services = names(STORE.services())
    assert len(services) > 20
    for name, package, base in services:
        ours = {f"{package}/{base}": STORE.service_md5(name)}
        ours |= {f"{package}/{base}{part}": STORE.md5(f"{name}_{part}") for part in ("Request", "Response")}
        assert {each: published(package)[each] for each in ours} == ours


def test_actions() -> None:
    """So are those of an action's parts, by both names, and of the messages that wrap them."""
    actions = names(STORE.actions())
    assert len(actions) > 5
    for name, package, base in actions:
        parts = ("Goal", "Result", "Feedback")
        own = {f"{package}/{base}{part}": STORE.md5(f"{name}_{part}") for part in parts}
        wrapped = (*parts, "Action", *(f"Action{part}" for part in parts))
        ours = {f"{package}/{base}{part}": STORE.md5(f"{package}/{base}{part}") for part in wrapped}
        assert ours.items() >= own.items()
        assert {each: published(package)[each] for each in ours} == ours
