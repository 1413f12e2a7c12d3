"""Types that the bridge's side lacks, learnt from a real rclpy node."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

from rosplc.errors import MessageTypeError
from rosplc.init.learn import Definitions, learn
from rosplc.model import TypeStore
from rosplc.model.folders import save_definitions
from rosplc.ros import open_backend, settled_graph
from tests.interop.graphs import LOCAL
from tests.interop.ros2.conftest import Peer

pytestmark = [pytest.mark.ros2, pytest.mark.timeout(300), pytest.mark.verifies("learn", real="rclpy")]

SHARE = Path(sys.prefix, "share")


def real() -> TypeStore:
    """Return the types with those of the package's own files, which only ROS's environment has."""
    return TypeStore.bundled("kilted").with_paths([SHARE / "test_msgs"])


def learnt(domain: int, peer: Peer, name: str, backend: str = "rclpy") -> Definitions:
    """Have the peer publish a type, and learn it from the peer."""
    peer.advertise("/custom", name)
    definitions = Definitions("kilted", environment={})
    opened = open_backend(backend, definitions.store, "cell", domain=domain, environment=LOCAL)
    try:
        assert "/custom" in settled_graph(opened.graph, 60.0, ["/custom"]).topics
        learn(definitions, opened, "/custom", name)
    finally:
        opened.close()
    return definitions


@pytest.mark.parametrize("base", ["Constants", "Defaults", "Empty", "MultiNested"])
def test_over_rclpy(domain: int, peer: Peer, base: str, tmp_path: Path) -> None:
    """With constants and default values, and what is saved is read as the package's own files are."""
    name = f"test_msgs/msg/{base}"
    assert name not in TypeStore.bundled("kilted")
    definitions = learnt(domain, peer, name)
    assert {*definitions.origins.values()} == {"node /peer"}
    save_definitions(definitions.texts, tmp_path)
    saved = TypeStore.bundled("kilted").with_paths([tmp_path])
    own = real()
    assert [saved[each] for each in saved.dependencies(name)] == [
        own[each] for each in own.dependencies(name)
    ]


@pytest.mark.parametrize("base", ["ComplexNestedKey", "Strings"])
def test_a_source_that_cannot_be_used(domain: int, peer: Peer, base: str) -> None:
    """IDL, and quotes that ROS's generator mangles: the fields count, the origin says what is missing."""
    name = f"test_msgs/msg/{base}"
    definitions = learnt(domain, peer, name)
    described = json.loads((SHARE / f"{name}.json").read_text())["type_description_msg"]["type_description"]
    fields = [field.name for field in definitions.store[name].fields]
    assert fields == [field["name"] for field in described["fields"]]
    assert definitions.origins[name] == (
        "node /peer, without constants and default values: the source text cannot be used"
    )


def test_fast_dds_cannot_be_asked_over_dds(domain: int, peer: Peer) -> None:
    """The error gives the reason and the remedy."""
    reason = "a DDS implementation whose service calls are incompatible with Cyclone DDS"
    with pytest.raises(MessageTypeError, match=reason) as refused:
        learnt(domain, peer, "test_msgs/msg/Constants", "dds")
    assert refused.value.code == "TYP001"
    assert "--types" in refused.value.remedy
