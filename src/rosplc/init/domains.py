"""Which DDS domains have nodes, without joining any of them: for people who look in the wrong one."""

from __future__ import annotations

import contextlib
import re
import select
import socket
import struct
import time
from pathlib import Path

_GROUP = "239.255.0.1"
_BASE, _GAIN, _LAST = 7400, 250, 101
"""RTPS 2.5, 9.6.1: the port of a domain's discovery by multicast; beyond 101 the kernel gives ports away."""
_PORTS = {_BASE + _GAIN * domain: domain for domain in range(_LAST + 1)}


def elsewhere(where: str, seconds: float = 3.0) -> str:
    """Return a clause that names other domains with DDS nodes; empty if none were seen.

    ``where`` is of interest if it begins with "domain" and a number; other machines are listened to for so
    long.
    """
    looked_at = re.match(r"domain (\d+)", where)
    if looked_at is None:
        return ""
    others = sorted(domains_in_use(seconds) - {int(looked_at[1])})
    if not others:
        return ""
    named = ", ".join(map(str, others[:5])) + (" and others" if len(others) > 5 else "")
    return f"; nodes are in domain {named}: set ROS_DOMAIN_ID or ros.domain"


def domains_in_use(seconds: float, proc: Path = Path("/proc")) -> set[int]:
    """Return the domains of this machine's DDS programs, and of those heard for so many seconds."""
    found = set()
    with contextlib.suppress(OSError, ValueError, IndexError):
        for line in (proc / "net/udp").read_text(encoding="ascii").splitlines()[1:]:
            port = int(line.split()[1].rpartition(":")[2], 16)
            if port in _PORTS:
                found.add(_PORTS[port])
    with contextlib.ExitStack() as stack:
        listening = {}
        for port, domain in _PORTS.items():
            with contextlib.suppress(OSError):  # no network, or no descriptors left
                udp = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
                udp.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
                udp.bind((_GROUP, port))
                group = struct.pack("4sl", socket.inet_aton(_GROUP), socket.INADDR_ANY)
                udp.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, group)
                listening[udp] = domain
        end = time.monotonic() + seconds
        while listening and (rest := end - time.monotonic()) > 0:
            for udp in select.select(list(listening), [], [], rest)[0]:
                if udp.recv(4) == b"RTPS":
                    found.add(listening.pop(udp))
    return found
