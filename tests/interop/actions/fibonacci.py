"""An action server and client of ``test_msgs/action/Fibonacci``, by rcl_action's rules.

No code of rosplc is in it. ``sdk_peer.py`` and ``cyclone_peer.py`` give it a node with services and
topics. They read and print the same lines of JSON as ``ros2/action_peer.py``, which does the same with rclpy.
"""

from __future__ import annotations

import json
import sys
import threading
import time
import uuid
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Protocol

ACCEPTED, EXECUTING, CANCELING, SUCCEEDED, CANCELED, ABORTED = range(1, 7)
NONE, REJECTED, UNKNOWN_GOAL_ID, GOAL_TERMINATED = range(4)
SEND, GET, CANCEL = (
    ("send_goal", "test_msgs/action/Fibonacci_SendGoal"),
    ("get_result", "test_msgs/action/Fibonacci_GetResult"),
    ("cancel_goal", "action_msgs/srv/CancelGoal"),
)
FEEDBACK = ("feedback", "test_msgs/action/Fibonacci_FeedbackMessage")
STATUS = ("status", "action_msgs/msg/GoalStatusArray")

_writing = threading.Lock()
Answer = Callable[..., object]


class Calling(Protocol):
    """A client of a service."""

    def available(self) -> bool:
        """Return whether a server is known."""

    def call(self, on_response: Callable[[Any], object], **fields: Any) -> None:
        """Send a request."""


class Node(Protocol):
    """What a middleware does; ``make`` returns a message, named in full, with these fields."""

    def make(self, type_name: str, **fields: Any) -> Any: ...
    def advertise(self, topic: str, type_name: str, *, latched: bool = False) -> Callable[..., object]: ...
    def subscribe(self, topic: str, type_name: str, hear: Callable[[Any], object]) -> None: ...
    def serve(self, service: str, type_name: str, receive: Callable[[Any, Answer], object]) -> None: ...
    def client(self, service: str, type_name: str) -> Calling: ...


def say(**words: object) -> None:
    """Print one line whole, from whatever thread."""
    with _writing:
        print(json.dumps(words), flush=True)


def place(action: str, part: tuple[str, str]) -> tuple[str, str]:
    """Return name and type of a topic or service of an action."""
    return f"{action}/_action/{part[0]}", part[1]


def numbers(values: Any) -> list[int]:
    """Return a sequence as JSON has it."""
    return [int(value) for value in values]


@dataclass
class Goal:
    """A goal that the server has accepted."""

    info: Any
    order: int
    status: int = ACCEPTED
    sequence: list[int] = field(default_factory=list)
    waiting: list[Answer] = field(default_factory=list)


