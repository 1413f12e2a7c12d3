"""What a bridge receives of transforms, over every backend of ``test_backends.py``."""

from __future__ import annotations

import importlib.util
from typing import Any

import pytest

from rosplc.bridge.port import Context
from rosplc.bridge.transforms import Transforms
from rosplc.codec import Codec
from rosplc.config.transforms import TF_MESSAGE, TransformError
from rosplc.layout import compute_layout
from rosplc.model import TypeStore
from rosplc.ros import Qos
from rosplc.shm import Namespace
from tests.conformance.backends.base import Harness
from tests.conformance.test_backends import graph, over
from tests.lib.waiting import repeat_until, wait_for

__all__ = ["graph"]  # the fixture

pytestmark = [pytest.mark.timeout(120), pytest.mark.verifies("tf", own="tests over every backend")]

TF2_MSGS = importlib.util.find_spec("tf2_msgs") is not None  # no wheel has it
LATCHED = Qos(durability="transient_local", depth=1)


@over(lambda harness: not harness.real or TF2_MSGS)
def test_static_transforms_of_several_nodes_from_before(graph: Harness, shm_namespace: Namespace) -> None:
    """Each node's last message is received by a bridge that comes later, and moving ones from then on."""
    store = TypeStore.bundled(graph.opening("any").distro)
    codec = Codec(compute_layout(store, TF_MESSAGE))

    def message(child: str, parent: str, seconds: int) -> bytes:
        transform = {"translation": {"x": 1.0}, "rotation": {"w": 1.0}}
        header = {"frame_id": parent, "stamp": {"sec": seconds}}
        link = {"header": header, "child_frame_id": child, "transform": transform}
        return codec.encode(codec.layout.pack({"transforms": [link]}))

    for number, (child, parent) in enumerate((("tool", "flange"), ("flange", "wrist"), ("base", "map"))):
        outbox = graph.node(f"static{number}").advertise("/tf_static", TF_MESSAGE, LATCHED)
        outbox.write(message(child, parent, 5))
    moving: Any = graph.node("robot").advertise("/tf", TF_MESSAGE, Qos())
    node = graph.node_class(graph.opening("bridge"))
    transforms = Transforms(Context(shm_namespace, "bridge", bytes(16), store.distro))
    try:
        transforms.join(node, node.backend, codec)
        wait_for(lambda: transforms.buffer.lookup("wrist", "tool").error == TransformError.NONE)
        wait_for(lambda: transforms.buffer.lookup("map", "base").static)
        assert transforms.buffer.lookup("map", "tool").error == TransformError.NOT_CONNECTED
        repeat_until(
            lambda: moving.write(message("wrist", "base", 7)),
            lambda: transforms.buffer.lookup("map", "tool").error == TransformError.NONE,
        )
        found = transforms.buffer.lookup("map", "tool")
        assert (found.stamp_ns, found.frame, found.static, found.pose[0]) == (7 * 10**9, "wrist", False, 4.0)
        status = wait_for(transforms.status)
        assert (status.topic, status.matched) == ("/tf", 4)
        transforms.leave(node)
        assert transforms.status() is None
    finally:
        node.end()
