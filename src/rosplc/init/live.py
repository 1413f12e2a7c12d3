"""A running robot: its graph, seen through one of the bridge's backends; and other DDS domains in use."""

from __future__ import annotations

import contextlib
import os
import re
import select
import socket
import struct
import time
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Literal

from rosplc.bridge.ros_side import LiveTypes, RosSide
from rosplc.config import Config
from rosplc.errors import BackendError, RosplcError
from rosplc.harmless import plural
from rosplc.init.found import Call, Found, Meter, Seen, Topic
from rosplc.init.learn import Definitions, learn
from rosplc.init.propose import is_of_ros_itself
from rosplc.model import DISTROS, TypeStore
from rosplc.ros import ROS1, Choice, EndpointInfo, GraphInfo, Qos, choose, settled_graph

NODE = "rosplc_init"
_ANY = "*"  # what ROS 1's master says where nobody has told the type
_NAMELESS = "?"
_UNREACHABLE = ("ROS014", "ROS016")
_PAUSE_S = 0.1
_DDS = ("ROS_AUTOMATIC_DISCOVERY_RANGE", "ROS_STATIC_PEERS", "ROS_LOCALHOST_ONLY", "CYCLONEDDS_URI")
_LEADS_THERE = {
    "dds": _DDS,
    "rclpy": (*_DDS, "ROS_DISCOVERY_SERVER", "FASTRTPS_DEFAULT_PROFILES_FILE", "RMW_IMPLEMENTATION"),
    "zenoh": ("ZENOH_SESSION_CONFIG_URI", "ZENOH_CONFIG_OVERRIDE"),
    "rospy": ("ROS_MASTER_URI", "ROS_IP", "ROS_HOSTNAME"),
}
"""Environment variables that have no key in a configuration."""
_OF_EACH_NODE = ("rcl_interfaces/", "type_description_interfaces/", "lifecycle_msgs/")
"""Packages of the services that nodes have for their parameters and state."""
_SHOW_S = 1.0
_LISTEN_S = 3.0  # to other domains
_SETTLE_S = 1.0  # how long kept messages may take to be delivered; not more than a quarter of the listening


def distro_here(backend: str, environment: Mapping[str, str]) -> tuple[str, str]:
    """Return the ROS distribution to start with, and the reason."""
    named = environment.get("ROS_DISTRO", "")
    if backend == "rospy":
        return ROS1, "the rospy backend is for ROS 1"
    if named in DISTROS and not (named == ROS1 and backend in ("dds", "rclpy", "zenoh")):
        return named, "set by ROS_DISTRO"
    if backend == "auto" and environment.get("ROS_MASTER_URI"):
        return ROS1, "ROS_MASTER_URI is set, which indicates ROS 1"
    return "jazzy", "the default; the environment specifies no other distribution"


