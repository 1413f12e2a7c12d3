"""A node on the installed rclpy, driven by lines of JSON: no code of rosplc between it and the network.

Started as ``python peer.py DOMAIN NAME``. It reads from standard input
``{"subscribe": TOPIC, "type": …, "reliable": …}``, ``{"advertise": TOPIC, "type": …}``,
``{"serve": SERVICE, "type": …}``, ``{"proxy": SERVICE, "type": …}``,
``{"call": SERVICE, "payload": BASE64, "wait": BOOL}``, ``{"ends": SERVICE}``,
``{"echo": TOPIC, "to": TOPIC, "type": …}``,
``{"publish": TOPIC, "payload": BASE64}`` and
``{"fill": TOPIC, "size": BYTES, "count": N, "period": SECONDS}``. It prints ``{"ready": TOPIC}`` and
``{"heard": TOPIC, "size": …, "crc": …, "payload": …}``, where the payload is left out if it is large.
Requests and responses are printed as heard on ``request:SERVICE`` and ``response:SERVICE``; a server
sends its request's bytes back as the response. ``ends`` is heard on ``ends:SERVICE``: readers of requests,
writers of responses, and whether a client takes the service to be available.
"""

from __future__ import annotations

import base64
import importlib
import json
import queue
import sys
import threading
import time
import zlib
from functools import partial
from typing import Any

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message, serialize_message

LARGE = 100_000
VERBS = ("subscribe", "advertise", "echo", "publish", "fill", "serve", "proxy", "call", "ends")


def say(**words: object) -> None:
    """Print one line."""
    print(json.dumps(words), flush=True)


def main() -> None:
    """Do what the lines say until standard input ends."""
    rclpy.init(domain_id=int(sys.argv[1]))
    node = rclpy.create_node(sys.argv[2])
    executor = SingleThreadedExecutor()
    executor.add_node(node)

    stopped, ended = threading.Event(), threading.Event()
    lines: queue.SimpleQueue[str] = queue.SimpleQueue()

    def read() -> None:
        for line in sys.stdin:
            lines.put(line)
        ended.set()
        lines.put("")

    def spin() -> None:
        while not stopped.is_set():  # rclpy's own end of a spin can miss the end of its context
            executor.spin_once(timeout_sec=0.1)

    # A daemon: the process ends, and its test fails, when the lines cannot be followed.
    thread = threading.Thread(target=spin, daemon=True)
    thread.start()
    threading.Thread(target=read, daemon=True).start()
    publishers: dict[str, tuple[Any, Any]] = {}
    kept = []

    def hear(topic: str, message: Any) -> None:
        data = serialize_message(message)
        words = {} if len(data) > LARGE else {"payload": base64.b64encode(data).decode()}
        say(heard=topic, size=len(data), crc=zlib.crc32(data), **words)

    def answer(service: str, request: Any, response: Any) -> Any:
        hear(f"request:{service}", request)
        return deserialize_message(serialize_message(request) + bytes(16), type(response))

    for line in iter(lines.get, ""):
        order = json.loads(line)
        topic = next(order[verb] for verb in VERBS if verb in order)
        if "type" in order:
            package, part, name = order["type"].split("/")
            kind = getattr(importlib.import_module(f"{package}.{part}"), name)
            profile = QoSProfile(depth=order.get("depth", 10))
            if not order.get("reliable", True):
                profile.reliability = ReliabilityPolicy.BEST_EFFORT
            if order.get("latched"):
                profile.durability = DurabilityPolicy.TRANSIENT_LOCAL
        if "subscribe" in order:
            kept.append(node.create_subscription(kind, topic, lambda m, topic=topic: hear(topic, m), profile))
            say(ready=topic)
        elif "serve" in order:
            kept.append(node.create_service(kind, topic, partial(answer, topic)))
            say(ready=topic)
        elif "proxy" in order:
            publishers[topic] = node.create_client(kind, topic), kind
            say(ready=topic)
        elif "call" in order:
            client, kind = publishers[topic]
            if order.get("wait", True):
                client.wait_for_service()
            request = deserialize_message(base64.b64decode(order["payload"]), kind.Request)
            future = client.call_async(request)
            future.add_done_callback(lambda f, topic=topic: hear(f"response:{topic}", f.result()))
        elif "ends" in order:
            readers = node.get_subscriptions_info_by_topic(f"rq{topic}Request", True)
            writers = node.get_publishers_info_by_topic(f"rr{topic}Reply", True)
            counts = len(readers), len(writers), publishers[topic][0].service_is_ready()
            say(heard=f"ends:{topic}", counts=counts)
        elif "echo" in order:
            publisher = node.create_publisher(kind, order["to"], profile)
            kept.append(node.create_subscription(kind, topic, publisher.publish, profile))
            say(ready=topic)
        elif "advertise" in order:
            publishers[topic] = node.create_publisher(kind, topic, profile), kind
            say(ready=topic)
        else:
            publisher, kind = publishers[topic]
            while not publisher.get_subscription_count() and not ended.is_set():
                time.sleep(0.01)
            if "publish" in order:
                publisher.publish(deserialize_message(base64.b64decode(order["payload"]), kind))
            else:
                for number in range(order["count"]):
                    publisher.publish(kind(data=bytes([number % 256]) * order["size"]))
                    time.sleep(order["period"])
    stopped.set()
    thread.join()
    rclpy.try_shutdown()


if __name__ == "__main__":
    main()
