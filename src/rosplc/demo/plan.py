"""What one run of the demonstration consists of; handed to its processes as JSON."""

from __future__ import annotations

import json
import math
import random
import secrets
import socket
from contextlib import ExitStack
from dataclasses import asdict, dataclass, field
from typing import Any

from rosplc.demo.messages import COMMAND, robot_topics
from rosplc.errors import SetupError

_FIRST, _LAST = 1, 101  # above 101 the ports meet those that Linux gives to clients
_PARTICIPANTS = 8


class FreeDomain:
    """A DDS domain in 1 … 101, ``number``, whose UDP ports are free, kept from other demonstrations.

    Raises SetupError SYS003 if no such domain was found.
    """

    def __init__(self) -> None:
        for number in random.sample(range(_FIRST, _LAST + 1), _LAST):
            # Two demonstrations that start together would find the same ports free. An abstract socket can
            # be bound once per network namespace, as the ports can, and vanishes with its process.
            claim = _bound(socket.AF_UNIX, f"\0rosplc-demo-domain-{number}")
            if claim is not None and _is_free(number):
                self.number, self._claim = number, claim
                return
            if claim is not None:
                claim.close()
        raise SetupError("SYS003", f"every DDS domain from {_FIRST} to {_LAST} is in use")

    def close(self) -> None:
        """Let others have it; a second call does nothing."""
        self._claim.close()


def _is_free(number: int) -> bool:
    # Ports of the DDSI-RTPS standard: 7400 + 250 × domain, + 0 and + 1 for multicast, then two
    # per participant from + 10 on.
    base = 7400 + 250 * number
    with ExitStack() as stack:
        for port in (base, base + 1, *range(base + 10, base + 10 + 2 * _PARTICIPANTS)):
            probe = _bound(socket.AF_INET, ("127.0.0.1", port))
            if probe is None:
                return False
            stack.enter_context(probe)
    return True


def _bound(family: socket.AddressFamily, address: str | tuple[str, int]) -> socket.socket | None:
    """Return a datagram socket that has an address; None if another has it."""
    found = socket.socket(family, socket.SOCK_DGRAM)
    try:
        found.bind(address)
    except OSError:
        found.close()
        return None
    return found


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
