"""Interfaces, and whether somebody answers where a bridge would call."""

from __future__ import annotations

import socket
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from urllib.parse import urlsplit

from rosplc.codec import Codec, Wire
from rosplc.config import TopicPlan
from rosplc.doctor.finding import Finding, Level, listed
from rosplc.doctor.kinds import found, judged
from rosplc.ros.buffers import cyclone_buffer, default_buffer, largest_message
from rosplc.shm import Direction

_UP, _LOOPBACK, _MULTICAST = 0x1, 0x8, 0x1000
_PATIENCE_S = 2.0


def resolve(host: str) -> list[str]:
    """Return a name's IPv4 addresses. Raises OSError if it has none."""
    return sorted({str(each[4][0]) for each in socket.getaddrinfo(host, None, socket.AF_INET)})


def is_local(address: str) -> bool:
    """Return whether an IPv4 address is this machine's: only such a one can be listened at."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind((address, 0))
        except OSError:
            return False
    return True


def answers(host: str, port: int) -> str:
    """Return why a TCP connection is refused there; empty if it is accepted."""
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
        what = "no interface but loopback is up with multicast: only nodes of this machine can be found"
        command = "ip link"
    yield judged("DOC407", "" if good else what, f"multicast on {', '.join(good)}", command=command)


def receive_buffers(topics: Sequence[TopicPlan], root: Path, *, cyclone: bool) -> Iterator[Finding]:
    """Judge whether each topic's largest message fits into its subscribers' buffers.

    Towards ROS, subscribers are taken to have this machine's settings; ``root`` contains ``proc``;
    ``cyclone``: the bridge itself uses Cyclone DDS, otherwise Fast DDS.
    """
    default = default_buffer(root)
    if not default:
        what = "not visible from here: net.core.rmem_default"
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
    seen = f"larger than a receive buffer: {listed(large)}" if large else ""
    well = "the largest messages fit into the sockets' receive buffers"
    yield judged("DOC411", seen, well, command=command, level=level)


def no_master(uri: str) -> str:
    """Return why what answers there is no ROS master; empty if it is one, or ROS 1 is not installed."""
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

    ``call`` returns why a host and port do not answer, ``ask`` why that is no master; both empty if all is
    well.
    """
    try:
        parts = urlsplit(uri)
        host, port = parts.hostname, parts.port
    except ValueError:
        host = port = None
    if not host or not port or parts.scheme != "http":
        what = f"ROS_MASTER_URI is {uri!r}; it is something like http://localhost:11311"
        yield found("DOC403", what, command="export ROS_MASTER_URI=http://localhost:11311")
        return
    what = f"nobody answers at {uri}: {reason}" if (reason := call(host, port)) else ""
    if not what and (reason := ask(uri)):
        what = f"what answers at {uri} is no ROS master: {reason}"
    yield judged("DOC408", what, f"the ROS master answers at {uri}", command="roscore")


def routers(locators: Sequence[str], *, call: Callable[[str, int], str] = answers) -> Iterator[Finding]:
    """Judge whether Zenoh routers, as ``tcp/localhost:7447``, answer; ``call`` as for :func:`master`."""
    for locator in locators:
        protocol, _, address = locator.partition("/")
        host, _, rest = address.rpartition(":")
        port = rest.partition("?")[0].partition("#")[0]
        if protocol not in ("tcp", "tls", "ws") or not port.isdigit():
            what = f"not visible from outside: whether somebody answers at {locator}"
            yield found("DOC003", what, "Nothing; the bridge will say.")
            continue
        reason = call(host.strip("[]"), int(port))
        what = f"nobody answers at {locator}: {reason}" if reason else ""
        command = "ros2 run rmw_zenoh_cpp rmw_zenohd"
        yield judged("DOC409", what, f"somebody answers at {locator}", command=command)
