"""The variables that decide where in the ROS world a bridge started here would be."""

from __future__ import annotations

import ipaddress
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

from rosplc.doctor.finding import Finding
from rosplc.doctor.kinds import kind
from rosplc.doctor.words import listed

__all__ = ["Wish", "addresses", "distro", "domain", "middleware", "reach", "values"]

_MAX_DOMAIN = 232
_RANGES = ("SUBNET", "LOCALHOST", "OFF", "SYSTEM_DEFAULT")


@dataclass(frozen=True)
class Wish:
    """What the configuration says about ROS.

    Attributes:
        distro: Its distribution.
        ros1: Whether that is ROS 1.
        backend: The backend that it leads to; empty if that is not known.
        domain: The domain that it names; None if it names none.
    """

    distro: str
    ros1: bool
    backend: str = ""
    domain: int | None = None


def distro(environment: Mapping[str, str], wish: Wish | None) -> Iterator[Finding]:
    """Compare the shell's ROS distribution with the configuration's."""
    here = environment.get("ROS_DISTRO", "")
    if not here:
        yield kind("DOC401").fine("ROS_DISTRO is not set: no ROS installation is sourced, and none is needed")
    elif wish is None or here == wish.distro:
        yield kind("DOC401").fine(f"ROS_DISTRO is {here}")
    else:
        what = f"ROS_DISTRO is {here}, the configuration's ros.distro is {wish.distro}"
        yield kind("DOC401").found(
            what, f"Write `ros: {{distro: {here}}}`, or source the other's setup.bash."
        )


def values(environment: Mapping[str, str], wish: Wish | None) -> Iterator[Finding]:
    """Judge whether ROS knows the variables' values."""
    wrong = []
    if wish is None or not wish.ros1:
        number = environment.get("ROS_DOMAIN_ID", "")
        digits = number.isascii() and number.isdigit() and len(number) < 10
        if number and not (digits and int(number) <= _MAX_DOMAIN):
            wrong.append(("ROS_DOMAIN_ID", number, f"a number from 0 to {_MAX_DOMAIN}"))
        local = environment.get("ROS_LOCALHOST_ONLY", "")
        if local not in ("", "0", "1"):
            wrong.append(("ROS_LOCALHOST_ONLY", local, "0 or 1"))
        reach_ = environment.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "")
        if reach_ and reach_ not in _RANGES:
            wrong.append(("ROS_AUTOMATIC_DISCOVERY_RANGE", reach_, f"one of {', '.join(_RANGES)}"))
    for name, value, right in wrong:
        yield kind("DOC403").found(f"{name} is {value!r}; it is {right}", command=f"unset {name}")
    if not wrong:
        yield kind("DOC403").fine("ROS's variables have values that ROS knows")


def domain(environment: Mapping[str, str], wish: Wish | None) -> Iterator[Finding]:
    """Compare the domains of shell and configuration."""
    here = environment.get("ROS_DOMAIN_ID", "") or "0"
    if wish is not None and wish.ros1:
        return
    if wish is None or wish.domain is None:
        yield kind("DOC402").fine(f"ROS domain {here}")
    elif str(wish.domain) == here:
        yield kind("DOC402").fine(f"ROS domain {here}, in the shell and in the configuration")
    else:
        what = f"the configuration's ros.domain is {wish.domain}; nodes from this shell are in domain {here}"
        yield kind("DOC402").found(what, command=f"export ROS_DOMAIN_ID={wish.domain}")


