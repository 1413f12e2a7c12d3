"""The ROS environment of a bridge: variables, network interfaces, and the ROS master or Zenoh router."""

from __future__ import annotations

import ipaddress
import socket
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import urlsplit

from rosplc.codec import Codec, Wire
from rosplc.config import TopicPlan
from rosplc.doctor.finding import Finding, Level
from rosplc.doctor.kinds import fine, found, judged
from rosplc.harmless import listed
from rosplc.ros.buffers import cyclone_buffer, default_buffer, largest_message
from rosplc.shm import Direction

_MAX_DOMAIN = 232
_RANGES = ("SUBNET", "LOCALHOST", "OFF", "SYSTEM_DEFAULT")


@dataclass(frozen=True)
class Wish:
    """The configuration's ROS settings; ``backend`` is empty if unknown, ``domain`` None if not set."""

    distro: str
    ros1: bool
    backend: str = ""
    domain: int | None = None


def distro(environment: Mapping[str, str], wish: Wish | None) -> Iterator[Finding]:
    """Compare the shell's ROS distribution with the configuration's."""
    here = environment.get("ROS_DISTRO", "")
    other = wish is not None and here and here != wish.distro
    seen = f"ROS_DISTRO is {here}, but ros.distro is {wish.distro}" if wish and other else ""
    unset = "ROS_DISTRO is not set: no ROS installation is sourced, and none is needed"
    remedy = f"Set `ros: {{distro: {here}}}`, or source the setup.bash of the configured distribution."
    yield judged("DOC401", seen, f"ROS_DISTRO is {here}" if here else unset, remedy)


def values(environment: Mapping[str, str], wish: Wish | None) -> Iterator[Finding]:
    """Judge whether the variables have values that are valid in ROS."""

    def is_domain(text: str) -> bool:
        return text.isascii() and text.isdigit() and len(text) < 10 and int(text) <= _MAX_DOMAIN

    rules: tuple[tuple[str, Callable[[str], bool], str], ...] = (
        ("ROS_DOMAIN_ID", is_domain, f"a number from 0 to {_MAX_DOMAIN}"),
        ("ROS_LOCALHOST_ONLY", ("0", "1").__contains__, "0 or 1"),
        ("ROS_AUTOMATIC_DISCOVERY_RANGE", _RANGES.__contains__, f"one of {', '.join(_RANGES)}"),
    )
    wrong = [
        (name, value, right)
        for name, holds, right in (rules if wish is None or not wish.ros1 else ())
        if (value := environment.get(name, "")) and not holds(value)
    ]
    for name, value, right in wrong:
        yield found("DOC403", f"{name} is {value!r}; it must be {right}", command=f"unset {name}")
    if not wrong:
        yield fine("DOC403", "the ROS environment variables have valid values")


def domain(environment: Mapping[str, str], wish: Wish | None) -> Iterator[Finding]:
    """Compare the domain of the shell with that of the configuration."""
    here = environment.get("ROS_DOMAIN_ID", "") or "0"
    if wish is not None and wish.ros1:
        return
    if wish is None or wish.domain is None:
        yield fine("DOC402", f"ROS domain {here}")
        return
    what = f"ros.domain is {wish.domain}, but nodes started from this shell use domain {here}"
    well = f"shell and configuration use ROS domain {here}"
    command = f"export ROS_DOMAIN_ID={wish.domain}"
    yield judged("DOC402", "" if str(wish.domain) == here else what, well, command=command)


def middleware(environment: Mapping[str, str], wish: Wish | None) -> Iterator[Finding]:
    """Compare RMW_IMPLEMENTATION with the backend."""
    rmw = environment.get("RMW_IMPLEMENTATION", "").strip()
    word = f"RMW_IMPLEMENTATION is {rmw}" if rmw else "RMW_IMPLEMENTATION is not set, so nodes use DDS"
    if wish is not None and wish.ros1:
        yield fine("DOC404", "ROS 1 does not use RMW_IMPLEMENTATION")
    elif wish is None or wish.backend in ("", "rclpy", "memory"):
        yield fine("DOC404", word)
    else:
        zenoh = wish.backend == "zenoh"
        what = "" if zenoh == (rmw == "rmw_zenoh_cpp") else f"{word}, but the backend is {wish.backend}"
        remedy = None if zenoh else "Set `ros: {backend: zenoh}`, or unset RMW_IMPLEMENTATION for the nodes."
        command = "export RMW_IMPLEMENTATION=rmw_zenoh_cpp" if zenoh else ""
        yield judged("DOC404", what, f"{word}, which matches backend {wish.backend}", remedy, command)