class Server:
    """It rejects orders below 0, and refuses to cancel 77; from 50 on a goal never ends by itself."""

    def __init__(self, node: Node, action: str) -> None:
        self._node, self._lock = node, threading.RLock()
        self._goals: dict[bytes, Goal] = {}
        self._feed = node.advertise(*place(action, FEEDBACK))
        self._statuses = node.advertise(*place(action, STATUS), latched=True)
        for part, receive in ((SEND, self._decide), (CANCEL, self._agree), (GET, self._wait)):
            node.serve(*place(action, part), receive)

    def _set(self, goal: Goal, status: int) -> None:
        goal.status = status
        make = self._node.make
        self._statuses(
            status_list=[
                make("action_msgs/msg/GoalStatus", goal_info=each.info, status=each.status)
                for each in self._goals.values()
            ]
        )

    def _decide(self, request: Any, answer: Answer) -> None:
        order, key = int(request.goal.order), bytes(request.goal_id.uuid)
        seconds, nanoseconds = divmod(time.time_ns(), 10**9)
        stamp = self._node.make("builtin_interfaces/msg/Time", sec=seconds, nanosec=nanoseconds)
        with self._lock:
            accepted = order >= 0 and key not in self._goals
            if accepted:
                info = self._node.make("action_msgs/msg/GoalInfo", goal_id=request.goal_id, stamp=stamp)
                goal = self._goals[key] = Goal(info, order)
            answer(accepted=accepted, stamp=stamp)
            if accepted:
                self._set(goal, EXECUTING)
                threading.Thread(target=self._execute, args=[goal], daemon=True).start()

    def _execute(self, goal: Goal) -> None:
        say(goal=goal.order, began=True)
        while goal.status == EXECUTING and (len(goal.sequence) < goal.order or goal.order >= 50):
            with self._lock:
                goal.sequence.append(len(goal.sequence))
                feedback = self._node.make("test_msgs/action/Fibonacci_Feedback", sequence=goal.sequence)
                self._feed(goal_id=goal.info.goal_id, feedback=feedback)
            time.sleep(0.02)
        with self._lock:
            canceled = goal.status == CANCELING
            self._set(goal, CANCELED if canceled else ABORTED if goal.order % 2 else SUCCEEDED)
            if canceled:
                say(goal=goal.order, canceled=True)
            for answer in goal.waiting:
                self._tell(goal, answer)

    def _tell(self, goal: Goal | None, answer: Answer) -> None:
        status, sequence = (0, []) if goal is None else (goal.status, goal.sequence)
        answer(status=status, result=self._node.make("test_msgs/action/Fibonacci_Result", sequence=sequence))

    def _wait(self, request: Any, answer: Answer) -> None:
        with self._lock:
            goal = self._goals.get(bytes(request.goal_id.uuid))
            if goal is not None and goal.status < SUCCEEDED:
                goal.waiting.append(answer)
            else:
                self._tell(goal, answer)

    def _agree(self, request: Any, answer: Answer) -> None:
        with self._lock:
            goal = self._goals.get(bytes(request.goal_info.goal_id.uuid))
            if goal is None:
                code = UNKNOWN_GOAL_ID
            elif goal.status != EXECUTING:
                code = GOAL_TERMINATED
            else:
                code = REJECTED if goal.order == 77 else NONE
            answer(return_code=code, goals_canceling=[goal.info] if goal is not None and code == NONE else [])
            if goal is not None and code == NONE:
                self._set(goal, CANCELING)


class Client:
    """It waits for a server before it sends a goal, and asks for the result once that is accepted."""

    def __init__(self, node: Node, action: str) -> None:
        self._node = node
        self._orders: dict[bytes, int] = {}
        node.subscribe(*place(action, FEEDBACK), self._hear)
        node.subscribe(*place(action, STATUS), lambda _: None)
        self._send, self._get, self._cancel = (
            node.client(*place(action, part)) for part in (SEND, GET, CANCEL)
        )

    def _id(self, key: bytes) -> Any:
        return self._node.make("unique_identifier_msgs/msg/UUID", uuid=list(key))

    def _hear(self, message: Any) -> None:
        if (order := self._orders.get(bytes(message.goal_id.uuid))) is not None:
            say(goal=order, feedback=numbers(message.feedback.sequence))

    def send(self, order: int) -> None:
        """Send a goal."""
        while not all(one.available() for one in (self._send, self._get, self._cancel)):
            time.sleep(0.01)
        key = uuid.uuid4().bytes
        self._orders[key] = order

        def decided(response: Any) -> None:
            say(goal=order, accepted=bool(response.accepted))
            if response.accepted:
                self.ask(order)

        goal = self._node.make("test_msgs/action/Fibonacci_Goal", order=order)
        self._send.call(decided, goal_id=self._id(key), goal=goal)

    def _key(self, order: int) -> bytes:
        (key,) = (key for key, known in self._orders.items() if known == order)
        return key

    def ask(self, order: int) -> None:
        """Ask for a goal's result."""

        def ended(response: Any) -> None:
            say(goal=order, status=int(response.status), sequence=numbers(response.result.sequence))

        self._get.call(ended, goal_id=self._id(self._key(order)))

    def cancel(self, order: int) -> None:
        """Ask for a goal to be canceled."""
        key = self._key(order)
        zero = self._node.make("builtin_interfaces/msg/Time", sec=0, nanosec=0)
        info = self._node.make("action_msgs/msg/GoalInfo", goal_id=self._id(key), stamp=zero)
        self._cancel.call(
            lambda response: say(goal=order, canceling=int(response.return_code)), goal_info=info
        )


def run(node: Node) -> None:
    """Obey until standard input ends."""
    client: Any = None
    kept = []
    for line in sys.stdin:
        for what, value in json.loads(line).items():
            if what == "serve":
                kept.append(Server(node, value))
                say(ready=value)
            elif what == "use":
                client = Client(node, value)
                say(ready=value)
            else:
                getattr(client, what)(value)
