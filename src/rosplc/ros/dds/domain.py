"""DDS domains of this process: each is configured once, and shared by the backends in it.

The usual ROS environment variables become Cyclone DDS's configuration as in ``rmw_cyclonedds_cpp``, so that
the bridge is found wherever a ROS 2 node with the same environment would be. The user's ``CYCLONEDDS_URI``
comes last and wins.
"""

from __future__ import annotations

import logging
import os
import socket
import threading
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any
from xml.sax.saxutils import quoteattr

from cyclonedds.core import DDSException
from cyclonedds.domain import Domain
from cyclonedds.topic import Topic

from rosplc.errors import BackendError
from rosplc.ros._base import domain_number
from rosplc.ros.dds import native

MAX_DOMAIN = 232  # above, port numbers exceed 65535 (DDSI-RTPS 2.2, 9.6.1.1)

# Cyclone looks at a limited number of participants per machine; rmw_cyclonedds_cpp chooses 32.
_PARTICIPANTS = (
    "<ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>32</MaxAutoParticipantIndex>"
)

# Type information of Fast DDS (1.15) and Cyclone (1.16) peers is not compared: what their newer
# releases announce for ROS types does not equal what an IDL compiler makes of the same definition,
# and whatever has a sequence or an array would not match. Definitions are compared by ROS's own
# type hash instead (peers.py).
_COMPATIBILITY = "<Compatibility><IgnoreTypeInformation>1.15,1.16</IgnoreTypeInformation></Compatibility>"

# A burst must fit into a subscriber's receive buffer, by default 212,992 bytes on Linux with Fast DDS, whose
# size Cyclone takes to be its own. So repetitions go out in small bursts, and soon; the queue for them
# holds a large message. Fast DDS finds an endpoint that has gone by its key hash, which Cyclone leaves out by
# default: without it Fast DDS 3.2.3 counts endpoints that were closed until the whole participant has gone.
_INTERNAL = (
    "<Internal><GenerateKeyhash>true</GenerateKeyhash><BurstSize><MaxRexmit>64KiB</MaxRexmit></BurstSize>"
    "<MaxQueuedRexmitBytes>16MB</MaxQueuedRexmitBytes><MaxQueuedRexmitMessages>20000</MaxQueuedRexmitMessages>"
    '<HeartbeatInterval max="100ms">20ms</HeartbeatInterval></Internal>'
)

# Cyclone's own is 8 s: so long a Fast DDS node takes to find a bridge again whose network was down for longer
# than the lease of 10 s.
_ANNOUNCING = "<SPDPInterval>2s</SPDPInterval>"

_RANGES = ("SUBNET", "LOCALHOST", "OFF", "SYSTEM_DEFAULT")


def domain_id(domain: int | None, environment: Mapping[str, str]) -> int:
    """Return the domain: the given one, else ``ROS_DOMAIN_ID``, else 0; ROS010 if it is no number to 232."""
    return domain_number(domain, environment, MAX_DOMAIN) or 0


def _discovery_range(environment: Mapping[str, str]) -> str:
    local = environment.get("ROS_LOCALHOST_ONLY") or "0"
    if local not in ("0", "1"):
        what = f"ROS_LOCALHOST_ONLY is {local!r}; it is 0 or 1"
        raise BackendError("ROS010", what, where="ROS_LOCALHOST_ONLY")
    if local == "1":  # older, but where it is set it wins (rcl, discovery_options.c)
        return "LOCALHOST"
    name = "ROS_AUTOMATIC_DISCOVERY_RANGE"
    value = environment.get(name) or "SUBNET"
    if value not in _RANGES:
        raise BackendError("ROS010", f"{name} is {value!r}; it is one of {', '.join(_RANGES)}", where=name)
    return value


def _peers(addresses: list[str]) -> str:
    return "<Peers>" + "".join(f"<Peer address={quoteattr(address)}/>" for address in addresses) + "</Peers>"


def _interfaces(environment: Mapping[str, str], *, beyond: bool) -> str:
    """Return the interfaces of a node that looks for others on this machine."""
    # Peers on older releases of Cyclone, and on Fast DDS, announce themselves to 127.0.0.1 alone, and this
    # release takes no announcement from an interface that it does not use. Lists of interfaces add up, so one
    # in the user's configuration must be the only one.
    if "NetworkInterface" in environment.get("CYCLONEDDS_URI", ""):
        return ""
    others = '<NetworkInterface autodetermine="true"/>' if beyond else ""
    return f'<Interfaces>{others}<NetworkInterface address="127.0.0.1"/></Interfaces>'


