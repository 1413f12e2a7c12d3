"""The command line's ROS arguments, ROS' environment variables, and names of topics and nodes."""

from __future__ import annotations

import logging
from collections.abc import Iterator

from rosplc.errors import BackendError, ChannelError, ConfigError
from rosplc.ros import RosArguments
from rosplc.ros._base import domain_number
from rosplc.ros.arguments import split_arguments
from rosplc.ros.dds.backend import check_peers, domain_config, domain_id
from rosplc.ros.names import resolve_topic
from rosplc.ros.rospy.master import is_node_uri, read_address
from rosplc.ros.zenoh import backend as zenoh
from rosplc.shm import Namespace
from tests.fuzz.choices import Choices
from tests.fuzz.oracle import refusals

__all__ = ["check", "seeds"]

_VARIABLES = (
    "ROS_DOMAIN_ID", "ROS_LOCALHOST_ONLY", "ROS_AUTOMATIC_DISCOVERY_RANGE", "CYCLONEDDS_URI",
    "ROS_MASTER_URI", "ROS_IP", "ROS_HOSTNAME", "ZENOH_SESSION_CONFIG_URI", "ZENOH_CONFIG_OVERRIDE",
)  # fmt: skip
logging.getLogger("zenoh").setLevel(logging.CRITICAL)


def _arguments(choices: Choices) -> None:
    ros, own = split_arguments([choices.text() for _ in range(choices.below(8))])
    assert not any(":=" in argument and not argument.startswith("-") for argument in own)
    with refusals(ConfigError):
        found = RosArguments.parse(ros)
        remapping = found.for_node("rosplc")
        with refusals(BackendError):
            name = resolve_topic(choices.text(), namespace=remapping.namespace or "/", remap=remapping.topics)
            assert name.startswith("/")


def _environment(choices: Choices) -> None:
    environment = {choices.pick(_VARIABLES): choices.text() for _ in range(choices.below(5))}
    distro = choices.pick(("jazzy", "humble"))
    for read in (
        lambda: domain_id(None, environment),
        lambda: domain_config(environment, distro),
        lambda: check_peers(environment, distro),
        lambda: is_node_uri(read_address(environment).master),
        lambda: domain_number(None, environment),
        lambda: zenoh.session_config({}, environment),
    ):
        with refusals(BackendError):
            read()


def _names(choices: Choices) -> None:
    prefix, topic = choices.text(), choices.text()
    with refusals(ChannelError):
        namespace = Namespace(prefix)
        path = namespace.path(topic)
        assert path.parent == namespace.lock_path(topic).parent
        assert len(path.name) <= 80
        assert namespace.name_of(path.name) in (None, (topic, ""))


def check(data: bytes) -> None:
    """Whatever is given, it is refused with a code, or means what ROS says."""
    choices = Choices(data)
    choices.pick((_arguments, _environment, _names))(choices)


def seeds() -> Iterator[bytes]:
    """Usual arguments, variables and names."""
    words = (b"--ros-args", b"-r", b"/a:=/b", b"-p", b"x:=1", b"--log-level", b"debug", b"--")
    yield b"\0\7" + b"\xff".join(words)
    yield b"\0\3" + b"\xff".join((b"__name:=n", b"__ns:=/x", b"a:=b", b"~/c"))
    for number, value in enumerate(
        (b"5", b"1", b"LOCALHOST", b"<CycloneDDS/>", b"http://h:1/", b"10.0.0.1", b"h")
    ):
        yield b"\1\1" + bytes([number]) + value + b"\xff\0"
    yield b'\1\2\x07/dev/null\xff\x08mode="client";connect/endpoints=["tcp/h:1"]\xff\0'
    yield b"\2rosplc\xff/robot1/cmd_vel"
    yield b"\2a\xff/" + b"long_name/" * 20 + b"x"
