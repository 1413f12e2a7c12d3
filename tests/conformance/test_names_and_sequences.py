"""Names of objects and sequence arithmetic agree with names.json and sequences.json in spec/vectors."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import pytest

from rosplc._core import distance as native_distance
from rosplc._core import next_sequence as native_next
from rosplc.errors import ChannelError
from rosplc.shm import Namespace, Part
from rosplc.shm.constants import MAX_NAME
from rosplc.shm.names import fnv1a

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "spec" / "model"))

import sequences as model  # noqa: E402  (spec/model is no package)

NAMES: dict[str, Any] = json.loads((ROOT / "spec/vectors/names.json").read_text("utf-8"))
SEQUENCES: dict[str, Any] = json.loads((ROOT / "spec/vectors/sequences.json").read_text("utf-8"))


@pytest.mark.parametrize("case", NAMES["valid"], ids=lambda case: f"{case['prefix']}{case['topic']}")
def test_a_topic_has_its_name(case: dict[str, str], tmp_path: Path) -> None:
    """A topic leads to the names of its object, its lock file and its temporaries."""
    namespace = Namespace(case["prefix"], tmp_path)
    assert namespace.object_name(case["topic"]) == case["object"]
    assert namespace.path(case["topic"]) == tmp_path / case["object"]
    assert namespace.lock_path(case["topic"]) == tmp_path / case["lock"]
    assert namespace.temporary_prefix(case["topic"]) == case["temporary"]
    assert len(case["object"]) <= MAX_NAME


@pytest.mark.parametrize("case", NAMES["calls"], ids=lambda case: case["object"][:40])
def test_a_call_has_its_names(case: dict[str, str], tmp_path: Path) -> None:
    """The objects of services and actions, with a client or without, have names and locks of their own."""
    namespace = Namespace(case["prefix"], tmp_path)
    name = case["topic"], Part[case["part"].upper()], case["client"]
    assert namespace.object_name(*name) == case["object"]
    assert namespace.lock_path(*name) == tmp_path / case["lock"]
    assert namespace.temporary_prefix(*name) == case["temporary"]
    assert len(case["object"]) <= MAX_NAME
    assert namespace.part_of(case["object"]) is name[1]
    assert namespace.name_of(case["object"]) in (None if "~" in case["object"] else (name[0], name[2]),)


@pytest.mark.parametrize("client", NAMES["invalid_clients"])
def test_what_is_no_client_is_refused(client: str) -> None:
    """A client's name cannot leave the directory or become another object's."""
    with pytest.raises(ChannelError, match="SHM118"):
        Namespace().object_name("/add", Part.REQUEST, client)


@pytest.mark.parametrize("topic", NAMES["invalid_topics"])
def test_a_topic_that_is_none_is_refused(topic: str, tmp_path: Path) -> None:
    """A topic outside the pattern never becomes a file name."""
    with pytest.raises(ChannelError, match="SHM118"):
        Namespace("rosplc", tmp_path).object_name(topic)


@pytest.mark.parametrize("prefix", NAMES["invalid_prefixes"])
def test_a_prefix_that_is_none_is_refused(prefix: str, tmp_path: Path) -> None:
    """A prefix outside the pattern never becomes part of a file name."""
    with pytest.raises(ChannelError, match="SHM118"):
        Namespace(prefix, tmp_path)


def test_names_of_different_topics_differ() -> None:
    """Shortening keeps the vectors' topics apart."""
    names = [case["object"] for case in NAMES["valid"]]
    assert len(names) == len(set(names))


@pytest.mark.parametrize(("text", "value"), NAMES["fnv1a"])
def test_the_hash_is_fnv1a(text: str, value: int) -> None:
    """The hash is the published FNV-1a with 32 bits."""
    assert fnv1a(text) == value


@pytest.mark.parametrize("implementation", [native_next, model.next_sequence], ids=["product", "model"])
@pytest.mark.parametrize("case", SEQUENCES["next"], ids=str)
def test_next(case: dict[str, int], implementation: Any) -> None:
    """The wrap skips 0 to N - 1."""
    assert implementation(case["sequence"], case["slots"]) == case["next"]


@pytest.mark.parametrize("implementation", [native_distance, model.distance], ids=["product", "model"])
@pytest.mark.parametrize("case", SEQUENCES["distance"], ids=str)
def test_distance(case: dict[str, int], implementation: Any) -> None:
    """A distance counts messages, over the wrap too."""
    assert implementation(case["from"], case["to"], case["slots"]) == case["distance"]


@pytest.mark.parametrize("case", SEQUENCES["advance"], ids=str)
def test_advance(case: dict[str, int]) -> None:
    """Advancing is next as often as said, and the distance is that number again."""
    assert model.advance(case["sequence"], case["count"], case["slots"]) == case["result"]
    assert model.distance(case["sequence"], case["result"], case["slots"]) == case["count"]
    if case["count"] < 100:
        sequence = case["sequence"]
        for _ in range(case["count"]):
            sequence = native_next(sequence, case["slots"])
        assert sequence == case["result"]
