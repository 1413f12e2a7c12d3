"""Self-descriptions: spec/shm-format.md, section 6."""

from __future__ import annotations

import json

import pytest

from rosplc.errors import ChannelError
from rosplc.shm import Description
from tests.lib.channels import describe


def test_round_trip() -> None:
    """What is written is what is read, and exactly the members of the spec are there."""
    text = describe().to_json()
    assert Description.from_json(text) == describe()
    assert set(json.loads(text)) == {
        "format",
        "topic",
        "type",
        "distro",
        "direction",
        "limits",
        "layout_id",
        "bridge",
        "definition",
    }


def test_unknown_members_are_ignored() -> None:
    """A later minor version may add members."""
    members = json.loads(describe().to_json()) | {"colour": "green", "format": "rosplc 1.7"}
    assert Description.from_json(json.dumps(members).encode()) == describe()


@pytest.mark.parametrize(
    "change",
    [
        {"topic": 5},
        {"type": None},
        {"limits": []},
        {"direction": "sideways"},
        {"layout_id": "xyz"},
        {"format": "rosplc 2.0"},
    ],
)
def test_members_of_the_wrong_kind(change: dict[str, object]) -> None:
    """A member that is missing or wrong is an error with a number, not a traceback."""
    members = json.loads(describe().to_json()) | change
    with pytest.raises(ChannelError, match="SHM113"):
        Description.from_json(json.dumps(members).encode())


@pytest.mark.parametrize(
    "text", [b"", b"\xff\xfe", b"[]", b"nul", b"{}", b"\0" * 50, b"[" * 100_000, b'{"topic": "\\ud800"']
)
def test_what_is_no_description(text: bytes) -> None:
    """Whatever is there, the answer is SHM113."""
    with pytest.raises(ChannelError, match="SHM113"):
        Description.from_json(text)


def test_too_long_a_description() -> None:
    """A definition that does not fit is refused when it is written."""
    long = Description(**(vars(describe()) | {"definition": "x" * 2**20}))
    with pytest.raises(ValueError):
        long.to_json()
