"""The ROS side of the end-to-end comparison: sends messages, and judges what comes back.

    python -m rosplc.bench.end_to_end_ros JSON

An ordinary DDS participant that knows nothing of what carries its messages. A message is back when one
with its number arrives whole; one that arrives with pieces of several is counted as torn.
"""

from __future__ import annotations

import json
import random
import sys
import threading
import time
from typing import Any

from rosplc.bench.end_to_end_child import orders, say
from rosplc.bench.end_to_end_messages import KINDS, Judgement, Kind
from rosplc.codec import Codec, Wire
from rosplc.layout import Limits, compute_layout
from rosplc.model import TypeStore
from rosplc.ros import Backend, Qos, open_backend

__all__ = ["DISTRO", "LIMITS", "QOS", "Translator", "main", "topics"]

DISTRO = "jazzy"
LIMITS = Limits(string=32, sequence=24)
QOS = Qos(reliability="reliable", durability="volatile", depth=1000)
_GRACE_S = 5.0
_LOST_S = 1.0


def topics(method: str, kind: str) -> tuple[str, str]:
    """Return the topics to the PLC and back."""
    return f"/e2e/{method}/{kind}/to_plc", f"/e2e/{method}/{kind}/to_ros"


class Translator:
    """A type's leaves to CDR and back."""

    def __init__(self, store: TypeStore, kind: Kind) -> None:
        self.kind = kind
        self._layout = compute_layout(store, kind.type_name, LIMITS)
        self._codec = Codec(self._layout, Wire.CDR)

    def encode(self, leaves: list[Any]) -> bytes:
        """Return a message."""
        return self._codec.encode(self._layout.pack(self.kind.tree(leaves)))

    def decode(self, data: bytes) -> list[Any]:
        """Return a message's leaves."""
        return self.kind.read(self._layout.view(self._codec.decode(data)))


class Line:
    """One method with one type: a publisher, a subscription, and what came back."""

    def __init__(self, backend: Backend, store: TypeStore, method: str, kind: Kind) -> None:
        forth, back = topics(method, kind.name)
        self._kind = kind
        self._translator = Translator(store, kind)
        self._publisher = backend.advertise(forth, kind.type_name, QOS)
        self._subscription = backend.subscribe(back, kind.type_name, QOS, self._on_message)
        self._number = 0
        self._sent: dict[int, int] = {}
        self._came: dict[int, float] = {}
        self._judgements: list[Judgement] = []
        self._news = threading.Condition()

    @property
    def ready(self) -> bool:
        """Whether both ends of the way are there."""
        return bool(self._publisher.matched and self._subscription.matched)

    def _on_message(self, data: bytes, _stamp_ns: int) -> None:
        now = time.monotonic_ns()
        judgement = self._kind.judge(self._translator.decode(data))
        with self._news:
            self._judgements.append(judgement)
            sent = self._sent.get(judgement.number)
            if sent is not None and judgement.number not in self._came:
                self._came[judgement.number] = (now - sent) / 1000
                self._news.notify()

    def _send(self) -> int:
        self._number += 1
        payload = self._translator.encode(self._kind.leaves(self._number))
        self._sent[self._number] = time.monotonic_ns()
        self._publisher.write(payload)
        return self._number

    def _wait(self, number: int, seconds: float) -> bool:
        with self._news:
            return self._news.wait_for(lambda: number in self._came, seconds)

    def stream(self, count: int, rate: float) -> dict[str, Any]:
        """Send ``count`` messages at ``rate`` (Hz), whatever comes back; report."""
        self._begin()
        began = due = time.monotonic()
        number = 0
        for _ in range(count):
            number = self._send()
            # A fixed period would keep one phase to the PLC's cycle for the whole run.
            due += random.uniform(0.7, 1.3) / rate
            time.sleep(max(0.0, due - time.monotonic()))
        seconds = time.monotonic() - began
        self._wait(number, _GRACE_S)
        return {"sent": count, "seconds": seconds, **self._report()}

    def ping_pong(self, seconds: float) -> dict[str, Any]:
        """Send the next message as soon as the one before is back, for some time; report."""
        self._begin()
        began = time.monotonic()
        sent = 0
        while time.monotonic() - began < seconds:
            sent += 1
            self._wait(self._send(), _LOST_S)
        return {"sent": sent, "seconds": time.monotonic() - began, **self._report()}

    def _begin(self) -> None:
        with self._news:
            self._sent, self._came, self._judgements = {}, {}, []

    def _report(self) -> dict[str, Any]:
        with self._news:
            whole = [one for one in self._judgements if not one.torn and one.number in self._sent]
            return {
                "latencies_us": list(self._came.values()),
                "received": len(self._judgements),
                "torn": sum(one.torn for one in self._judgements),
                "error": max((one.error for one in whole), default=0.0),
                "strings": min((one.strings for one in whole), default=0),
            }


def main() -> None:
    """Run the ROS side; orders name a method and a kind, and what to do."""
    plan = json.loads(sys.argv[1])
    store = TypeStore.bundled(DISTRO)
    backend = open_backend("dds", store, "bench_robot", domain=plan["domain"])
    lines = {
        (method, name): Line(backend, store, method, KINDS[name])
        for method in plan["methods"]
        for name in plan["kinds"]
    }
    say(ready=True)
    for order in orders():
        if order["do"] == "ready":
            say(missing=[" ".join(key) for key, line in lines.items() if not line.ready])
            continue
        line = lines[order["method"], order["kind"]]
        if order["do"] == "stream":
            say(**line.stream(order["count"], order["rate"]))
        else:
            say(**line.ping_pong(order["seconds"]))
    backend.close()


if __name__ == "__main__":
    main()
