"""What one run of the demonstration consists of; handed to its processes as JSON."""

from __future__ import annotations

import json
import math
import secrets
from dataclasses import asdict, dataclass, field
from typing import Any

from rosplc.demo.messages import COMMAND, robot_topics


@dataclass(frozen=True, slots=True)
class Plan:
    """The run's settings.

    DDS ``domain`` and ``prefix`` are unused by others, so that nothing else is touched. The robot sends so
    many ``topics`` with ``rate`` Hz each; ``interval`` is the PLC's cycle in seconds; message definitions are
    those of ``distro``.
    """

    domain: int
    rate: float
    topics: int
    prefix: str = field(default_factory=lambda: f"demo-{secrets.token_hex(4)}")
    interval: float = 0.01
    distro: str = "jazzy"

    def to_json(self) -> str:
        """Return the plan as one line of JSON."""
        return json.dumps(asdict(self))

    @classmethod
    def from_json(cls, text: str) -> Plan:
        """Read what :meth:`to_json` wrote."""
        return cls(**json.loads(text))

    @property
    def slots(self) -> int:
        """Slots per channel: two seconds' worth, since a busy machine stops a process that long."""
        return min(4096, 1 << math.ceil(math.log2(max(16.0, 2 * max(self.rate, 1 / self.interval)))))

    @property
    def per_scan(self) -> int:
        """Messages of a topic that the PLC takes in one scan: enough to catch up after a stop."""
        return max(8, math.ceil(8 * self.rate * self.interval))

    def configuration(self) -> dict[str, Any]:
        """Return the bridge's configuration, as ``rosplc run`` reads it."""
        kept = {"every": True, "slots": self.slots}
        scan = {"ranges": 64, "intensities": 1}
        topics: dict[str, Any] = {
            name: {"type": kind.type_name, "to": "plc", **kept, "limits": scan if kind.name == "scan" else {}}
            for name, kind in robot_topics(self.topics).items()
        }
        command, type_name = COMMAND
        topics[command] = {"type": type_name, "to": "ros", **kept}
        return {
            "bridge": "demo",
            "prefix": self.prefix,
            "ros": {"backend": "dds", "distro": self.distro, "domain": self.domain},
            "diagnostics": {"enabled": False},
            "topics": topics,
        }
