"""A peer on zenoh-ros2-sdk: ``sdk_peer.py PORT DOMAIN``, told by lines of JSON what to do.

Nothing of the project is imported. It takes ``subscribe`` or ``advertise`` (a topic, with ``type``,
``definition`` and ``qos``), ``publish`` (a topic, with ``messages``: each its fields), ``serve`` or ``call``
(a service, with ``type`` and ``definitions``; a call with ``fields``, and perhaps its type's ``hash`` and the
types of ``nested`` fields; what a server answers is TRUE and the request's text). It prints
``{"ready": topic}`` and ``{"heard": topic, "message": fields}``.
"""

from __future__ import annotations

import json
import sys
import threading
import time
from typing import Any

import numpy as np
from zenoh_ros2_sdk import ROS2Publisher, ROS2ServiceClient, ROS2ServiceServer, ROS2Subscriber
from zenoh_ros2_sdk.session import ZenohSession

ARRAYS = {
    "values": np.float64,
    "flags": np.bool_,
    "raw": np.uint8,
    "byte_array_value": np.uint8,
    "bool_array_value": np.bool_,
    "integer_array_value": np.int64,
    "double_array_value": np.float64,
}
"""Fields that are arrays → what they are arrays of."""

PORT, DOMAIN = int(sys.argv[1]), int(sys.argv[2])
_writing = threading.Lock()
_endpoints: dict[str, Any] = {}


def say(**words: object) -> None:
    """Print one line whole, from whatever thread."""
    with _writing:
        sys.stdout.write(json.dumps(words) + "\n")
        sys.stdout.flush()


def plain(value: Any) -> Any:
    """Return a message or a field of one as JSON has it."""
    if hasattr(value, "tolist"):
        return value.tolist()
    if isinstance(value, list | tuple):
        return [plain(one) for one in value]
    if hasattr(value, "__dataclass_fields__"):
        return {name: plain(getattr(value, name)) for name in value.__dataclass_fields__ if name[0] != "_"}
    return value


def given(fields: dict[str, Any], nested: dict[str, str] | None = None) -> dict[str, Any]:
    """Return a message's fields as the SDK takes them; ``nested`` names the types of messages in it."""
    nested = nested or {}

    def made(name: str, value: Any) -> Any:
        if isinstance(value, dict):
            return ZenohSession.get_instance().store.types[nested[name]](**given(value, nested))
        if name in nested:
            return [made(name, one) for one in value]
        return np.array(value, ARRAYS[name]) if name in ARRAYS else value

    return {name: made(name, value) for name, value in fields.items()}


def obey(order: dict[str, Any]) -> None:
    """Carry out one line."""
    place = {"domain_id": DOMAIN, "router_port": PORT}
    common = {"msg_definition": order.get("definition"), "qos": order.get("qos") or None, **place}
    if topic := order.get("subscribe"):
        heard = lambda message: say(heard=topic, message=plain(message))  # noqa: E731
        _endpoints[f"in {topic}"] = ROS2Subscriber(topic, order["type"], callback=heard, **common)
        say(ready=topic)
    elif topic := order.get("advertise"):
        _endpoints[topic] = ROS2Publisher(topic, order["type"], **common)
        say(ready=topic)
    elif service := order.get("serve"):

        def answer(request: Any) -> Any:
            say(heard=service, message=plain(request))
            return server.response_msg_class(success=True, message=request.load_namespace)

        server = ROS2ServiceServer(service, order["type"], answer, *order["definitions"], **place)
        _endpoints[f"serve {service}"] = server
        say(ready=service)
    elif service := order.get("call"):
        if service not in _endpoints:
            kind = {"type_hash": order.get("hash"), **place}
            _endpoints[service] = ROS2ServiceClient(service, order["type"], *order["definitions"], **kind)
        _endpoints[service].call_async(
            lambda response: say(heard=service, message=plain(response)),
            **given(order["fields"], order.get("nested")),
        )
    elif topic := order.get("publish"):
        # As a ROS node waits for subscribers: what is put before one is known goes nowhere.
        while order.get("wait") and not _endpoints[topic].pub.matching_status.matching:
            time.sleep(0.005)
        for fields in order["messages"]:
            _endpoints[topic].publish(**given(fields))


def main() -> None:
    """Obey until standard input ends."""
    for line in sys.stdin:
        obey(json.loads(line))
    for endpoint in _endpoints.values():
        endpoint.close()


if __name__ == "__main__":
    main()
