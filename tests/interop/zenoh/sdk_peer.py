"""A peer on zenoh-ros2-sdk: ``sdk_peer.py PORT DOMAIN pub|sub TOPIC TYPE DEFINITION QOS [VALUES]``.

Nothing of the project is imported. Definition and values are JSON: a list of messages, each with
its fields. A publisher sends what standard input tells, ``go`` for all of them; a subscriber
prints each message as a line of JSON.
"""

from __future__ import annotations

import json
import sys
from typing import Any

import numpy as np
from zenoh_ros2_sdk import ROS2Publisher, ROS2Subscriber

ARRAYS = {"values": np.float64, "flags": np.bool_, "raw": np.uint8}
"""Fields that are arrays → what they are arrays of."""


def plain(value: Any) -> Any:
    """Return a message's field as JSON has it."""
    if hasattr(value, "tolist"):
        return value.tolist()
    if isinstance(value, list | tuple):
        return [plain(one) for one in value]
    return value


def main() -> None:
    """Do what the arguments say until standard input ends."""
    port, domain, role, topic, kind, definition, qos, *values = sys.argv[1:]
    common: dict[str, Any] = {
        "msg_definition": definition,
        "domain_id": int(domain),
        "router_port": int(port),
        "qos": qos or None,
    }
    if role == "pub":
        publisher = ROS2Publisher(topic, kind, **common)
        print("ready", flush=True)
        for _ in sys.stdin:
            for fields in json.loads(values[0]):
                publisher.publish(
                    **{k: np.array(v, ARRAYS[k]) if k in ARRAYS else v for k, v in fields.items()}
                )
        publisher.close()
    else:
        names = json.loads(values[0])

        def show(message: Any) -> None:
            print(json.dumps({name: plain(getattr(message, name)) for name in names}), flush=True)

        subscriber = ROS2Subscriber(topic, kind, callback=show, **common)
        print("ready", flush=True)
        sys.stdin.read()
        subscriber.close()


if __name__ == "__main__":
    main()