class LiveRobot:
    """The ROS graph of a running robot, to which nothing is published.

    ``ros`` are the given keys of the configuration's section ``ros``, such as ``backend``; ``folders``
    have the user's ``.msg`` files. Discovery takes at most ``seconds`` and waits for the topics ``needed``.
    Raises BackendError: ROS001, no backend is installed; ROS002, the middleware reports an error; ROS014 or
    ROS016, the master or router does not answer; ROS020, nothing was found.
    """

    def __init__(
        self,
        ros: Mapping[str, object],
        folders: Sequence[Path] = (),
        seconds: float = 5.0,
        needed: Collection[str] = (),
    ) -> None:
        given = "distro" in ros
        distro, why_distro = distro_here(str(ros.get("backend", "auto")), os.environ)
        keys: dict[str, object] = {"backend": "auto", "distro": distro, **ros}
        distro = str(keys["distro"])
        side = RosSide(Config.from_dict({"ros": {**keys, "node_name": NODE}}))
        self.definitions = Definitions(distro, folders)
        self._types = LiveTypes(self.definitions.store)
        self._backend, choice = side.open(self._types)
        try:
            info = settled_graph(self._backend.graph, seconds, needed)
            graph = f"domain {getattr(self._backend, 'domain', os.environ.get('ROS_DOMAIN_ID') or 0)}"
            if self._backend.name == "rospy":
                graph = f"the graph of {os.environ.get('ROS_MASTER_URI') or 'http://localhost:11311'}"
            where = f"{graph} (backend {choice.name})"
            self._refuse_nobody(info, where, seconds)
            why = {"distro": "as requested" if given else why_distro}
            self.found = Found(_topics(info), where, keys, why, calls=tuple(_calls(info)))
            self._keep_environment(keys, choice)
        except BaseException:
            self._backend.close()
            raise

    def _keep_environment(self, keys: dict[str, object], choice: Choice) -> None:
        """Record the settings from this terminal's environment, which a service will not have."""
        why = dict(self.found.why)
        if keys["backend"] == "auto":
            plain = bool(keys.get("zenoh"))
            with contextlib.suppress(BackendError):
                plain = plain or choose(str(keys["distro"]), {}).name == choice.name
            why["backend"] = f"{'chosen here: ' if plain else ''}{choice.name}, because {choice.why}"
            if not plain:
                keys["backend"], why["backend"] = choice.name, choice.why
        if (
            choice.name != "rospy"
            and "domain" not in keys
            and (domain := getattr(self._backend, "domain", 0))
        ):
            keys["domain"], why["domain"] = domain, "set by ROS_DOMAIN_ID"
        notes = self.found.notes
        if present := [name for name in _LEADS_THERE.get(choice.name, ()) if os.environ.get(name)]:
            words = f"{', '.join(present)} {'is' if len(present) == 1 else 'are'} set in this shell"
            more = "a bridge that is started elsewhere, such as a service, needs the same settings."
            notes = (*notes, f"{words}: {more}")
        self.found = replace(self.found, why=why, notes=notes)

    def learn(self, topic: str, type_name: str) -> None:
        """Make sure that a topic's type is known; raises RosplcError if it is not, or if it is wrong."""
        learn(self.definitions, self._backend, topic, type_name)
        self._types.store = self.definitions.store
        self._compare(topic, type_name)

    def _compare(self, topic: str, type_name: str) -> None:
        """Add a note if the nodes of a topic announce a definition that differs from ours."""
        hashes = self.found.topics[topic].hashes if topic in self.found.topics else ()
        silent, ours = ("humble", ROS1), self._types.distro
        if not hashes or ours in silent or self._types.type_hash(type_name) in hashes:
            return
        also = [name for name in DISTROS if name not in silent and _hash(name, type_name) in hashes]
        hint = f"; with --distro {' or '.join(also)}, they match" if also else ""
        note = f"{topic}: the robot's definition of {type_name} differs from that of {ours}{hint}."
        self.found = replace(self.found, notes=(*self.found.notes, note))

    def listen(
        self, wanted: Mapping[str, str], seconds: float, progress: Callable[[str], None]
    ) -> dict[str, Seen]:
        """Subscribe for ``seconds`` and return measurements of the messages of these topics (name → type).

        ``progress`` is called about once per second with a text that shows the progress.
        """
        meters: dict[str, Meter] = {}
        trouble: dict[str, str] = {}
        with contextlib.ExitStack() as stack:
            subscriptions: dict[str, Any] = {}
            for topic, type_name in wanted.items():
                known = self.found.topics.get(topic)
                qos = matching(known.offered if known else (), depth=1000)
                settle_s = min(_SETTLE_S, seconds / 4) if qos.durability == "transient_local" else 0.0
                meter = meters[topic] = Meter(self.definitions.store, type_name, int(settle_s * 1e9))
                try:
                    made = self._backend.subscribe(topic, type_name, qos, partial(_take, meter))
                except RosplcError as error:
                    trouble[topic] = f"{error.what} [{error.code}]"
                    continue
                subscriptions[topic] = made
                stack.callback(made.close)
            started, shown = time.monotonic(), 0.0
            while subscriptions and (left := seconds - (time.monotonic() - started)) > 0:
                if time.monotonic() - shown >= _SHOW_S:
                    shown = time.monotonic()
                    progress(f"Listening to {plural(len(subscriptions), 'topic')}, {left:.0f} s left")
                time.sleep(min(_PAUSE_S, left))
            for topic, subscription in subscriptions.items():
                trouble[topic] = subscription.status().reason
            # ROS 1 tells who latches only to those who are connected.
            now, before = _topics(self._backend.graph()), self.found.topics
            offers = {
                name: replace(before[name], offered=now[name].offered)
                for name in subscriptions
                if name in before and name in now and now[name].offered
            }
            self.found = replace(self.found, topics={**before, **offers})
        return {topic: meter.finish(seconds, trouble.get(topic, "")) for topic, meter in meters.items()}

    def _refuse_nobody(self, info: GraphInfo, where: str, seconds: float) -> None:
        """Raise the reason if nothing was found: no answer from the master or router, or no node."""
        if info.endpoints:
            return
        subscription = self._backend.subscribe(f"/{NODE}", "std_msgs/msg/Empty", Qos(), lambda *_: None)
        try:
            status = subscription.status()
        finally:
            subscription.close()
        if status.code in _UNREACHABLE:
            raise BackendError(status.code, status.reason)
        what = f"{plural(len(info.nodes), 'node')} but no topics were" if info.nodes else "no node was"
        raise BackendError("ROS020", f"{what} found in {where} within {seconds:g} s{elsewhere(where)}")

    def close(self) -> None:
        """Leave the graph."""
        self._backend.close()