def reach(environment: Mapping[str, str], wish: Wish | None) -> Iterator[Finding]:
    """Report variables that limit discovery."""
    if wish is not None and (wish.ros1 or wish.backend == "zenoh"):
        return
    variable = "ROS_AUTOMATIC_DISCOVERY_RANGE"
    peers = environment.get("ROS_STATIC_PEERS", "")
    if environment.get("ROS_LOCALHOST_ONLY") == "1":
        yield found("DOC405", "ROS_LOCALHOST_ONLY=1: only nodes on this machine are found")
    elif environment.get(variable) == "OFF":
        yield found("DOC405", f"{variable}=OFF: no node is found", "Unset the variable.", f"unset {variable}")
    else:
        more = f" and at {peers}" if peers else ""
        local = f"{variable}=LOCALHOST: only nodes on this machine{more} are found"
        well = f"discovery reaches the subnet{f' and {peers}' if peers else ''}"
        yield judged("DOC405", local if environment.get(variable) == "LOCALHOST" else "", well)


def addresses(
    environment: Mapping[str, str],
    wish: Wish | None,
    *,
    resolve: Callable[[str], list[str]],
    is_local: Callable[[str], bool],
) -> Iterator[Finding]:
    """Judge the hosts in the ROS environment variables.

    ``resolve`` returns a name's IPv4 addresses, or raises OSError; ``is_local`` returns whether an address
    belongs to this machine.
    """
    if wish is None or not wish.ros1:
        yield from _peers(environment.get("ROS_STATIC_PEERS", ""), resolve)
        return
    name = next((key for key in ("ROS_HOSTNAME", "ROS_IP") if environment.get(key)), "")
    if not name:
        yield fine("DOC410", "other nodes get this machine's host name (ROS_IP and ROS_HOSTNAME are not set)")
        return
    text = environment[name]
    try:
        numbers = [str(ipaddress.ip_address(text))]
    except ValueError:
        try:
            numbers = resolve(text)
        except (OSError, UnicodeError):
            yield found("DOC406", f"{name}={text} cannot be resolved")
            return
    seen = "" if any(map(is_local, numbers)) else f"{name}={text} is not an address of this machine"
    yield judged("DOC410", seen, f"{name}={text} is an address of this machine", command=f"unset {name}")


def _peers(text: str, resolve: Callable[[str], list[str]]) -> Iterator[Finding]:
    hosts = [peer.strip().partition(":")[0] for peer in text.split(";") if peer.strip()]
    bad = []
    for host in hosts:
        try:
            resolve(host)
        except (OSError, UnicodeError):
            bad.append(host)
    if hosts:
        seen = f"names in ROS_STATIC_PEERS cannot be resolved: {listed(bad)}" if bad else ""
        command = f"getent hosts {bad[0]}" if bad else ""
        yield judged("DOC406", seen, "all names in ROS_STATIC_PEERS can be resolved", command=command)


_UP, _LOOPBACK, _MULTICAST = 0x1, 0x8, 0x1000
_PATIENCE_S = 2.0


def resolve(host: str) -> list[str]:
    """Return a name's IPv4 addresses. Raises OSError if it has none."""
    return sorted({str(each[4][0]) for each in socket.getaddrinfo(host, None, socket.AF_INET)})


