"""The session's configuration: defaults, options, files, environment."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("zenoh")

from rosplc.errors import BackendError
from rosplc.model import TypeStore
from rosplc.ros import DEFAULT, open_backend
from rosplc.ros._base import domain_number as domain_id
from rosplc.ros.zenoh.backend import session_config

STRING = "std_msgs/msg/String"


def value(config: Any, path: str) -> Any:
    return json.loads(config.config.get_json(path))


def test_defaults_are_rmw_zenohs() -> None:
    """A peer that connects to a router on this machine, with gossip and without multicast."""
    config = session_config({}, {})
    assert (config.mode, config.endpoints) == ("peer", ("tcp/localhost:7447",))
    assert value(config, "scouting/multicast/enabled") is False
    assert value(config, "scouting/gossip/enabled") is True
    assert value(config, "listen/endpoints") == ["tcp/localhost:0"]


def test_what_comes_later_wins(tmp_path: Path) -> None:
    """File of the environment, file of the configuration, its keys, and the environment's override."""
    first, second = tmp_path / "a.json5", tmp_path / "b.json5"
    first.write_text('{mode: "client", connect: {endpoints: ["tcp/10.0.0.1:7447"]}}')
    second.write_text('{mode: "peer", connect: {endpoints: ["tcp/10.0.0.2:7447"]}}')
    variables = {"ZENOH_SESSION_CONFIG_URI": str(first)}
    assert session_config({}, variables).endpoints == ("tcp/10.0.0.1:7447",)
    assert session_config({"config": str(second)}, variables).endpoints == ("tcp/10.0.0.2:7447",)
    options = {"config": str(second), "connect": ["tcp/10.0.0.3:7447"]}
    assert session_config(options, variables).endpoints == ("tcp/10.0.0.3:7447",)
    variables["ZENOH_CONFIG_OVERRIDE"] = 'connect/endpoints=["tcp/10.0.0.4:7447"];mode="client"'
    config = session_config(options, variables)
    assert (config.endpoints, config.mode) == (("tcp/10.0.0.4:7447",), "client")


@pytest.mark.parametrize(
    ("options", "where"),
    [
        ({"router": "x"}, "router"),
        ({"mode": "router"}, "mode"),
        ({"connect": 7447}, "connect"),
        ({"connect": ["localhost"]}, "connect"),
        ({"listen": [7447]}, "listen"),
        ({"config": "/nowhere/zenoh.json5"}, "config"),
        ({"config": 5}, "config"),
    ],
)
def test_bad_options_are_named(options: dict[str, object], where: str) -> None:
    """A wrong key or value is refused with its place."""
    with pytest.raises(BackendError, match="ROS013") as refused:
        session_config(options, {})
    assert refused.value.where == f"ros.zenoh.{where}"


@pytest.mark.parametrize(
    "variables",
    [
        {"ZENOH_SESSION_CONFIG_URI": "/nowhere/zenoh.json5"},
        {"ZENOH_CONFIG_OVERRIDE": "mode"},
        {"ZENOH_CONFIG_OVERRIDE": "no/such/key=1"},
        {"ZENOH_CONFIG_OVERRIDE": "mode=nonsense"},
    ],
)
def test_bad_environment_is_named(variables: dict[str, str]) -> None:
    """A variable that cannot be used is refused with its name."""
    with pytest.raises(BackendError, match="ROS010") as refused:
        session_config({}, variables)
    assert refused.value.where in variables


def test_domain() -> None:
    """The domain comes from the argument, then from the environment, then it is 0."""
    assert domain_id(5, {"ROS_DOMAIN_ID": "6"}) == 5
    assert domain_id(None, {"ROS_DOMAIN_ID": "6"}) == 6
    assert domain_id(None, {}) is None
    with pytest.raises(BackendError, match="ROS010"):
        domain_id(None, {"ROS_DOMAIN_ID": "six"})


@pytest.mark.parametrize("mode", ["peer", "client"])
def test_starts_without_a_router_and_says_so(mode: str) -> None:
    """The backend opens though no router answers, and every endpoint names what is missing."""
    options = {"mode": mode, "connect": ["tcp/127.0.0.1:1"]}
    node = open_backend("zenoh", TypeStore.bundled("jazzy"), "cell", options=options, environment={})
    try:
        publisher = node.advertise("/chatter", STRING, DEFAULT)
        status = publisher.status()
        assert (status.code, status.reason) == ("ROS016", "no Zenoh router answers at tcp/127.0.0.1:1")
    finally:
        node.close()
