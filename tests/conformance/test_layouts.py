"""The package agrees with the layout vectors, which a second implementation writes."""

from __future__ import annotations

import hashlib
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from rosplc.layout import Layout, Limits, compute_layout
from rosplc.model import TypeStore

pytestmark = pytest.mark.verifies("vectors", own="vectors from an independent implementation")

VECTORS = Path(__file__).parents[2] / "spec" / "vectors"
FILES = sorted((VECTORS / "layouts").glob("*.json"))


def test_there_are_vectors() -> None:
    """An empty folder of vectors is an error, not a pass."""
    assert len(FILES) >= 20


def test_the_generator_writes_these_vectors() -> None:
    """The second implementation still writes exactly the vectors that are here."""
    done = subprocess.run(
        [sys.executable, VECTORS / "generate_layouts.py", "--verify"],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert done.returncode == 0, done.stderr


@pytest.fixture(params=FILES, ids=lambda file: file.stem)
def vector(request: pytest.FixtureRequest) -> dict[str, Any]:
    content: dict[str, Any] = json.loads(request.param.read_text(encoding="utf-8"))
    return content


@pytest.fixture
def layout(vector: dict[str, Any]) -> Layout:
    distro = "noetic" if vector["ros_version"] == 1 else "jazzy"
    store = TypeStore.from_definition(vector["type"], vector["definition"], distro=distro)
    return compute_layout(store, vector["type"], Limits.from_dict(vector["limits"]))


def test_the_layout_is_the_vectors(vector: dict[str, Any], layout: Layout) -> None:
    """Text, id, its two words, size and alignment are those of the vector."""
    assert layout.text == vector["text"]
    assert layout.layout_id == vector["layout_id"]
    assert list(layout.layout_id_words) == vector["layout_id_words"]
    assert (layout.size, layout.align) == (vector["size"], vector["align"])


def test_the_id_follows_from_the_text(vector: dict[str, Any]) -> None:
    """The layout id is the beginning of the SHA-256 of the vector's own text."""
    assert hashlib.sha256(vector["text"].encode()).hexdigest()[:16] == vector["layout_id"]


def test_an_unfilled_record_holds_the_defaults(vector: dict[str, Any], layout: Layout) -> None:
    """The initial record is the vector's, and packing nothing gives it."""
    assert layout.initial().hex() == vector["initial"]
    assert layout.pack({}).hex() == vector["initial"]


def test_values_become_records_and_come_back(vector: dict[str, Any], layout: Layout) -> None:
    """Each value packs to the vector's record, which reads as that value again."""
    assert vector["values"]
    for pair in vector["values"]:
        record = bytes.fromhex(pair["record"])
        assert layout.pack(pair["value"]).hex() == pair["record"]
        assert contains(layout.to_dict(record), pair["value"])
        assert layout.pack(layout.view(record)) == record


def test_careless_records_are_read(vector: dict[str, Any], layout: Layout) -> None:
    """What a record holds outside of its values, or beyond a capacity, does not matter."""
    for reading in vector["readings"]:
        view = layout.view(bytes.fromhex(reading["record"]))
        for name, expected in reading["reads"].items():
            assert getattr(view, name) == expected, reading["what"]


def contains(whole: Any, part: Any) -> bool:
    """Whether ``whole`` has every field of ``part``, nested, with equal values."""
    if isinstance(part, dict):
        return all(name in whole and contains(whole[name], item) for name, item in part.items())
    if isinstance(part, list):
        return len(whole) == len(part) and all(map(contains, whole, part))
    return bool(whole == part and type(whole) is type(part))