def middleware(environment: Mapping[str, str], wish: Wish | None) -> Iterator[Finding]:
    """Compare RMW_IMPLEMENTATION with the backend."""
    rmw = environment.get("RMW_IMPLEMENTATION", "").strip()
    word = f"RMW_IMPLEMENTATION is {rmw}" if rmw else "RMW_IMPLEMENTATION is not set, so nodes speak DDS"
    if wish is None or wish.ros1 or not wish.backend or wish.backend in ("rclpy", "memory"):
        yield kind("DOC404").fine(
            word if wish is None or not wish.ros1 else "ROS 1 has no RMW_IMPLEMENTATION"
        )
        return
    if (wish.backend == "zenoh") == (rmw == "rmw_zenoh_cpp"):
        yield kind("DOC404").fine(f"{word}, as backend {wish.backend} does")
    elif wish.backend == "zenoh":
        what = f"{word}, and the backend is zenoh"
        yield kind("DOC404").found(what, command="export RMW_IMPLEMENTATION=rmw_zenoh_cpp")
    else:
        what = f"{word}, and the backend is {wish.backend}"
        yield kind("DOC404").found(what, "Write `ros: {backend: zenoh}`, or start the nodes without it.")


def reach(environment: Mapping[str, str], wish: Wish | None) -> Iterator[Finding]:
    """Tell what limits discovery."""
    if wish is not None and (wish.ros1 or wish.backend == "zenoh"):
        return
    if environment.get("ROS_LOCALHOST_ONLY") == "1":
        yield kind("DOC405").found("ROS_LOCALHOST_ONLY=1: only nodes of this machine are found")
        return
    range_ = environment.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "")
    peers = environment.get("ROS_STATIC_PEERS", "")
    if range_ == "OFF":
        yield kind("DOC405").found(
            "ROS_AUTOMATIC_DISCOVERY_RANGE=OFF: no node is found",
            "Unset it.",
            "unset ROS_AUTOMATIC_DISCOVERY_RANGE",
        )
    elif range_ == "LOCALHOST":
        more = f", and those at {peers}" if peers else ""
        yield kind("DOC405").found(
            f"ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST: nodes of this machine{more} are found"
        )
    else:
        yield kind("DOC405").fine(f"discovery reaches the subnet{f' and {peers}' if peers else ''}")


def addresses(
    environment: Mapping[str, str],
    wish: Wish | None,
    *,
    resolve: Callable[[str], list[str]],
    is_local: Callable[[str], bool],
) -> Iterator[Finding]:
    """Judge the hosts that ROS was given.

    Args:
        environment: The variables.
        wish: The configuration's ROS side; None without one.
        resolve: Returns a name's IPv4 addresses; raises OSError if it has none.
        is_local: Whether an address is this machine's.
    """
    if wish is None or not wish.ros1:
        peers = [peer.strip() for peer in environment.get("ROS_STATIC_PEERS", "").split(";") if peer.strip()]
        yield from _resolved([("ROS_STATIC_PEERS", peer.partition(":")[0]) for peer in peers], resolve)
    if wish is None or not wish.ros1:
        return
    name, text = next(
        ((key, environment[key]) for key in ("ROS_HOSTNAME", "ROS_IP") if environment.get(key)), ("", "")
    )
    if not text:
        yield kind("DOC410").fine("other nodes are told this machine's own name (no ROS_IP, no ROS_HOSTNAME)")
        return
    try:
        found = [str(ipaddress.ip_address(text))]
    except ValueError:
        try:
            found = resolve(text)
        except (OSError, UnicodeError):
            yield kind("DOC406").found(f"{name}={text} has no address")
            return
    if any(is_local(address) for address in found):
        yield kind("DOC410").fine(f"{name}={text} is an address of this machine")
    else:
        yield kind("DOC410").found(f"{name}={text} is no address of this machine", command=f"unset {name}")


def _resolved(hosts: list[tuple[str, str]], resolve: Callable[[str], list[str]]) -> Iterator[Finding]:
    bad = []
    for name, host in hosts:
        try:
            resolve(host)
        except (OSError, UnicodeError):
            bad.append(f"{host} ({name})")
    if bad:
        yield kind("DOC406").found(
            f"no address: {listed(bad)}", command=f"getent hosts {bad[0].split(' ')[0]}"
        )
    elif hosts:
        yield kind("DOC406").fine("names in ROS_STATIC_PEERS have addresses")
