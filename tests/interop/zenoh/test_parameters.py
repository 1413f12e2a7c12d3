"""Parameters of the PLC (executed Structured Text) over Zenoh, seen and set by zenoh-ros2-sdk."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

pytest.importorskip("zenoh")
pytest.importorskip("zenoh_ros2_sdk")

from rosplc.ros import Qos
from tests.interop.zenoh.sdk import SdkPeer
from tests.verification.joint import Joint, made_joint, ros_side
from tests.verification.plc_cell import store
from tests.verification.test_parameters_bridge import CONFIG, INITIAL, KIND, wishes

pytestmark = [
    pytest.mark.foreign,
    pytest.mark.timeout(300),
    pytest.mark.verifies("parameters", real="zenoh-ros2-sdk"),
]

DOMAIN = 24
# As rosidl's own generators have written them into the packages.
HASHES = {
    "GetParameters": "RIHS01_bf9803d5c74cf989a5de3e0c2e99444599a627c7ff75f97b8c05b01003675cbc",
    "SetParametersAtomically": "RIHS01_0e192ef259c07fc3c07a13191d27002222e65e00ccec653ca05e856f79285fcd",
}
NESTED = {"parameters": "rcl_interfaces/msg/Parameter", "value": "rcl_interfaces/msg/ParameterValue"}
EMPTY = {
    "type": 0, "bool_value": False, "integer_value": 0, "double_value": 0.0, "string_value": "",
    "byte_array_value": [], "bool_array_value": [], "integer_array_value": [], "double_array_value": [],
    "string_array_value": [],
}  # fmt: skip


class Sdk:
    """The SDK as a client of the bridge's parameters."""

    def __init__(self, joint: Joint, peer: SdkPeer) -> None:
        self.joint, self.peer = joint, peer

    def ask(self, service: str, **request: Any) -> dict[str, Any]:
        kind = f"rcl_interfaces/srv/{service}"
        texts = [store().definition_text(f"{kind}_{part}") for part in ("Request", "Response")]
        name = {"GetParameters": "get_parameters"}.get(service, "set_parameters_atomically")
        more = {"hash": HASHES[service], "nested": NESTED}
        inbox = self.peer.ask(f"/rosplc_params/{name}", kind, texts, request, **more)
        known = len(inbox.messages)
        self.joint.until(lambda: len(inbox.messages) > known, f"the answer of {service}")
        return inbox.messages[known]

    def values(self) -> dict[str, Any]:
        values = self.ask("GetParameters", names=list(INITIAL))["values"]
        return {name: each[f"{KIND[name]}_value"] for name, each in zip(INITIAL, values, strict=True)}

    def set(self, **values: Any) -> dict[str, Any]:
        asked = [{**each, "value": EMPTY | each["value"]} for each in wishes(values)]
        result: dict[str, Any] = self.ask("SetParametersAtomically", parameters=asked)["result"]
        return result


@pytest.fixture
def sdk() -> Iterator[Sdk]:
    with ros_side("zenoh", DOMAIN) as (side, options):
        config = CONFIG.replace("backend: memory, domain: 57", side)
        port = int(options["connect"][0].rpartition(":")[2])
        with (
            made_joint(config, "ROS_Parameters", DOMAIN, "zenoh", options=options) as joint,
            SdkPeer(port, DOMAIN) as peer,
        ):
            client = joint.peer.client(
                "/rosplc_params/list_parameters", "rcl_interfaces/srv/ListParameters", Qos(depth=1000)
            )
            joint.until(lambda: client.ready and joint.get("block", "xValid"), "bridge and PLC")
            yield Sdk(joint, peer)


def test_the_sdk_gets_and_sets(sdk: Sdk) -> None:
    """All nine kinds are read; an atomic set is in the program when it is confirmed; refusals have words."""
    first = INITIAL | {"arm.raw": [1, -1]}  # the SDK takes a byte for a signed one
    assert sdk.values() == first
    arm = {"arm.on": True, "arm.gains": [3.0], "arm.names": ["c"]}
    assert sdk.set(count=-4, **arm) == {"successful": True, "reason": ""}
    held = [sdk.joint.machine.get(f"ROS_Parameters.values.{name}") for name in ("count", "arm_gains[0]")]
    assert held == [-4, 3.0]
    assert sdk.values() == first | {"count": -4} | arm
    assert sdk.set(max_speed=9.0) == {
        "successful": False, "reason": "max_speed must be within 0.0 … 2.0"
    }  # fmt: skip
    sdk.joint.scan = lambda *_, **__: None  # type: ignore[method-assign]
    sdk.joint.until(
        lambda: sdk.set(count=8) == {"successful": False, "reason": "PLC is not running"}, "the refusal"
    )
    assert sdk.values() == first | {"count": -4} | arm
