"""Where the master is and under which name other nodes reach this one: ROS 1's environment variables.

http://wiki.ros.org/ROS/EnvironmentVariables; ``ROS_HOSTNAME`` comes before ``ROS_IP``, as in roscpp
and rospy.
"""

from __future__ import annotations

import ipaddress
import socket
from collections.abc import Mapping
from dataclasses import dataclass
from urllib.parse import urlsplit

from rosplc.errors import BackendError

DEFAULT_MASTER = "http://localhost:11311"


@dataclass(frozen=True, slots=True)
class Address:
    """How a node finds the graph and is found.

    Attributes:
        master: The master's URI.
        host: The host name or address that other nodes are told.
        bind: The address to listen at; everything but a loopback ``host`` listens everywhere.
    """

    master: str
    host: str
    bind: str


def is_node_uri(uri: object) -> bool:
    """Return whether this is ``http://host:port``, with or without a slash at its end."""
    if not isinstance(uri, str) or len(uri) > 1024:
        return False
    try:
        parts = urlsplit(uri)
        return parts.scheme == "http" and bool(parts.hostname) and bool(parts.port)
    except ValueError:
        return False


def read_address(environment: Mapping[str, str]) -> Address:
    """Read ``ROS_MASTER_URI``, ``ROS_HOSTNAME`` and ``ROS_IP``.

    Raises:
        BackendError: ROS010, one of them is not valid.
    """
    master = environment.get("ROS_MASTER_URI") or DEFAULT_MASTER
    if not is_node_uri(master):
        raise _wrong("ROS_MASTER_URI", master, f"something like {DEFAULT_MASTER}")
    if environment.get("ROS_IPV6") == "on":
        raise _wrong("ROS_IPV6", "on", "off or unset: this backend speaks IPv4")
    host = _host(environment)
    local = host == "localhost" or host.startswith("127.")
    return Address(master, host, ("127.0.0.1" if host == "localhost" else host) if local else "")


def _host(environment: Mapping[str, str]) -> str:
    if "ROS_HOSTNAME" in environment:
        name = environment["ROS_HOSTNAME"]
        if not name or any(sign in name for sign in ":/ "):
            raise _wrong("ROS_HOSTNAME", name, "a host name without protocol and port")
        return name
    if "ROS_IP" in environment:
        text = environment["ROS_IP"]
        try:
            return str(ipaddress.IPv4Address(text))
        except ValueError:
            raise _wrong("ROS_IP", text, "an IPv4 address such as 192.168.1.10") from None
    name = socket.gethostname()
    return name if name and name != "localhost" and not name.startswith("127.") else "127.0.0.1"


def _wrong(variable: str, value: str, right: str) -> BackendError:
    return BackendError("ROS010", f"{variable} is {value!r}; it is {right}", where=variable)