def matching(offered: Collection[Qos], depth: int) -> Qos:
    """Return a quality of service that matches every publisher and requests messages they have kept."""
    reliable = all(qos.reliability == "reliable" for qos in offered)
    latched = bool(offered) and all(qos.durability == "transient_local" for qos in offered)
    kept: Literal["transient_local", "volatile"] = "transient_local" if latched else "volatile"
    return Qos("reliable" if reliable else "best_effort", kept, depth=depth)


def _take(meter: Meter, data: bytes, _: int) -> None:
    # By our own clock: how regular a topic is where the bridge would be, whatever the sender's clock shows.
    meter.take(data, time.monotonic_ns())


def _hash(distro: str, type_name: str) -> str:
    store = TypeStore.bundled(distro)
    return store.type_hash(type_name) if type_name in store else ""


def _topics(info: GraphInfo) -> dict[str, Topic]:
    ends: dict[str, list[EndpointInfo]] = {}
    for end in info.endpoints:
        ends.setdefault(end.topic, []).append(end)
    return {
        name: Topic(
            name=name,
            types=tuple(sorted({end.type_name for end in parts} - {_ANY})),
            publishers=_names(end for end in parts if end.direction == "out"),
            subscribers=_names(end for end in parts if end.direction == "in"),
            offered=tuple(dict.fromkeys(end.qos for end in parts if end.direction == "out")),
            hashes=tuple(dict.fromkeys(end.type_hash for end in parts if end.type_hash)),
        )
        for name, parts in sorted(ends.items())
    }


def _calls(info: GraphInfo) -> Iterator[Call]:
    """Yield services and actions whose type is in the graph."""
    ends: dict[tuple[Literal["service", "action"], str, str], list[EndpointInfo]] = {}
    for end in info.services:
        name, is_action, _ = end.topic.partition("/_action/send_goal")
        type_name = end.type_name.removesuffix("_SendGoal") if is_action else end.type_name
        own = type_name.startswith(_OF_EACH_NODE) or "/_action/" in name
        if type_name != _ANY and not own and not is_of_ros_itself(name):
            ends.setdefault(("action" if is_action else "service", name, type_name), []).append(end)
    for (kind, name, type_name), parts in sorted(
        ends.items(), key=lambda item: (item[0][0] == "action", item[0])
    ):
        servers, clients = (_names(end for end in parts if end.direction == way) for way in ("in", "out"))
        why = (
            f"served by {', '.join(servers)}"
            if servers
            else f"called by {', '.join(clients)}, but served by no node"
        )
        yield Call(kind, name, type_name, "ros" if servers else "plc", why)


def _names(ends: Any) -> tuple[str, ...]:
    return tuple(sorted({end.node or _NAMELESS for end in ends}))


_GROUP = "239.255.0.1"
_BASE, _GAIN, _LAST = 7400, 250, 101
"""RTPS 2.5, 9.6.1: the port of a domain's multicast discovery; above 101, the kernel assigns these ports."""
_PORTS = {_BASE + _GAIN * domain: domain for domain in range(_LAST + 1)}


def elsewhere(where: str) -> str:
    """Return a clause with other domains that have DDS nodes; empty if none were seen.

    ``where`` counts only if it begins with "domain" and a number; nodes of other machines are included.
    """
    looked_at = re.match(r"domain (\d+)", where)
    if looked_at is None:
        return ""
    others = sorted(domains_in_use(_LISTEN_S) - {int(looked_at[1])})
    if not others:
        return ""
    named = ", ".join(map(str, others[:5])) + (" and others" if len(others) > 5 else "")
    return f"; nodes were seen in domain {named}: set ROS_DOMAIN_ID or ros.domain"


def domains_in_use(seconds: float, proc: Path = Path("/proc")) -> set[int]:
    """Return the domains of this machine's DDS programs, and of others that announce themselves in time."""
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
