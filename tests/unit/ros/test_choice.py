"""What ``ros.backend: auto`` becomes."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from rosplc.errors import BackendError
from rosplc.ros import BACKENDS, INSTALL, choose
from rosplc.ros.choice import why_not_installed

SECURE = {"ROS_SECURITY_ENABLE": "true"}
ZENOH = {"RMW_IMPLEMENTATION": "rmw_zenoh_cpp"}
CONNEXT = {"RMW_IMPLEMENTATION": "rmw_connextdds"}


def only(*installed: str) -> Callable[[str], str]:
    """Return a test for a machine that has these backends' packages and no others."""
    return lambda name: "" if name in installed else f"No module named {name!r}"


EVERYTHING = only(*INSTALL)


@pytest.mark.parametrize(
    ("distro", "environment", "installed", "name", "why"),
    [
        ("jazzy", {}, EVERYTHING, "dds", "ROS 2 uses DDS"),
        ("humble", {"RMW_IMPLEMENTATION": "rmw_fastrtps_cpp"}, EVERYTHING, "dds", "rmw_fastrtps_cpp"),
        ("jazzy", {"RMW_IMPLEMENTATION": "rmw_fastrtps_dynamic_cpp"}, EVERYTHING, "dds", "dynamic"),
        ("kilted", {"RMW_IMPLEMENTATION": " rmw_cyclonedds_cpp "}, EVERYTHING, "dds", "rmw_cyclonedds_cpp"),
        ("jazzy", {"RMW_IMPLEMENTATION": "rmw_cyclonedds_cpp"}, only("rclpy"), "rclpy", "rmw_cyclonedds_cpp"),
        ("jazzy", {"RMW_IMPLEMENTATION": ""}, EVERYTHING, "dds", "unless RMW_IMPLEMENTATION is set"),
        ("jazzy", {}, only("rclpy", "zenoh", "rospy"), "rclpy", "ROS 2 uses DDS"),
        ("jazzy", {}, only("dds", "rospy"), "dds", "ROS 2 uses DDS"),
        ("jazzy", SECURE, EVERYTHING, "rclpy", "ROS_SECURITY_ENABLE is true"),
        ("jazzy", SECURE | ZENOH, EVERYTHING, "rclpy", "ROS_SECURITY_ENABLE is true"),
        ("jazzy", {"ROS_SECURITY_ENABLE": "false"}, EVERYTHING, "dds", "ROS 2 uses DDS"),
        ("jazzy", {"ROS_SECURITY_ENABLE": "True"}, EVERYTHING, "dds", "ROS 2 uses DDS"),  # as in rcl
        ("jazzy", ZENOH, EVERYTHING, "zenoh", "RMW_IMPLEMENTATION is rmw_zenoh_cpp"),
        ("jazzy", ZENOH, only("dds", "rclpy"), "rclpy", "RMW_IMPLEMENTATION is rmw_zenoh_cpp"),
        ("jazzy", CONNEXT, EVERYTHING, "rclpy", "RMW_IMPLEMENTATION is rmw_connextdds"),
        ("noetic", {}, EVERYTHING, "rospy", "noetic is ROS 1"),
        ("noetic", {}, only("rospy"), "rospy", "noetic is ROS 1"),
        ("noetic", ZENOH | SECURE, EVERYTHING, "rospy", "noetic is ROS 1"),
    ],
)
def test_graph_and_machine_decide(
    distro: str, environment: dict[str, str], installed: Callable[[str], str], name: str, why: str
) -> None:
    """The distribution and the environment say what reaches the graph; what is installed decides among it."""
    choice = choose(distro, environment, missing=installed)
    assert choice.name == name
    assert why in choice.why
    assert set(choice.passed_over) == set(INSTALL) - {name}


def test_services_prefer_rclpy() -> None:
    """It carries them with every RMW implementation; dds follows where it is missing, with the reason."""
    assert choose("jazzy", {}, services=True, missing=EVERYTHING).name == "rclpy"
    choice = choose("jazzy", {}, services=True, missing=only("dds", "zenoh"))
    assert choice.name == "dds"
    assert "only with rmw_cyclonedds" in choice.why
    assert "not installed" in choice.passed_over["rclpy"]
    assert choose("jazzy", ZENOH, services=True, missing=EVERYTHING).name == "zenoh"


def test_choice_says_what_was_passed_over_and_why() -> None:
    """The sentence names the backend, the reason, and each backend that was not taken."""
    words = str(choose("jazzy", {}, missing=only("rclpy")))
    assert words.startswith("rclpy, because ROS 2 uses DDS unless RMW_IMPLEMENTATION is set")
    assert "dds: not installed: No module named 'dds'" in words
    assert "zenoh: does not support DDS" in words
    assert "rospy: is for ROS 1" in words


def test_settings_for_zenoh_ask_for_it() -> None:
    """A configuration with a section for Zenoh means Zenoh, without the environment."""
    choice = choose("jazzy", {}, zenoh_settings=True, missing=EVERYTHING)
    assert (choice.name, "ros.zenoh" in choice.why) == ("zenoh", True)
    assert choose("jazzy", CONNEXT, zenoh_settings=True, missing=only("zenoh")).name == "zenoh"
    assert choose("jazzy", SECURE, zenoh_settings=True, missing=EVERYTHING).name == "rclpy"
    with pytest.raises(BackendError, match=r"ros\.zenoh") as refused:
        choose("jazzy", {}, zenoh_settings=True, missing=only("dds", "rclpy"))
    assert INSTALL["zenoh"] in refused.value.remedy


@pytest.mark.parametrize(
    ("distro", "environment", "installed", "named"),
    [
        ("jazzy", {}, only("zenoh", "rospy"), ("dds", "rclpy")),
        ("jazzy", SECURE, only("dds", "zenoh"), ("rclpy",)),
        ("jazzy", ZENOH, only("dds"), ("zenoh", "rclpy")),
        ("jazzy", CONNEXT, only("dds"), ("rclpy",)),
        ("noetic", {}, only("dds", "rclpy", "zenoh"), ("rospy",)),
    ],
)
def test_nothing_usable_is_an_error_with_remedies(
    distro: str, environment: dict[str, str], installed: Callable[[str], str], named: tuple[str, ...]
) -> None:
    """What would reach nobody is not chosen; the error names every backend, and how to install what would."""
    with pytest.raises(BackendError) as refused:
        choose(distro, environment, missing=installed)
    assert refused.value.code == "ROS001"
    for name in INSTALL:
        assert f"{name} (" in refused.value.what
        assert (INSTALL[name] in refused.value.remedy) is (name in named)


def test_this_machine_is_asked() -> None:
    """With ROS 1 on this machine, ``noetic`` gets it, and ROS 2 does not; without it, that is the error."""
    if missing := why_not_installed("rospy"):
        with pytest.raises(BackendError, match="ROS001") as refused:
            choose("noetic", {})
        assert missing in refused.value.what
    else:
        assert choose("noetic", {}).name == "rospy"
    if not why_not_installed("dds"):
        assert choose("jazzy", {}).passed_over["rospy"] == "is for ROS 1"


def test_memory_is_never_chosen() -> None:
    """The backend for tests needs no package, and ``auto`` does not take it."""
    assert set(BACKENDS) - set(INSTALL) == {"memory"}
    with pytest.raises(BackendError):
        choose("jazzy", {}, missing=only("memory"))
