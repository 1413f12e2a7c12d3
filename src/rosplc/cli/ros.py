"""``rosplc list``, ``echo``, ``hz``, ``pub``: ROS topics without a ROS installation, as in ros2cli."""

from __future__ import annotations

import contextlib
import itertools
import logging
import os
import queue
import statistics
import time
from collections import deque
from collections.abc import Iterable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Annotated, Any

import typer
import yaml

from rosplc.bridge.ros_side import LiveTypes, RosSide
from rosplc.cli.options import default_config
from rosplc.cli.ros_text import Writer, as_python, as_yaml
from rosplc.cli.text import print_json, say, warn
from rosplc.cli.verb import Between, verb
from rosplc.config import Config, read_config
from rosplc.errors import RosplcError
from rosplc.init.learn import Definitions, learn
from rosplc.init.live import distro_here, matching
from rosplc.model.parse import full_name
from rosplc.ros import EndpointInfo, Qos, settled_graph
from rosplc.ros.fields import unpack_whole

_LOOK_S = 5.0  # how long to look for a topic at most; the graph is complete earlier where it is small
_WINDOW = 10_000

_Backend = Annotated[str | None, typer.Option(metavar="NAME", help="The ROS backend, as in `ros.backend`.")]
_Distro = Annotated[str | None, typer.Option(metavar="NAME", help="The ROS distribution.")]
_Domain = Annotated[int | None, typer.Option(metavar="NUMBER", help="The ROS domain.")]
_Types = Annotated[
    list[Path] | None, typer.Option(metavar="FOLDER", help="A folder with .msg files; may be repeated.")
]
_EPILOG = """

Backend, distribution, domain and types come from the options, else from `./rosplc.yaml`, else from the
environment (`ROS_DISTRO`, `ROS_DOMAIN_ID`).
"""


class _Node:
    """A node of its own in the graph, and the types that it knows."""

    def __init__(
        self, backend: str | None, distro: str | None, domain: int | None, types: list[Path] | None
    ) -> None:
        logging.getLogger("rosplc").addHandler(logging.NullHandler())
        keys: dict[str, Any] = {}
        folders = list(types or ())
        if (path := default_config()) is not None:
            config = read_config(path)
            left_out = {"node_name", "namespace", "remap"}
            keys = config.settings.ros.model_dump(exclude_unset=True, exclude=left_out)
            folders += config.type_folders
        given = {"backend": backend, "distro": distro, "domain": domain}
        keys |= {key: value for key, value in given.items() if value is not None}
        if "distro" not in keys:
            keys["distro"] = distro_here(keys.get("backend", "auto"), os.environ)[0]
        side = RosSide(Config.from_dict({"ros": {**keys, "node_name": f"rosplc_cli_{os.getpid()}"}}))
        self.definitions = Definitions(keys["distro"], folders)
        self.types = LiveTypes(self.definitions.store)
        self.backend, _ = side.open(self.types)

    def __enter__(self) -> _Node:
        return self

    def __exit__(self, *_: object) -> None:
        self.backend.close()

    def type_of(self, topic: str, named: str | None, hint: str = "") -> str:
        """Return the full name of a topic's type, asked for or seen in the graph; it is known then."""
        if named is None:
            types = self.graph(topic).topics.get(topic, ())
            if len(types) != 1:
                seen = f"has several types: {', '.join(types)}" if types else "was not found in the ROS graph"
                raise typer.BadParameter(f"{topic} {seen}{hint}", param_hint="TOPIC")
            named = types[0]
        name = full_name(named)
        learn(self.definitions, self.backend, topic, name)
        self.types.store = self.definitions.store
        return name

    def graph(self, *topics: str) -> Any:
        return settled_graph(self.backend.graph, _LOOK_S, topics)

    @contextlib.contextmanager
    def messages(self, topic: str, type_name: str) -> Iterator[queue.SimpleQueue[tuple[float, bytes]]]:
        """Receive a topic into a queue of (arrival in s, bytes), with a QoS that its publishers meet."""
        arrived: queue.SimpleQueue[tuple[float, bytes]] = queue.SimpleQueue()
        offered = [
            end.qos for end in self.backend.graph().endpoints if (end.topic, end.direction) == (topic, "out")
        ]

        def take(data: bytes, _: int) -> None:
            arrived.put((time.monotonic(), data))

        subscription = self.backend.subscribe(topic, type_name, matching(offered, depth=100), take)
        try:
            yield arrived
        finally:
            subscription.close()


