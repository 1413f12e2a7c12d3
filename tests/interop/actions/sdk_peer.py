"""The peer of ``fibonacci.py`` on zenoh-ros2-sdk's services and topics: ``sdk_peer.py PORT DOMAIN``."""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from zenoh_ros2_sdk import ROS2Publisher, ROS2ServiceClient, ROS2ServiceServer, ROS2Subscriber
from zenoh_ros2_sdk.session import ZenohSession

from tests.interop.actions.fibonacci import Answer, run

PLACE = {"domain_id": int(sys.argv[2]), "router_port": int(sys.argv[1])}
LATCHED = ":1:,1:,:,:,,"
ARRAYS = {"uuid": np.uint8, "sequence": np.int32}

NESTED = {
    "unique_identifier_msgs/msg/UUID": "uint8[16] uuid\n",
    "builtin_interfaces/msg/Time": "int32 sec\nuint32 nanosec\n",
    "action_msgs/msg/GoalInfo": "unique_identifier_msgs/UUID goal_id\nbuiltin_interfaces/Time stamp\n",
    "action_msgs/msg/GoalStatus": "action_msgs/GoalInfo goal_info\nint8 status\n",
    "test_msgs/action/Fibonacci_Goal": "int32 order\n",
    "test_msgs/action/Fibonacci_Result": "int32[] sequence\n",
    "test_msgs/action/Fibonacci_Feedback": "int32[] sequence\n",
}
PARTS = {
    "test_msgs/action/Fibonacci_SendGoal": (
        "unique_identifier_msgs/UUID goal_id\ntest_msgs/action/Fibonacci_Goal goal\n",
        "bool accepted\nbuiltin_interfaces/Time stamp\n",
    ),
    "test_msgs/action/Fibonacci_GetResult": (
        "unique_identifier_msgs/UUID goal_id\n",
        "int8 status\ntest_msgs/action/Fibonacci_Result result\n",
    ),
    "action_msgs/srv/CancelGoal": (
        "action_msgs/GoalInfo goal_info\n",
        "int8 return_code\naction_msgs/GoalInfo[] goals_canceling\n",
    ),
    "test_msgs/action/Fibonacci_FeedbackMessage": (
        "unique_identifier_msgs/UUID goal_id\ntest_msgs/action/Fibonacci_Feedback feedback\n",
    ),
    "action_msgs/msg/GoalStatusArray": ("action_msgs/GoalStatus[] status_list\n",),
}
# As rosidl's own generators have written them into Kilted's packages.
HASHES = {
    "test_msgs/action/Fibonacci_SendGoal": (
        "RIHS01_d807633803e38e164276573cd97e9fbd71e109c290bbf4cc312a0a1c9da7bbd9"
    ),
    "test_msgs/action/Fibonacci_GetResult": (
        "RIHS01_5d30fdeb21d20e117aa5f36c7b4f0b6874f1a8cf7a9c038d58f1156c5737b209"
    ),
    "action_msgs/srv/CancelGoal": "RIHS01_573d8b0a534451d7bc2ac8c5ffde8ac14b8593b7001175d0cd6516dcbeb8689a",
    "test_msgs/action/Fibonacci_FeedbackMessage": (
        "RIHS01_37487bae8cea358366b97003c1ef1ca7ce7c08df36f9e8cca496624226aee64e"
    ),
    "action_msgs/msg/GoalStatusArray": (
        "RIHS01_6c1684b00f177d37438febe6e709fc4e2b0d4248dca4854946f9ed8b30cda83e"
    ),
}


def definitions(type_name: str) -> list[str]:
    """Return the definitions of a topic's message, or of a service's two, with those that they contain."""
    others = "".join(f"{'=' * 80}\nMSG: {name}\n{text}" for name, text in NESTED.items())
    return [part + others for part in PARTS[type_name]]


class SdkClient:
    """A client of a service."""

    def __init__(self, service: str, type_name: str) -> None:
        # Its time-out is for a result, too.
        self._client = ROS2ServiceClient(
            service, type_name, *definitions(type_name), type_hash=HASHES[type_name], timeout=600.0, **PLACE
        )

    def available(self) -> bool:
        """Return whether requests reach a server."""
        return bool(self._client.querier.matching_status.matching)

    def call(self, on_response: Callable[[Any], object], **fields: Any) -> None:
        """Send a request; the SDK gives None for one that failed."""
        self._client.call_async(lambda response: response and on_response(response), **fields)


class SdkNode:
    """A node on the SDK."""

    def __init__(self) -> None:
        self._kept: list[Any] = []

    def make(self, type_name: str, **fields: Any) -> Any:
        """Return a message."""
        types = ZenohSession.get_instance().store.types
        return types[type_name](
            **{k: np.array(v, ARRAYS[k]) if k in ARRAYS else v for k, v in fields.items()}
        )

    def advertise(self, topic: str, type_name: str, *, latched: bool = False) -> Callable[..., object]:
        """Send a topic; return what sends a message of these fields."""
        (text,), qos = definitions(type_name), LATCHED if latched else None
        publisher = ROS2Publisher(topic, type_name, text, type_hash=HASHES[type_name], qos=qos, **PLACE)
        self._kept.append(publisher)
        return publisher.publish

    def subscribe(self, topic: str, type_name: str, hear: Callable[[Any], object]) -> None:
        """Receive a topic."""
        (text,) = definitions(type_name)
        how = {"msg_definition": text, "type_hash": HASHES[type_name], **PLACE}
        self._kept.append(ROS2Subscriber(topic, type_name, callback=hear, **how))

    def serve(self, service: str, type_name: str, receive: Callable[[Any, Answer], object]) -> None:
        """Serve a service, whose answers may come later."""
        how = {"type_hash": HASHES[type_name], "mode": "queue", **PLACE}
        server = ROS2ServiceServer(service, type_name, None, *definitions(type_name), **how)

        def answer(key: Any, **fields: Any) -> None:
            server.send_response(key, server.response_msg_class(**fields))

        def take() -> None:
            while True:
                key, request = server.take_request()
                receive(request, partial(answer, key))

        threading.Thread(target=take, daemon=True).start()

    def client(self, service: str, type_name: str) -> SdkClient:
        """Call a service."""
        return SdkClient(service, type_name)


if __name__ == "__main__":
    run(SdkNode())
    os._exit(0)  # threads of the library may be in the middle of something
