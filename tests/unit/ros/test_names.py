"""Names of nodes and topics."""

from __future__ import annotations

import pytest

from rosplc.errors import BackendError
from rosplc.ros.names import (
    dds_type_name,
    join,
    resolve_topic,
    ros_type_name,
    validate_namespace,
    validate_node_name,
    validate_topic,
)


@pytest.mark.parametrize(
    "name", ["/a", "/cmd_vel", "/robot1/arm/joint_states", "/_hidden", "/a__b", "/" + "x" * 246]
)
def test_good_topics_pass(name: str) -> None:
    """A valid absolute name comes back as it is."""
    assert validate_topic(name) == name


@pytest.mark.parametrize(
    "name",
    [
        "",
        "/",
        "cmd_vel",
        "/a/",
        "//a",
        "/a//b",
        "/1a",
        "/a/1b",
        "/a b",
        "/a-b",
        "/ä",
        "/a\n",
        "/{x}",
        "/" + "x" * 247,
    ],
)
def test_bad_topics_are_refused(name: str) -> None:
    """A name that breaks a rule of ROS is refused with its text in the message."""
    with pytest.raises(BackendError, match="ROS005") as refused:
        validate_topic(name)
    assert repr(name) in str(refused.value)


@pytest.mark.parametrize("name", ["", "a/b", "1a", "a-b", "a\n", "x" * 256])
def test_bad_node_names_are_refused(name: str) -> None:
    """A node's base name is one token."""
    with pytest.raises(BackendError, match="ROS005"):
        validate_node_name(name)


@pytest.mark.parametrize("name", ["", "a", "/a/", "/1"])
def test_bad_namespaces_are_refused(name: str) -> None:
    """A namespace is absolute and ends with no slash, except the root."""
    with pytest.raises(BackendError, match="ROS005"):
        validate_namespace(name)
    assert validate_namespace("/") == "/"


def test_names_are_joined() -> None:
    """The root namespace adds one slash only."""
    assert (join("/", "a"), join("/ns", "a")) == ("/a", "/ns/a")


@pytest.mark.parametrize(
    ("name", "full"),
    [("/abs", "/abs"), ("rel", "/ns/rel"), ("rel/x", "/ns/rel/x"), ("~", "/ns/node"), ("~/x", "/ns/node/x")],
)
def test_topics_are_expanded(name: str, full: str) -> None:
    """Relative names get the namespace, private ones the node's full name."""
    assert resolve_topic(name, namespace="/ns", node_name="node") == full


def test_remapping_compares_expanded_names() -> None:
    """A rule applies however its two sides are written, and only to its own topic."""
    rules = {"a": "/x", "/ns/b": "y", "~/c": "~/z"}
    found = [
        resolve_topic(n, namespace="/ns", node_name="n", remap=rules) for n in ("/ns/a", "b", "/ns/n/c", "/a")
    ]
    assert found == ["/x", "/ns/y", "/ns/n/z", "/a"]


def test_type_names_in_dds_and_zenoh() -> None:
    """A type has the name that every ROS 2 middleware gives it; other names are left as they are."""
    assert dds_type_name("pkg/msg/T") == "pkg::msg::dds_::T_"
    assert ros_type_name("pkg::msg::dds_::T_") == "pkg/msg/T"
    assert [ros_type_name(name) for name in ("Plain::Type", "not/a::type")] == ["Plain::Type", "not/a::type"]