@verb
def _list(
    *,
    show_types: bool = False,
    count_topics: bool = False,
    services: bool = False,
    actions: bool = False,
    backend: _Backend = None,
    distro: _Distro = None,
    domain: _Domain = None,
    types: _Types = None,
    as_json: bool = False,
) -> None:
    """List the topics, services or actions in the ROS graph.

    Options:
        show_types: Also print the types.
        count_topics: Print only the number of topics.
        services: List services instead.
        actions: List ROS 2 actions instead.
    """
    if services and actions:
        raise typer.BadParameter("use --services or --actions, not both", param_hint="--services")
    with _Node(backend, distro, domain, types) as node:
        graph = node.graph()
    topics = _calls(graph.services, actions) if services or actions else graph.topics
    if as_json:
        print_json({name: list(kinds) for name, kinds in topics.items()})
    elif count_topics:
        say(str(len(topics)))
    else:
        for name, kinds in topics.items():
            say(f"{name} [{', '.join(kinds)}]" if show_types else name)


def _calls(ends: Iterable[EndpointInfo], actions: bool) -> dict[str, list[str]]:
    """Return the names of services or actions and their types, as far as the graph tells them."""
    found: dict[str, set[str]] = {}
    for end in ends:
        name, is_action, _ = end.topic.partition("/_action/send_goal")
        if bool(is_action) == actions and "/_action/" not in name:
            found.setdefault(name, set()).add(end.type_name.removesuffix("_SendGoal" if actions else ""))
    return {name: sorted(filter(None, types)) for name, types in sorted(found.items())}


@verb
def _echo(
    topic: str,
    message_type: str | None = None,
    /,
    *,
    once: bool = False,
    field: str | None = None,
    full_length: bool = False,
    backend: _Backend = None,
    distro: _Distro = None,
    domain: _Domain = None,
    types: _Types = None,
    as_json: bool = False,
) -> None:
    """Print the messages of a ROS topic.

    Options:
        topic: The topic's name.
        message_type: The topic's type; by default from the ROS graph.
        once: Print the first message and exit.
        field PATH: Print only this field.
        full_length: Print long arrays and strings in full.
        as_json: Print one JSON document per line.
    """
    with _Node(backend, distro, domain, types) as node:
        type_name = node.type_of(topic, message_type, "; specify its type after its name")
        with node.messages(topic, type_name) as arrived:
            while True:
                _, data = _next(arrived)
                try:
                    value: Any = unpack_whole(node.definitions.store, type_name, data)
                except RosplcError as error:
                    warn(f"{topic}: {error.what} [{error.code}]")
                    continue
                for part in field.split(".") if field else ():
                    if not isinstance(value, dict) or part not in value:
                        raise typer.BadParameter(f"{type_name} has no field {field}", param_hint="--field")
                    value = value[part]
                if as_json:
                    print_json(value, one_line=True)
                else:
                    say(f"{as_yaml(value, whole=full_length)}\n---")
                if once:
                    return


@verb
def _hz(
    topic: str,
    /,
    *,
    window: Annotated[int, Between(2)] = _WINDOW,
    backend: _Backend = None,
    distro: _Distro = None,
    domain: _Domain = None,
    types: _Types = None,
) -> None:
    """Print the message rate of a ROS topic every second.

    Options:
        topic: The topic's name.
        window: Number of messages to average over.
    """
    with (
        _Node(backend, distro, domain, types) as node,
        node.messages(topic, node.type_of(topic, None)) as arrived,
    ):
        times: deque[float] = deque(maxlen=window)
        shown = time.monotonic()
        while True:
            times.append(_next(arrived)[0])
            if len(times) > 1 and times[-1] - shown >= 1.0:
                shown = times[-1]
                gaps = [after - before for before, after in itertools.pairwise(times)]
                say(f"average rate: {len(gaps) / sum(gaps):.3f}")
                scatter = f"std dev: {statistics.pstdev(gaps):.5f}s window: {len(times)}"
                typer.echo(f"\tmin: {min(gaps):.3f}s max: {max(gaps):.3f}s {scatter}")


