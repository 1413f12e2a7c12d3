"""The variables that decide where in the ROS world a bridge started here would be."""

from __future__ import annotations

import ipaddress
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

from rosplc.doctor.finding import Finding, listed
from rosplc.doctor.kinds import fine, found, judged

_MAX_DOMAIN = 232
_RANGES = ("SUBNET", "LOCALHOST", "OFF", "SYSTEM_DEFAULT")


@dataclass(frozen=True)
class Wish:
    """The configuration's ROS settings; ``backend`` empty if not known, ``domain`` None if none is set."""

    distro: str
    ros1: bool
    backend: str = ""
    domain: int | None = None


def distro(environment: Mapping[str, str], wish: Wish | None) -> Iterator[Finding]:
    """Compare the shell's ROS distribution with the configuration's."""
    here = environment.get("ROS_DISTRO", "")
    other = wish is not None and here and here != wish.distro
    seen = f"ROS_DISTRO is {here}, the configuration's ros.distro is {wish.distro}" if wish and other else ""
    unset = "ROS_DISTRO is not set: no ROS installation is sourced, and none is needed"
    remedy = f"Write `ros: {{distro: {here}}}`, or source the other's setup.bash."
    yield judged("DOC401", seen, f"ROS_DISTRO is {here}" if here else unset, remedy)


def values(environment: Mapping[str, str], wish: Wish | None) -> Iterator[Finding]:
    """Judge whether ROS knows the variables' values."""
    rules: tuple[tuple[str, Callable[[str], bool], str], ...] = (
        ("ROS_DOMAIN_ID", _is_domain, f"a number from 0 to {_MAX_DOMAIN}"),
        ("ROS_LOCALHOST_ONLY", ("0", "1").__contains__, "0 or 1"),
        ("ROS_AUTOMATIC_DISCOVERY_RANGE", _RANGES.__contains__, f"one of {', '.join(_RANGES)}"),
    )
    wrong = [
        (name, value, right)
        for name, holds, right in (rules if wish is None or not wish.ros1 else ())
        if (value := environment.get(name, "")) and not holds(value)
    ]
    for name, value, right in wrong:
        yield found("DOC403", f"{name} is {value!r}; it is {right}", command=f"unset {name}")
    if not wrong:
        yield fine("DOC403", "ROS's variables have values that ROS knows")


def _is_domain(text: str) -> bool:
    return text.isascii() and text.isdigit() and len(text) < 10 and int(text) <= _MAX_DOMAIN


def domain(environment: Mapping[str, str], wish: Wish | None) -> Iterator[Finding]:
    """Compare the domains of shell and configuration."""
    here = environment.get("ROS_DOMAIN_ID", "") or "0"
    if wish is not None and wish.ros1:
        return
    if wish is None or wish.domain is None:
        yield fine("DOC402", f"ROS domain {here}")
        return
    what = f"the configuration's ros.domain is {wish.domain}; nodes from this shell are in domain {here}"
    well = f"ROS domain {here}, in the shell and in the configuration"
    command = f"export ROS_DOMAIN_ID={wish.domain}"
    yield judged("DOC402", "" if str(wish.domain) == here else what, well, command=command)


def middleware(environment: Mapping[str, str], wish: Wish | None) -> Iterator[Finding]:
    """Compare RMW_IMPLEMENTATION with the backend."""
    rmw = environment.get("RMW_IMPLEMENTATION", "").strip()
    word = f"RMW_IMPLEMENTATION is {rmw}" if rmw else "RMW_IMPLEMENTATION is not set, so nodes speak DDS"
    if wish is not None and wish.ros1:
        yield fine("DOC404", "ROS 1 has no RMW_IMPLEMENTATION")
    elif wish is None or wish.backend in ("", "rclpy", "memory"):
        yield fine("DOC404", word)
    else:
        zenoh = wish.backend == "zenoh"
        what = "" if zenoh == (rmw == "rmw_zenoh_cpp") else f"{word}, and the backend is {wish.backend}"
        remedy = None if zenoh else "Write `ros: {backend: zenoh}`, or start the nodes without it."
        command = "export RMW_IMPLEMENTATION=rmw_zenoh_cpp" if zenoh else ""
        yield judged("DOC404", what, f"{word}, as backend {wish.backend} does", remedy, command)


def reach(environment: Mapping[str, str], wish: Wish | None) -> Iterator[Finding]:
    """Report what limits discovery."""
    if wish is not None and (wish.ros1 or wish.backend == "zenoh"):
        return
    variable = "ROS_AUTOMATIC_DISCOVERY_RANGE"
    peers = environment.get("ROS_STATIC_PEERS", "")
    if environment.get("ROS_LOCALHOST_ONLY") == "1":
        yield found("DOC405", "ROS_LOCALHOST_ONLY=1: only nodes of this machine are found")
    elif environment.get(variable) == "OFF":
        yield found("DOC405", f"{variable}=OFF: no node is found", "Unset it.", f"unset {variable}")
    else:
        more = f", and those at {peers}" if peers else ""
        local = f"{variable}=LOCALHOST: nodes of this machine{more} are found"
        well = f"discovery reaches the subnet{f' and {peers}' if peers else ''}"
        yield judged("DOC405", local if environment.get(variable) == "LOCALHOST" else "", well)


def addresses(
    environment: Mapping[str, str],
    wish: Wish | None,
    *,
    resolve: Callable[[str], list[str]],
    is_local: Callable[[str], bool],
) -> Iterator[Finding]:
    """Judge the hosts that ROS was given.

    ``resolve`` returns a name's IPv4 addresses, or raises OSError; ``is_local``: an address is this
    machine's.
    """
    if wish is None or not wish.ros1:
        yield from _peers(environment.get("ROS_STATIC_PEERS", ""), resolve)
        return
    name = next((key for key in ("ROS_HOSTNAME", "ROS_IP") if environment.get(key)), "")
    if not name:
        yield fine("DOC410", "other nodes are told this machine's own name (no ROS_IP, no ROS_HOSTNAME)")
        return
    text = environment[name]
    try:
        numbers = [str(ipaddress.ip_address(text))]
    except ValueError:
        try:
            numbers = resolve(text)
        except (OSError, UnicodeError):
            yield found("DOC406", f"{name}={text} has no address")
            return
    seen = "" if any(map(is_local, numbers)) else f"{name}={text} is no address of this machine"
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
        seen = f"no address: {listed(f'{host} (ROS_STATIC_PEERS)' for host in bad)}" if bad else ""
        command = f"getent hosts {bad[0]}" if bad else ""
        yield judged("DOC406", seen, "names in ROS_STATIC_PEERS have addresses", command=command)
