"""All bundled types against a real rclpy on rmw_fastrtps: the same hashes, and the same values both ways."""

from __future__ import annotations

import json
import random
import sys
from functools import cache
from itertools import groupby
from pathlib import Path

import pytest

from rosplc.codec import Codec, Wire
from rosplc.layout import Limits, compute_layout
from rosplc.model import TypeStore
from rosplc.ros import Backend, Qos
from tests.codec_oracle import Oracle, random_value
from tests.interop.ros2.conftest import Peer
from tests.lib.waiting import repeat_until, wait_for

pytestmark = [pytest.mark.ros2, pytest.mark.timeout(300), pytest.mark.verifies("ros2-types", real="rclpy")]

STORE = TypeStore.bundled("kilted")
SHARE = Path(sys.prefix, "share")
WITHOUT_WHEEL = {
    "example_interfaces", "map_msgs", "pcl_msgs", "pendulum_msgs", "rosbag2_interfaces", "statistics_msgs",
    "tf2_msgs", "turtlesim", "turtlesim_msgs",
}  # fmt: skip
INSTALLED = [name for name in sorted(STORE.names()) if name.split("/")[0] not in WITHOUT_WHEEL]
PACKAGES = {
    package: list(names) for package, names in groupby(INSTALLED, key=lambda name: name.split("/")[0])
}
ORACLE = Oracle(STORE, 12, 3)


@cache
def codec(name: str) -> Codec:
    """Return the codec of a type with the oracle's capacities."""
    return Codec(compute_layout(STORE, name, Limits(12, 3)), Wire.CDR)


def test_hashes() -> None:
    """The hash of every type is the one that ROS 2's own generators have written."""
    assert len(INSTALLED) > 100
    for name in INSTALLED:
        described = json.loads((SHARE / f"{name}.json").read_text())["type_hashes"]
        assert [one["hash_string"] for one in described if one["type_name"] == name] == [
            STORE.type_hash(name)
        ]


def test_hashes_of_services_and_actions() -> None:
    """So are those of every service and action, of their messages, and of what ROS 2 derives from them."""
    store = STORE.with_paths([SHARE / "test_msgs"])
    names = [
        name for name in (*store.services(), *store.actions()) if name.split("/")[0] not in WITHOUT_WHEEL
    ]
    assert {f"{name}.json" for name in names} == {
        str(file.relative_to(SHARE)) for kind in ("srv", "action") for file in SHARE.glob(f"*/{kind}/*.json")
    }
    for name in names:
        for described in json.loads((SHARE / f"{name}.json").read_text())["type_hashes"]:
            part = described["type_name"]
            if part in store:
                ours = store.type_hash(part)
            else:
                ours = store.action_hash(part) if part in store.actions() else store.service_hash(part)
            assert (part, ours) == (part, described["hash_string"])


@pytest.mark.parametrize("package", PACKAGES)
def test_values(node: Backend, peer: Peer, package: str) -> None:
    """Random values of each type of a package become objects of a real rclpy, and come back from it."""
    names = PACKAGES[package]
    got: dict[str, list[bytes]] = {name: [] for name in names}
    for name in names:
        there, back = f"/there/{name.replace('/msg/', '/')}", f"/back/{name.replace('/msg/', '/')}"
        outbox = node.advertise(there, name, Qos())
        inbox = node.subscribe(back, name, Qos(), lambda data, _, name=name: got[name].append(data))
        peer.echo(there, back, name)
        wait_for(
            lambda a=outbox, b=inbox: a.status().matched == b.status().matched == 1, f"a match for {name}"
        )
        value = random_value(ORACLE, name, random.Random(name))
        payload = ORACLE.cdr(name, value)
        # Its subscription may not have matched yet.
        repeat_until(lambda o=outbox, p=payload: o.write(p), lambda name=name: got[name], name, every=0.5)
        assert {codec(name).decode(data) for data in got[name]} == {ORACLE.record(name, value)}
    reasons = {status.topic: (status.code, status.reason) for status in node.status()}
    assert set(reasons.values()) == {("", "")}, reasons
