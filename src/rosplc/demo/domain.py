"""Find a DDS domain that no program on this machine uses, so that no real robot is disturbed."""

from __future__ import annotations

import random
import socket
from contextlib import ExitStack

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
