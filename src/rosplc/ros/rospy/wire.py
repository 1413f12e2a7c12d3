"""A topic's type and definition, requested from a publisher: for messages whose ``.msg`` files are missing.

Every ROS 1 publisher sends its type's definition, with all types that it needs, in its connection
header. The definition comes from another program and is not trusted: it is parsed within the usual
limits for definitions, its MD5 sum must match the one that the publisher states, and nothing in it is
executed.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from rosplc.clock import SYSTEM, Clock
from rosplc.errors import BackendError
from rosplc.model import TypeStore
from rosplc.model.folders import save_definitions, split_definition
from rosplc.ros.names import resolve_topic
from rosplc.ros.rospy.handshake import HandshakeError
from rosplc.ros.rospy.master import Master, RefusedError, UnreachableError, is_node_uri, read_address
from rosplc.ros.rospy.topics import ANY_TYPE, greet, request

_CALLER = "/rosplc_types"
_PAUSE_NS = 200_000_000


@dataclass(frozen=True, slots=True)
class WireDefinition:
    """A publisher's description of its topic."""

    topic: str  # the topic's full name
    node: str  # the publisher's name
    type_name: str  # ``package/msg/Name``
    md5: str  # the type's MD5 sum, as stated and as computed
    text: str  # the definition as it came, with every type it needs
    latching: bool  # whether the publisher latches
    store: TypeStore  # the types of ROS 1 noetic and those of the definition


def definition_on_wire(
    topic: str, timeout_s: float = 5.0, *, environment: Mapping[str, str] | None = None, clock: Clock = SYSTEM
) -> WireDefinition:
    """Request a topic's type and definition from a running publisher, within ``timeout_s``.

    Raises BackendError: ROS014 without a master, ROS017 if there is no publisher or its description is
    inconsistent, ROS005 and ROS010 for an invalid name or environment; MessageTypeError: TYP… if the
    definition has errors, exceeds a limit, or differs from noetic's definition of the same name.
    """
    full = resolve_topic(topic)
    address = read_address(os.environ if environment is None else environment)
    master = Master(address.master, _CALLER, clock=clock)
    deadline_ns = clock.monotonic_ns() + round(timeout_s * 1e9)
    try:
        while True:
            trouble = f"no node publishes {full}"
            for node in sorted(master.state().publishers.get(full, ())):
                uri = master.node_uri(node)
                if not is_node_uri(uri):
                    continue
                try:
                    sock, header = greet(request(uri, _CALLER, full), _CALLER, full, ANY_TYPE)
                except (OSError, UnreachableError, RefusedError, HandshakeError) as error:
                    trouble = f"node {node} publishes {full}, but the connection failed: {error}"
                    continue
                sock.close()
                return _checked(full, node, header)
            if clock.monotonic_ns() >= deadline_ns:
                raise BackendError("ROS017", trouble)
            clock.sleep(_PAUSE_NS)
    except UnreachableError as error:
        what = f"the ROS master at {address.master} does not answer: {error}"
        raise BackendError("ROS014", what) from error
    finally:
        master.close()


def _checked(topic: str, node: str, header: Mapping[str, str]) -> WireDefinition:
    missing = [name for name in ("type", "md5sum", "message_definition") if not header.get(name)]
    if missing:
        why = header.get("error") or f"its connection header has no {missing[0]}"
        raise BackendError("ROS017", f"node {node} does not send the definition of {topic}: {why[:300]}")
    text = header["message_definition"]
    store = TypeStore.bundled("noetic").with_definition(header["type"], text)
    name = store[header["type"]].name
    md5 = store.md5(name)
    if md5 != header["md5sum"]:
        raise BackendError(
            "ROS017",
            f"node {node} reports md5 {header['md5sum'][:64]} for {name}, but its definition has md5 {md5}",
            remedy="The node was built with definitions that differ from those it sends; rebuild it.",
        )
    return WireDefinition(topic, node, name, md5, text, header.get("latching") == "1", store)


def save_definition(definition: WireDefinition, folder: Path) -> tuple[Path, ...]:
    """Write ``package/msg/Name.msg`` for each type that noetic does not bundle; return the files.

    A file that already has this content is not changed.

    Raises MessageTypeError: TYP009 if a file with that name has other content, or cannot be written.
    """
    bundled = TypeStore.bundled("noetic")
    texts = split_definition(definition.type_name, definition.text)
    return save_definitions({name: text for name, text in texts.items() if name not in bundled}, folder)
