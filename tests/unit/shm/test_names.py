"""Names of objects: spec/shm-format.md, section 8.1."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rosplc.errors import ChannelError
from rosplc.shm import Namespace
from rosplc.shm.constants import MAX_NAME
from rosplc.shm.names import fnv1a

_TOPICS = st.lists(st.from_regex(r"[A-Za-z_][A-Za-z0-9_]{0,15}", fullmatch=True), min_size=1, max_size=8).map(
    lambda parts: "/" + "/".join(parts)
)


def test_names_of_a_topic() -> None:
    """Slashes become dots, and the kind letter tells object, lock and temporary apart."""
    namespace = Namespace("cell1")
    assert namespace.object_name("/robot1/cmd_vel") == "cell1.t.robot1.cmd_vel"
    assert str(namespace.path("/robot1/cmd_vel")) == "/dev/shm/cell1.t.robot1.cmd_vel"
    assert str(namespace.lock_path("/robot1/cmd_vel")) == "/dev/shm/cell1.l.robot1.cmd_vel"
    assert namespace.temporary_prefix("/robot1/cmd_vel") == "cell1.n.robot1.cmd_vel."


@given(_TOPICS)
def test_names_fit_and_are_reversible(topic: str) -> None:
    """No name exceeds a PLC's default STRING, and one that was not shortened leads back to its topic."""
    namespace = Namespace("rosplc")
    name = namespace.object_name(topic)
    assert len(name) <= MAX_NAME
    assert namespace.name_of(name) == (None if "~" in name else (topic, ""))
    assert ("~" in name) == (len("rosplc.t.") + len(topic) - 1 > MAX_NAME)


def test_shortened_name() -> None:
    """A name beyond 80 characters keeps 71, then a tilde and the FNV-1a hash of the whole."""
    topic = "/" + "a" * 80
    whole = "rosplc.t." + "a" * 80
    name = Namespace().object_name(topic)
    assert name == whole[:71] + "~" + f"{fnv1a(whole):08x}"
    assert len(name) == 80
    assert Namespace().lock_path(topic).name == name.replace(".t.", ".l.", 1)


def test_name_of_80_characters_stays() -> None:
    """Exactly 80 characters are not shortened."""
    assert Namespace().object_name("/" + "a" * 71) == "rosplc.t." + "a" * 71


@pytest.mark.parametrize(("text", "value"), [("", 0x811C9DC5), ("a", 0xE40C292C), ("foobar", 0xBF9CF968)])
def test_fnv1a(text: str, value: int) -> None:
    """The hash agrees with the published test vectors of FNV-1a."""
    assert fnv1a(text) == value


@pytest.mark.parametrize(
    "topic",
    ["", "/", "cmd_vel", "/a/", "//a", "/1a", "/a.b", "/a b", "/a\n", "/é", "/a/../b", "/a\0", "~a", "/~a"],
)
def test_topics_that_are_no_names(topic: str) -> None:
    """What ROS does not allow as a fully qualified topic is refused."""
    with pytest.raises(ChannelError) as caught:
        Namespace().path(topic)
    assert caught.value.code == "SHM118"


@pytest.mark.parametrize("prefix", ["", "1a", "a.b", "a/b", "a" * 33, "a\n", "..", "é"])
def test_prefixes_that_are_no_names(prefix: str) -> None:
    """A prefix that could leave the directory or be taken for another is refused."""
    with pytest.raises(ChannelError) as caught:
        Namespace(prefix)
    assert caught.value.code == "SHM118"


def test_missing_directory_is_named(tmp_path: object) -> None:
    """Listing in a directory that does not exist says so."""
    with pytest.raises(ChannelError, match="SHM123"):
        Namespace("rosplc", f"{tmp_path}/none").topics()
