"""The ROS nodes: one publishes, the other subscribes and listens to the bridge's diagnostics."""

from __future__ import annotations

import signal
import sys
import time
from pathlib import Path
from typing import Any

from rosplc.codec import Codec
from rosplc.layout import Limits, compute_layout
from rosplc.model import TypeStore
from rosplc.ros import Backend, Qos, open_backend
from tests.soak.messages import ALL, ROS_DEPTH, TOPICS, TYPE, Counters, fill, towards_plc, wire_codec

_PERIOD_S = 0.01
_RELIABLE = Qos(reliability="reliable", durability="volatile", depth=ROS_DEPTH)
_DIAGNOSTICS = "diagnostic_msgs/msg/DiagnosticArray"


def _open(kind: str, name: str, where: str) -> tuple[Backend, TypeStore]:
    store = TypeStore.bundled("noetic" if kind == "rospy" else "jazzy")
    options: dict[str, Any] | None = None
    domain: int | None = None
    if kind == "zenoh":
        options = {"mode": "peer", "connect": [where]}
    elif kind == "dds":
        domain = int(where)
    return open_backend(kind, store, name, domain=domain, options=options), store


class _UntilTold:
    """Whether SIGTERM has come. No Event: set by a handler just when its thread begins to wait, it hangs."""

    def __init__(self) -> None:
        self.told = False
        signal.signal(signal.SIGTERM, self._tell)

    def _tell(self, *_: object) -> None:
        self.told = True

    def wait(self, seconds: float) -> bool:
        """Sleep; return whether it is time to end."""
        time.sleep(seconds)
        return self.told


def publish(counters: Counters, generation: int, kind: str, where: str, topics: list[str]) -> None:
    """Publish until told to stop, each topic a hundred times a second, or as often as ordered."""
    stop = _UntilTold()
    backend, store = _open(kind, "soak_publisher", where)
    codec = wire_codec(store)
    publishers = {
        ALL.index(topic): backend.advertise(topic, TYPE, _RELIABLE) for topic in topics if towards_plc(topic)
    }
    due, number = time.monotonic(), 0
    while not stop.told:
        number += 1
        for index, publisher in publishers.items():
            record = codec.layout.pack({"data": fill(index, generation, number)})
            counters.announce(index, generation, number)
            publisher.write(codec.encode(record))
        counters.control["publisher_turns"] += 1
        counters.control["publisher_clock_ns"] = time.time_ns()
        due = max(due + _PERIOD_S / max(1, int(counters.control["flood"])), time.monotonic() - 0.1)
        stop.wait(max(0.0, due - time.monotonic()))
    backend.close()


def subscribe(counters: Counters, kind: str, where: str, topics: list[str]) -> None:
    """Judge what comes, and pass on what the bridge says of itself."""
    stop = _UntilTold()
    backend, store = _open(kind, "soak_subscriber", where)
    codec = wire_codec(store)

    def listener(index: int) -> Any:
        def on_message(data: bytes, _stamp_ns: int) -> None:
            message = codec.layout.view(codec.decode(data, truncate=True))
            counters.take(index, message.data)

        return on_message

    subscriptions = {
        ALL.index(topic): backend.subscribe(topic, TYPE, _RELIABLE, listener(ALL.index(topic)))
        for topic in topics
        if not towards_plc(topic)
    }
    fields = {"status": 32, "status[].values": 24}
    layout = compute_layout(store, _DIAGNOSTICS, Limits(string=300, sequence=24, fields=fields))
    reader = Codec(layout)
    backend.subscribe(
        "/diagnostics",
        _DIAGNOSTICS,
        Qos(),
        lambda data, _: _note(counters, layout.to_dict(reader.decode(data))),
    )
    before = dict.fromkeys(subscriptions, 0)
    while not stop.wait(0.05):
        for index, subscription in subscriptions.items():
            dropped = subscription.status().dropped
            if index < len(TOPICS):
                counters.control["dropped"][index] += dropped - before[index]
            before[index] = dropped
    backend.close()


def _note(counters: Counters, array: dict[str, Any]) -> None:
    for status in array["status"]:
        topic = status["name"].rpartition(": ")[2]
        if topic in TOPICS:
            values = {pair["key"]: pair["value"] for pair in status["values"]}
            for name in counters.bridge.dtype.names:
                counters.bridge[TOPICS.index(topic)][name] = int(values[name])
    stamp = array["header"]["stamp"]
    counters.control["stamp_ns"] = stamp["sec"] * 10**9 + stamp.get("nanosec", stamp.get("nsec", 0))
    counters.control["diagnostics"] += 1


def main() -> None:
    """Run until told to stop: arguments are role, counters, generation, backend, where, topics."""
    role, path, generation, kind, where, *topics = sys.argv[1:]
    counters = Counters(Path(path))
    if role == "publisher":
        publish(counters, int(generation), kind, where, topics)
    else:
        subscribe(counters, kind, where, topics)


if __name__ == "__main__":
    main()