def _next(arrived: queue.SimpleQueue[tuple[float, bytes]]) -> tuple[float, bytes]:
    # With a time-out, so that Ctrl-C is seen.
    while True:
        with contextlib.suppress(queue.Empty):
            return arrived.get(timeout=0.1)


@verb
def _pub(
    topic: str,
    message_type: str,
    values: str = "{}",
    /,
    *,
    rate: Annotated[float, typer.Option("--rate", "-r", min=0.001, help="Messages per second.")] = 1.0,
    once: bool = False,
    times: Annotated[int | None, Between(1)] = None,
    wait_matching_subscriptions: Annotated[int | None, Between(0)] = None,
    qos_reliability: str = "reliable",
    qos_durability: str = "volatile",
    qos_depth: int = 10,
    backend: _Backend = None,
    distro: _Distro = None,
    domain: _Domain = None,
    types: _Types = None,
) -> None:
    """Publish messages on a ROS topic.

    Options:
        topic: The topic's name.
        message_type: The topic's type, such as geometry_msgs/msg/Twist.
        values: Fields as YAML; omitted fields have their default values.
        once: Publish one message and exit.
        times: Publish this many messages and exit.
        wait_matching_subscriptions: Wait for this many subscribers; by default 1 with --once or --times,
            else 0.
        qos_reliability: `reliable` or `best_effort`.
        qos_durability: `volatile` or `transient_local`.
        qos_depth: Maximum number of queued messages.
    """
    try:
        given = yaml.safe_load(values) or {}
    except yaml.YAMLError as error:
        raise typer.BadParameter(f"not valid YAML: {error}", param_hint="VALUES") from None
    if not isinstance(given, dict):
        raise typer.BadParameter("give the fields as YAML, such as '{data: 1.5}'", param_hint="VALUES")
    qos = Qos(qos_reliability, qos_durability, qos_depth)  # type: ignore[arg-type]
    most = 1 if once else times
    with _Node(backend, distro, domain, types) as node:
        name = node.type_of(topic, message_type)
        store = node.definitions.store
        message = Writer(store, name, given)
        shown = as_python(store, name, unpack_whole(store, name, message()))
        publisher = node.backend.advertise(topic, name, qos)
        wanted = wait_matching_subscriptions
        wanted = (1 if most else 0) if wanted is None else wanted
        for look in itertools.count():
            if publisher.matched >= wanted:
                break
            if look % 10 == 0:
                say(f"Waiting for at least {wanted} matching subscription(s)...")
            time.sleep(0.1)
        say("publisher: beginning loop")
        due = time.monotonic()
        for number in itertools.count(1):
            publisher.write(message())
            say(f"publishing #{number}: {shown}\n")
            if number == most:
                time.sleep(0.1)  # as ros2cli's --keep-alive: what was written is delivered
                return
            due += 1 / rate
            time.sleep(max(0.0, due - time.monotonic()))


LIST = SimpleNamespace(command=_list, __doc__=f"\n\nrosplc list -t  —  list topics with their types{_EPILOG}")
ECHO = SimpleNamespace(
    command=_echo, __doc__=f"\n\nrosplc echo /cmd_vel --once  —  print the next message{_EPILOG}"
)
HZ = SimpleNamespace(command=_hz, __doc__=f"\n\nrosplc hz /scan  —  print the rate until Ctrl-C{_EPILOG}")
_TWIST = "rosplc pub -r 10 /cmd_vel geometry_msgs/msg/Twist '{linear: {x: 0.5}}'  —  ten messages per second"
PUB = SimpleNamespace(command=_pub, __doc__=f"\n\n{_TWIST}{_EPILOG}")
