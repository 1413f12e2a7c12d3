"""The peer of ``fibonacci.py`` on Cyclone DDS, as rmw_cyclonedds does: ``cyclone_peer.py DOMAIN``."""

from __future__ import annotations

import os
import sys
import threading
import time
from collections.abc import Callable
from functools import partial
from typing import Any

from cyclonedds.idl.types import array, int8, int32, sequence, uint8, uint32

from tests.interop.actions.fibonacci import Answer, run
from tests.interop.rmw_cyclone import HEADER, RmwClient, RmwNode, RmwServer, message_class, taken

UUID = message_class("unique_identifier_msgs/msg/UUID", uuid=array[uint8, 16])
TIME = message_class("builtin_interfaces/msg/Time", sec=int32, nanosec=uint32)
GOAL_INFO = message_class("action_msgs/msg/GoalInfo", goal_id=UUID, stamp=TIME)
GOAL_STATUS = message_class("action_msgs/msg/GoalStatus", goal_info=GOAL_INFO, status=int8)
GOAL = message_class("test_msgs/action/Fibonacci_Goal", order=int32)
RESULT = message_class("test_msgs/action/Fibonacci_Result", sequence=sequence[int32])
FEEDBACK = message_class("test_msgs/action/Fibonacci_Feedback", sequence=sequence[int32])
TYPES = {
    "unique_identifier_msgs/msg/UUID": UUID,
    "builtin_interfaces/msg/Time": TIME,
    "action_msgs/msg/GoalInfo": GOAL_INFO,
    "action_msgs/msg/GoalStatus": GOAL_STATUS,
    "test_msgs/action/Fibonacci_Goal": GOAL,
    "test_msgs/action/Fibonacci_Result": RESULT,
    "test_msgs/action/Fibonacci_Feedback": FEEDBACK,
    "test_msgs/action/Fibonacci_FeedbackMessage": message_class(
        "test_msgs/action/Fibonacci_FeedbackMessage", goal_id=UUID, feedback=FEEDBACK
    ),
    "action_msgs/msg/GoalStatusArray": message_class(
        "action_msgs/msg/GoalStatusArray", status_list=sequence[GOAL_STATUS]
    ),
}


def service(type_name: str, request: dict[str, Any], response: dict[str, Any]) -> tuple[Any, Any]:
    """Return the classes of a service's two messages, with the header before their fields."""
    parts = (("Request", request), ("Response", response))
    made = [message_class(f"{type_name}_{part}", **HEADER, **fields) for part, fields in parts]
    return made[0], made[1]


SERVICES = {
    "test_msgs/action/Fibonacci_SendGoal": service(
        "test_msgs/action/Fibonacci_SendGoal",
        {"goal_id": UUID, "goal": GOAL},
        {"accepted": bool, "stamp": TIME},
    ),
    "test_msgs/action/Fibonacci_GetResult": service(
        "test_msgs/action/Fibonacci_GetResult", {"goal_id": UUID}, {"status": int8, "result": RESULT}
    ),
    "action_msgs/srv/CancelGoal": service(
        "action_msgs/srv/CancelGoal",
        {"goal_info": GOAL_INFO},
        {"return_code": int8, "goals_canceling": sequence[GOAL_INFO]},
    ),
}


class Calling:
    """A client, and what waits for responses."""

    def __init__(self, node: RmwNode, name: str, type_name: str) -> None:
        self._client = RmwClient(node, name, SERVICES[type_name])
        self._lock = threading.Lock()
        self._waiting: dict[int, Callable[[Any], object]] = {}
        self.available = self._client.available

    def call(self, on_response: Callable[[Any], object], **fields: Any) -> None:
        """Send a request; its fields are in order."""
        with self._lock:
            self._waiting[self._client.send(*fields.values())] = on_response

    def look(self) -> None:
        """Hand over what has come."""
        for response in self._client.take():
            with self._lock:
                on_response = self._waiting.pop(response.rmw_call_number)
            on_response(response)


class Node:
    """A node whose one thread looks at all readers."""

    def __init__(self, domain: int) -> None:
        self._node = RmwNode(domain)
        self._looks: list[Callable[[], object]] = []
        threading.Thread(target=self._run, daemon=True).start()

    def _run(self) -> None:
        while True:
            for look in tuple(self._looks):
                look()
            time.sleep(0.002)

    def make(self, type_name: str, **fields: Any) -> Any:
        """Return a message."""
        return TYPES[type_name](**fields)

    def advertise(self, topic: str, type_name: str, *, latched: bool = False) -> Callable[..., object]:
        """Send a topic; return what sends a message of these fields."""
        qos = self._node.latched() if latched else self._node.ids()
        writer = self._node.writer(f"rt{topic}", TYPES[type_name], qos)
        return lambda **fields: writer.write(TYPES[type_name](**fields))

    def subscribe(self, topic: str, type_name: str, hear: Callable[[Any], object]) -> None:
        """Receive a topic."""
        reader = self._node.reader(f"rt{topic}", TYPES[type_name], self._node.ids())
        self._looks.append(lambda: [hear(message) for message in taken(reader)])

    def serve(self, name: str, type_name: str, receive: Callable[[Any, Answer], object]) -> None:
        """Serve a service, whose answers may come later."""
        server = RmwServer(self._node, name, SERVICES[type_name])

        def answer(request: Any, **fields: Any) -> None:
            server.answer(request, *fields.values())

        self._looks.append(lambda: [receive(one, partial(answer, one)) for one in server.take()])

    def client(self, name: str, type_name: str) -> Calling:
        """Call a service."""
        client = Calling(self._node, name, type_name)
        self._looks.append(client.look)
        return client


if __name__ == "__main__":
    run(Node(int(sys.argv[1])))
    os._exit(0)  # threads of the library may be in the middle of something