def domain_config(environment: Mapping[str, str], distro: str, extra: str = "") -> str:
    """Return the configuration for ``dds_create_domain``: XML fragments (``extra`` too) with commas."""
    # Humble does not look at the newer variables; a value that ROS does not know is ROS010.
    humble = distro == "humble"
    if humble:
        environment = {key: value for key, value in environment.items() if key not in _NOT_HUMBLE}
    reach = _discovery_range(environment)
    static = _static_peers(environment)
    general, discovery = "", ""
    if reach == "LOCALHOST":
        general = "<AllowMulticast>false</AllowMulticast>" + _interfaces(environment, beyond=bool(static))
        discovery = _PARTICIPANTS + _peers(["localhost", *static])
    elif reach == "OFF":
        general = "<AllowMulticast>false</AllowMulticast>"
        # Nobody else uses this tag, so that nobody is discovered, and no participant index is used up.
        discovery = f"<ParticipantIndex>none</ParticipantIndex><Tag>ros_discovery_off_{os.getpid()}</Tag>"
    elif reach == "SUBNET":
        discovery = _PARTICIPANTS + (_peers(static) if static else "")
    own = (
        '<CycloneDDS><Domain id="any">'
        + (f"<General>{general}</General>" if general else "")
        + f"<Discovery>{discovery}{_ANNOUNCING}</Discovery>"
        + f"{_COMPATIBILITY}{_INTERNAL}{extra}</Domain></CycloneDDS>"
    )
    users = environment.get("CYCLONEDDS_URI", "").strip()
    if not users.isascii():
        raise BackendError("ROS010", "CYCLONEDDS_URI has characters beyond ASCII", where="CYCLONEDDS_URI")
    return f"{own},{users}" if users else own


_NOT_HUMBLE = ("ROS_AUTOMATIC_DISCOVERY_RANGE", "ROS_STATIC_PEERS")


def check_peers(environment: Mapping[str, str], distro: str) -> None:
    """Refuse (ROS010) a static peer without an address: the library would abort the process."""
    users = environment.get("CYCLONEDDS_URI", "")
    if distro == "humble" or "udp6" in users or "IPv6" in users:
        return  # not looked at; or other addresses are fine
    if _discovery_range(environment) not in ("SUBNET", "LOCALHOST"):
        return
    for peer in _static_peers(environment):
        host, _, port = peer.partition(":")
        try:
            if not port or port.isdigit():
                socket.getaddrinfo(host, None, socket.AF_INET)
                continue
            why = "it is HOST or HOST:PORT"
        except (OSError, UnicodeError) as error:
            why = getattr(error, "strerror", None) or str(error)
        what = f"ROS_STATIC_PEERS has {peer!r}: {why}"
        raise BackendError("ROS010", what, where="ROS_STATIC_PEERS")


def _static_peers(environment: Mapping[str, str]) -> list[str]:
    if environment.get("ROS_LOCALHOST_ONLY") == "1":
        return []
    return [*filter(None, map(str.strip, environment.get("ROS_STATIC_PEERS", "").split(";")))]


_logger = logging.getLogger("rosplc.ros.dds")


# Held while types come and go.
#
# Creating a topic, the wheel walks the type library without the library's lock (cyclonedds 11.0.1; the report
# is tests/interop/upstream/cyclonedds_types.md): whatever removes a type at that moment ends the process.
TYPES = threading.RLock()


class Topics:
    """A participant's topics, opened once and kept: no type is removed while the participant lives."""

    def __init__(self, participant: Any) -> None:
        self._participant = participant
        self._open: dict[tuple[str, Any], Any] = {}

    def __call__(self, name: str, data_type: Any) -> Any:
        """Return the topic of this name and type; DDSException if the library refuses it."""
        with TYPES:
            if (name, data_type) not in self._open:
                self._open[name, data_type] = Topic(self._participant, name, data_type)
            return self._open[name, data_type]

    def close(self) -> None:
        """Delete the topics."""
        with TYPES:
            while self._open:
                native.delete(self._open.popitem()[1])


@dataclass
class _Entry:
    domain: Any
    config: str
    users: int = 1


_domains: dict[int, _Entry] = {}
_lock = threading.Lock()


def enter(number: int, config: str) -> None:
    """Make sure that a domain exists, with this configuration if it is new; raises ROS002."""
    with _lock, TYPES:
        if (entry := _domains.get(number)) is not None:
            entry.users += 1
            if entry.config != config:
                text = "domain %d is in use with another configuration, which stays in force"
                _logger.warning(text, number)
            return
        try:
            _domains[number] = _Entry(Domain(number, config), config)
        except DDSException as error:
            if error.code == DDSException.DDS_RETCODE_PRECONDITION_NOT_MET:
                text = "domain %d was opened by other code in this process; its configuration stays"
                _logger.warning(text, number)
                return
            remedy = "Check CYCLONEDDS_URI and the network interfaces; the library's own words are on stderr."
            raise native.refusal(f"cannot join domain {number}", error, remedy=remedy) from error


def leave(number: int) -> None:
    """Give a domain up; the last one deletes it."""
    with _lock, TYPES:
        entry = _domains.get(number)
        if entry is None:
            return
        entry.users -= 1
        if entry.users == 0:
            del _domains[number]
            native.delete(entry.domain)
