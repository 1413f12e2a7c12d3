"""Find a DDS domain that nobody on this machine uses, so that no real robot is disturbed."""

from __future__ import annotations

import random
import socket

from rosplc.errors import SetupError

__all__ = ["FreeDomain"]

_FIRST, _LAST = 1, 101  # above 101 the ports meet those that Linux gives to clients
_PARTICIPANTS = 8


class FreeDomain:
    """A DDS domain in 1 … 101 whose UDP ports are free, kept from other demonstrations.

    Attributes:
        number: The domain.

    Raises:
        SetupError: SYS003, no such domain was found.
    """

    def __init__(self) -> None:
        domains = list(range(_FIRST, _LAST + 1))
        random.shuffle(domains)
        for number in domains:
            claim = _claim(number)
            if claim is None:
                continue
            if _is_free(number):
                self.number = number
                self._claim = claim
                return
            claim.close()
        raise SetupError("SYS003", f"every DDS domain from {_FIRST} to {_LAST} is in use")

    def close(self) -> None:
        """Let others have it; a second call does nothing."""
        self._claim.close()


def _claim(number: int) -> socket.socket | None:
    # Two demonstrations that start together would find the same ports free. An abstract socket can
    # be bound once per network namespace, as the ports can, and vanishes with its process.
    claim = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    try:
        claim.bind(f"\0rosplc-demo-domain-{number}")
    except OSError:
        claim.close()
        return None
    return claim


def _is_free(number: int) -> bool:
    # Ports of the DDSI-RTPS standard: 7400 + 250 × domain, + 0 and + 1 for multicast, then two
    # per participant from + 10 on.
    base = 7400 + 250 * number
    ports = [base, base + 1, *(base + 10 + offset for offset in range(2 * _PARTICIPANTS))]
    return all(_can_bind(port) for port in ports)


def _can_bind(port: int) -> bool:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind(("127.0.0.1", port))
        except OSError:
            return False
    return True