def is_local(address: str) -> bool:
    """Return whether an IPv4 address belongs to this machine, so that a server can listen on it."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind((address, 0))
        except OSError:
            return False
    return True


def answers(host: str, port: int) -> str:
    """Return why a host and port refuse a TCP connection; empty if they accept it."""
    try:
        socket.create_connection((host, port), _PATIENCE_S).close()
    except (OSError, UnicodeError, OverflowError) as error:
        return getattr(error, "strerror", None) or str(error) or type(error).__name__
    return ""


def multicast(sys: Path) -> Iterator[Finding]:
    """Judge the network interfaces, from ``/sys/class/net``."""
    good, local = [], False
    for folder in sorted((sys / "class/net").iterdir()):
        try:
            flags = int((folder / "flags").read_text(encoding="ascii"), 16)
        except (OSError, ValueError):
            continue
        if flags & _LOOPBACK:
            local = bool(flags & _UP)
        elif flags & _UP and flags & _MULTICAST:
            good.append(folder.name)
    what, command = "no interface is up, not even loopback", "sudo ip link set lo up"
    if local:
        what = "no active interface other than loopback supports multicast: only local nodes can be found"
        command = "ip link"
    yield judged("DOC407", "" if good else what, f"multicast interfaces: {', '.join(good)}", command=command)


def receive_buffers(topics: Sequence[TopicPlan], root: Path, *, cyclone: bool) -> Iterator[Finding]:
    """Judge whether each topic's largest message fits into its subscribers' buffers.

    Subscribers in ROS are assumed to have this machine's settings; ``root`` contains ``proc``;
    ``cyclone``: the bridge itself uses Cyclone DDS, otherwise Fast DDS.
    """
    default = default_buffer(root)
    if not default:
        what = "net.core.rmem_default cannot be read in this environment"
        yield found("DOC003", what, "Run the doctor outside the container.")
        return
    ours = cyclone_buffer(root) if cyclone else default
    large, needed, level = [], 0, Level.NOTE
    for plan in topics:
        # Counts above a capacity read as the capacity, so this is the largest message.
        size = len(Codec(plan.layout, Wire.CDR).encode(b"\xff" * plan.layout.size))
        buffer = ours if plan.direction is Direction.TO_PLC else default
        if size > largest_message(buffer):
            large.append(f"{plan.topic} (up to {size} bytes, buffer {buffer})")
            needed = max(needed, size)
            level = level if plan.qos.reliability == "reliable" else Level.WARNING
    wanted = max(1 << 22, 1 << needed.bit_length() + 1)
    command = f"sudo sysctl -w net.core.rmem_default={wanted} net.core.rmem_max={wanted}"
    seen = f"messages may be larger than the receive buffer: {listed(large)}" if large else ""
    well = "the largest messages fit into the receive buffers"
    yield judged("DOC411", seen, well, command=command, level=level)


def no_master(uri: str) -> str:
    """Return why the server is not a ROS master; empty if it is one, or if ROS 1 is not installed."""
    try:
        from rosplc.ros.rospy.master import Master, UnreachableError
    except ImportError:
        return ""
    server = Master(uri, "/rosplc_doctor", _PATIENCE_S)
    try:
        server.setting("/run_id")
    except UnreachableError as error:
        return str(error)
    finally:
        server.close()
    return ""


def master(
    uri: str, *, call: Callable[[str, int], str] = answers, ask: Callable[[str], str] = no_master
) -> Iterator[Finding]:
    """Judge whether the ROS master answers.

    ``call`` returns why a host and port do not answer, ``ask`` why the server is not a ROS master; both
    return an empty text if there is no problem.
    """
    try:
        parts = urlsplit(uri)
        host, port = parts.hostname, parts.port
    except ValueError:
        host = port = None
    if not host or not port or parts.scheme != "http":
        what = f"ROS_MASTER_URI is {uri!r}; it must be an address such as http://localhost:11311"
        yield found("DOC403", what, command="export ROS_MASTER_URI=http://localhost:11311")
        return
    what = f"nothing answers at {uri}: {reason}" if (reason := call(host, port)) else ""
    if not what and (reason := ask(uri)):
        what = f"the server at {uri} is not a ROS master: {reason}"
    yield judged("DOC408", what, f"the ROS master answers at {uri}", command="roscore")


def routers(locators: Sequence[str], *, call: Callable[[str, int], str] = answers) -> Iterator[Finding]:
    """Judge whether Zenoh routers, as ``tcp/localhost:7447``, answer; ``call`` as for :func:`master`."""
    for locator in locators:
        protocol, _, address = locator.partition("/")
        host, _, rest = address.rpartition(":")
        port = rest.partition("?")[0].partition("#")[0]
        if protocol not in ("tcp", "tls", "ws") or not port.isdigit():
            what = f"cannot check whether a router answers at {locator}"
            yield found("DOC003", what, "No action needed: the bridge reports whether it connects.")
            continue
        reason = call(host.strip("[]"), int(port))
        what = f"nothing answers at {locator}: {reason}" if reason else ""
        command = "ros2 run rmw_zenoh_cpp rmw_zenohd"
        yield judged("DOC409", what, f"a router answers at {locator}", command=command)
