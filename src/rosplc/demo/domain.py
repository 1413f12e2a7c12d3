"""Find a DDS domain that nobody on this machine uses, so that no real robot is disturbed."""

from __future__ import annotations

import random
import socket

from rosplc.errors import SetupError

__all__ = ["free_domain"]

_FIRST, _LAST = 1, 101  # above 101 the ports meet those that Linux gives to clients
_PARTICIPANTS = 8


def free_domain() -> int:
    """Return a DDS domain in 1 … 101 whose UDP ports are all free.

    Raises:
        SetupError: SYS003, no such domain was found.
    """
    domains = list(range(_FIRST, _LAST + 1))
    random.shuffle(domains)
    for domain in domains:
        if _is_free(domain):
            return domain
    raise SetupError("SYS003", f"every DDS domain from {_FIRST} to {_LAST} is in use")


def _is_free(domain: int) -> bool:
    # Ports of the DDSI-RTPS standard: 7400 + 250 × domain, + 0 and + 1 for multicast, then two
    # per participant from + 10 on.
    base = 7400 + 250 * domain
    ports = [base, base + 1, *(base + 10 + offset for offset in range(2 * _PARTICIPANTS))]
    return all(_can_bind(port) for port in ports)


def _can_bind(port: int) -> bool:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind(("127.0.0.1", port))
        except OSError:
            return False
    return True
