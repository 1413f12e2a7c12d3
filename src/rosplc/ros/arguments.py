"""ROS arguments, which ``ros2 run``, ``ros2 launch`` and ``roslaunch`` put on a node's command line.

ROS 2: ``--ros-args -r from:=to -p name:=value … --`` (https://design.ros2.org/articles/ros_command_line_arguments.html).
ROS 1: ``from:=to``, ``__name:=…``, ``_parameter:=value`` among the others (http://wiki.ros.org/Remapping%20Arguments).
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

from rosplc.errors import BackendError, ConfigError
from rosplc.ros.names import resolve_topic, validate_namespace, validate_node_name

_NODE = re.compile(r"[A-Za-z_][A-Za-z0-9_]*\Z")
_PARAMETER = re.compile(r"[A-Za-z0-9_./*-]+\Z")
_LEVELS = ("debug", "info", "warn", "error", "fatal")
_LOGGING = ("rosout-logs", "stdout-logs", "external-lib-logs")
_FLAGS = tuple(f"--{word}-{what}" for word in ("enable", "disable") for what in _LOGGING)
_ENVIRONMENT = {"__master": "ROS_MASTER_URI", "__ip": "ROS_IP", "__hostname": "ROS_HOSTNAME"}


@dataclass(frozen=True, slots=True)
class Remapping:
    """The names of a node after its arguments are applied."""

    topics: Mapping[str, str] = field(default_factory=dict)  # topic → topic; the first rule for a topic holds
    node: str | None = None  # another base name for the node, if given (``__node:=``, ``__name:=``)
    namespace: str | None = None  # another namespace, if given (``__ns:=``)


@dataclass(frozen=True, slots=True)
class RosArguments:
    """Parsed ROS arguments."""

    # remapping rules in their order: node name (empty: any), from, to
    rules: tuple[tuple[str, str, str], ...] = ()
    # variables of ROS 1's environment that arguments replace
    environment: Mapping[str, str] = field(default_factory=dict)
    # what concerns the client library (parameters, enclave, logs), as after ``--ros-args``
    others: tuple[str, ...] = ()
    log_level: str | None = None  # ``debug`` … ``fatal``, if asked for

    @classmethod
    def parse(cls, arguments: Sequence[str]) -> RosArguments:
        """Parse arguments found by :func:`split_arguments`; CFG011 if one is not valid."""
        rules: list[tuple[str, str, str]] = []
        environment: dict[str, str] = {}
        others: list[str] = []
        level: str | None = None
        rest = iter(arguments)
        for argument in rest:
            if argument in ("-r", "--remap"):
                rules.append(_rule(_value(argument, rest)))
            elif argument in ("-p", "--param"):
                others += ["-p", _parameter(_value(argument, rest))]
            elif argument in ("--params-file", "-e", "--enclave", "--log-config-file"):
                others += [argument, _value(argument, rest)]
            elif argument == "--log-level":
                text = _value(argument, rest)
                logger, _, word = text.rpartition(":=")
                if word.lower() not in _LEVELS:
                    raise _refuse(f"--log-level {text}", f"unknown level; use {', '.join(_LEVELS)}")
                others += [argument, text]
                level = level if logger else word.lower()
            elif argument in _FLAGS:
                others.append(argument)
            elif ":=" in argument and not argument.startswith("-"):
                _ros1(argument, rules, environment, others)
            else:
                raise _refuse(argument, "unknown ROS argument; use -- to end the ROS arguments")
        return cls(tuple(rules), environment, tuple(others), level)

    def for_node(self, name: str) -> Remapping:
        """Return what applies to a node with this base name."""
        topics: dict[str, str] = {}
        special: dict[str, str] = {}
        for node, source, target in self.rules:
            if node in ("", name):
                (special if source.startswith("__") else topics).setdefault(source, target)
        return Remapping(topics, special.get("__node"), special.get("__ns"))


def split_arguments(arguments: Sequence[str]) -> tuple[list[str], list[str]]:
    """Separate ROS arguments from a program's own; return both, in order.

    ROS arguments are those between ``--ros-args`` and ``--`` (or the end), and every ``from:=to`` elsewhere.
    """
    ros: list[str] = []
    own: list[str] = []
    inside = False
    for argument in arguments:
        if argument == "--ros-args":
            inside = True
        elif inside and argument == "--":
            inside = False
        elif inside or (":=" in argument and not argument.startswith("-")):
            ros.append(argument)
        else:
            own.append(argument)
    return ros, own


def _refuse(argument: str, why: str) -> ConfigError:
    return ConfigError("CFG011", f"{argument!r}: {why}", where="command line")


def _value(argument: str, rest: Iterator[str]) -> str:
    value = next(rest, "")
    if not value:
        raise _refuse(argument, "the value is missing")
    return value


def _halves(argument: str) -> tuple[str, str]:
    source, arrow, target = argument.partition(":=")
    if not arrow or not source or not target:
        raise _refuse(argument, "a rule has the form from:=to")
    return source, target


def _rule(text: str) -> tuple[str, str, str]:
    source, target = _halves(text)
    node = ""
    source, target = source.removeprefix("rostopic://"), target.removeprefix("rostopic://")
    if ":" in source:
        node, _, source = source.partition(":")
        if not _NODE.match(node):
            raise _refuse(text, f"{node!r} is not a valid node name")
    try:
        if source in ("__node", "__name"):
            return node, "__node", validate_node_name(target)
        if source == "__ns":
            return node, source, validate_namespace(target)
        if source.startswith("__"):
            raise _refuse(text, "unknown special name; use __node, __name or __ns")
        for name in (source, target):
            resolve_topic(name, node_name="node")
    except BackendError as error:
        raise _refuse(text, error.what) from error
    return node, source, target


def _parameter(text: str) -> str:
    name, _ = _halves(text)
    node, _, own = name.rpartition(":")
    if not _PARAMETER.match(own) or (node and not _PARAMETER.match(node)):
        raise _refuse(f"-p {text}", "a parameter has the form name:=value or node:name:=value")
    return text


def _ros1(
    argument: str, rules: list[tuple[str, str, str]], environment: dict[str, str], others: list[str]
) -> None:
    source, target = _halves(argument)
    if source in _ENVIRONMENT:
        environment[_ENVIRONMENT[source]] = target
    elif source == "__ns":
        rules.append(_rule(argument if target.startswith("/") else f"__ns:=/{target}"))
    elif source == "__log":
        pass  # the bridge logs to stderr, where roslaunch looks too
    elif source.startswith("_") and not source.startswith("__"):
        others += ["-p", _parameter(f"{source[1:]}:={target}")]
    else:
        rules.append(_rule(argument))
