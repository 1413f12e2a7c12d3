"""A node with rclpy's own action server or client of test_msgs/Fibonacci: no code of rosplc in it.

Started as ``python action_peer.py DOMAIN NAME``. It reads ``{"serve": ACTION}``, ``{"use": ACTION}``,
``{"send": ORDER}``, ``{"ask": ORDER}`` for the result again, ``{"cancel": ORDER}`` and ``{"look": ACTION}``.
It prints ``{"ready": ACTION}``, after a look whether there is a ``server``, and with a goal's order
``accepted``, ``feedback``, ``canceling`` with a code, and ``status`` with a ``sequence``; the server adds
``began`` and ``canceled``.

The server rejects orders below 0. It sends the numbers up to the order as feedback until there are so many,
or for ever from 50 on; then the goal succeeds, or is aborted if the order is odd. It refuses to cancel 77.
"""

from __future__ import annotations

import json
import sys
import threading
import time
from functools import partial
from typing import Any

import rclpy
from rclpy.action import ActionClient, ActionServer, CancelResponse, GoalResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import MultiThreadedExecutor
from test_msgs.action import Fibonacci


def say(**words: object) -> None:
    """Print one line."""
    print(json.dumps(words), flush=True)


def execute(goal: Any) -> Any:
    """Execute a goal of the server."""
    order, sequence = goal.request.order, []
    say(goal=order, began=True)
    while len(sequence) < order or order >= 50:
        if goal.is_cancel_requested:
            goal.canceled()
            say(goal=order, canceled=True)
            return Fibonacci.Result(sequence=sequence)
        sequence.append(len(sequence))
        goal.publish_feedback(Fibonacci.Feedback(sequence=sequence))
        time.sleep(0.02)
    (goal.abort if order % 2 else goal.succeed)()
    return Fibonacci.Result(sequence=sequence)


def decide(request: Any) -> GoalResponse:
    """Decide on a goal."""
    return GoalResponse.REJECT if request.order < 0 else GoalResponse.ACCEPT


def agree(goal: Any) -> CancelResponse:
    """Decide on a request to cancel."""
    return CancelResponse.REJECT if goal.request.order == 77 else CancelResponse.ACCEPT


def main() -> None:
    """Do what the lines say until standard input ends."""
    rclpy.init(domain_id=int(sys.argv[1]))
    node = rclpy.create_node(sys.argv[2])
    group = ReentrantCallbackGroup()
    executor = MultiThreadedExecutor(4)
    executor.add_node(node)

    stopped = threading.Event()

    def spin() -> None:
        while not stopped.is_set():  # rclpy's own end of a spin can miss the end of its context
            executor.spin_once(timeout_sec=0.1)

    # A daemon: the process ends, and its test fails, when the lines cannot be followed.
    thread = threading.Thread(target=spin, daemon=True)
    thread.start()
    goals: dict[int, Any] = {}
    kept = []

    def decided(order: int, future: Any) -> None:
        goals[order] = future.result()
        say(goal=order, accepted=goals[order].accepted)
        if goals[order].accepted:
            goals[order].get_result_async().add_done_callback(partial(ended, order))

    def ended(order: int, future: Any) -> None:
        found = future.result()
        say(goal=order, status=found.status, sequence=list(found.result.sequence))

    for line in sys.stdin:
        words = json.loads(line)
        if "serve" in words:
            server = ActionServer(
                node, Fibonacci, words["serve"], execute, goal_callback=decide, cancel_callback=agree,
                callback_group=group,
            )  # fmt: skip
            kept.append(server)
            say(ready=words["serve"])
        elif "use" in words:
            client = ActionClient(node, Fibonacci, words["use"], callback_group=group)
            say(ready=words["use"])
        elif "send" in words:
            order = words["send"]
            client.wait_for_server()
            feedback = lambda m, order=order: say(goal=order, feedback=list(m.feedback.sequence))  # noqa: E731
            client.send_goal_async(Fibonacci.Goal(order=order), feedback).add_done_callback(
                partial(decided, order)
            )
        elif "ask" in words:
            order = words["ask"]
            goals[order].get_result_async().add_done_callback(partial(ended, order))
        elif "look" in words:
            say(goal=0, server=client.server_is_ready())
        else:
            order = words["cancel"]
            done = lambda f, order=order: say(goal=order, canceling=f.result().return_code)  # noqa: E731
            goals[order].cancel_goal_async().add_done_callback(done)
    stopped.set()
    thread.join()
    rclpy.try_shutdown()


if __name__ == "__main__":
    main()
