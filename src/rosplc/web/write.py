"""Message types for the page's form, and writing a test message to a channel that has no other writer.

Numbers that JavaScript cannot represent exactly are sent as text, in both directions.

A claim other than 0 is never replaced, no matter how long its holder has been silent: Structured Text stores
no process number, and a PLC in another container or at a breakpoint would lose its claim. A person frees the
claim of a dead PLC with ``rosplc release``. Towards the PLC, the page also needs the lock of the object's
name, which a running bridge holds.
"""

from __future__ import annotations

import sys
from typing import Any

from rosplc.clock import SYSTEM, Clock
from rosplc.described import layout_of
from rosplc.errors import ChannelError, LayoutError, WebError
from rosplc.layout import Layout
from rosplc.layout.nodes import ArrayNode, Node, PaddingNode, ScalarNode, SequenceNode, StringNode, StructNode
from rosplc.model import TypeStore
from rosplc.proc import name_of
from rosplc.shm import Attached, Direction, Namespace, OwnedChannel, Region, Writer
from rosplc.shm import attach as attach_object
from rosplc.shm.constants import STAMP_SYSTEM

SAFE_INTEGER = (1 << 53) - 1  # the largest whole number that JavaScript's numbers hold exactly

_ELEMENTS = 256
_LARGEST = {"float32": 3.4028235677973366e38, "float64": sys.float_info.max}
"""Numbers above these limits become infinite."""


def form_of(layout: Layout) -> dict[str, Any]:
    """Return a layout as a tree of plain data.

    Every node has ``kind``: ``struct`` (with ``members``, each with its ``name``), ``list`` (with
    ``element``, ``capacity`` and ``fixed``), ``string`` (``capacity`` in bytes), ``bool``, ``integer``
    (``low`` and ``high`` as text) or ``float``; and ``type``, the ROS type name.
    """
    return _node(layout.root, layout.store)


def _node(node: Node, store: TypeStore) -> dict[str, Any]:
    if isinstance(node, StructNode):
        message = store[node.type_name]
        return {
            "kind": "struct",
            "type": node.type_name,
            "members": [
                {"name": member.name, **_node(member.node, store)}
                for member in node.members
                if not isinstance(member.node, PaddingNode) and member.count_of is None
            ],
            "constants": [
                {"name": constant.name, "type": str(constant.type), "value": shown(constant.value)}
                for constant in message.constants
            ],
        }
    if isinstance(node, ArrayNode | SequenceNode):
        element = _node(node.element, store)
        fixed = isinstance(node, ArrayNode)
        capacity = node.capacity
        text = f"{element['type']}[{capacity if fixed else ''}]"
        return {"kind": "list", "type": text, "capacity": capacity, "fixed": fixed, "element": element}
    if isinstance(node, StringNode):
        return {"kind": "string", "type": "string", "capacity": node.capacity}
    assert isinstance(node, ScalarNode)
    if node.kind == "bool":
        return {"kind": "bool", "type": "bool"}
    if node.kind.startswith("float"):
        return {"kind": "float", "type": node.kind}
    signed = node.kind.startswith("int")
    bits = 8 * node.size - signed
    low = -(1 << bits) if signed else 0
    return {"kind": "integer", "type": node.kind, "low": str(low), "high": str((1 << bits) - 1)}


def shown(value: Any, elements: int = _ELEMENTS) -> Any:
    """Return a message's values in a form for JSON and the page.

    NaN, infinities and whole numbers beyond :data:`SAFE_INTEGER` become text. A list longer than
    ``elements`` becomes ``{"first": [...], "count": n}``.
    """
    if isinstance(value, bool) or value is None or isinstance(value, str):
        return value
    if isinstance(value, int):
        return value if -SAFE_INTEGER <= value <= SAFE_INTEGER else str(value)
    if isinstance(value, float):
        return value if value - value == 0.0 else str(value)
    if isinstance(value, dict):
        return {name: shown(item, elements) for name, item in value.items()}
    if len(value) > elements:
        return {"first": [shown(item, elements) for item in value[:elements]], "count": len(value)}
    return [shown(item, elements) for item in value]


def from_form(form: dict[str, Any], value: Any, path: str = "", *, not_finite: bool = True) -> Any:
    """Return a page's values, with text converted back to numbers.

    The layout refuses invalid or unfitting values, with the name of the field. ``form`` is a node of
    :func:`form_of`, ``path`` its path for the error; ``not_finite``: ``nan`` and ``inf`` are intended. Raises
    LayoutError LAY006 if a number is too large for its type, or is not finite although this is not intended:
    a typing error must not send such numbers to a machine.
    """
    kind = form["kind"]
    if kind == "struct" and isinstance(value, dict):
        members = {member["name"]: member for member in form["members"]}
        return {
            name: from_form(members[name], item, f"{path}.{name}".lstrip("."), not_finite=not_finite)
            if name in members
            else item
            for name, item in value.items()
        }
    if kind == "list" and isinstance(value, list):
        parts = enumerate(value)
        return [from_form(form["element"], one, f"{path}[{at}]", not_finite=not_finite) for at, one in parts]
    if kind not in ("integer", "float") or not isinstance(value, str | int | float):
        return value
    if kind == "integer" and isinstance(value, float) and value.is_integer():
        return int(value)  # JSON of a page does not tell 3.0 from 3
    try:
        number = (int(value, 10) if kind == "integer" else float(value)) if isinstance(value, str) else value
    except ValueError:
        return value
    if kind == "float":
        meant = str(value).strip().lower().lstrip("+-") in ("nan", "inf", "infinity")
        if meant and not not_finite:
            raise LayoutError("LAY006", f"{value} is not a finite number", where=path)
        if not meant and abs(number) > _LARGEST[form["type"]]:
            raise LayoutError("LAY006", f"{str(value)[:40]} is too large for {form['type']}", where=path)
    return number


_BEAT_MS = 1000


def write_message(
    namespace: Namespace,
    topic: str,
    layout_id: str,
    message: dict[str, Any],
    *,
    not_finite: bool = False,
    clock: Clock = SYSTEM,
) -> int:
    """Write one message into a channel of a prefix, and return its sequence number.

    ``layout_id`` is the layout for which the message was made: nested dicts and lists, numbers possibly as
    text; missing fields get their initial values. ``not_finite``: NaN and infinities are intended; ``clock``
    stamps the message. Raises WebError WEB010 if another writer has the channel, or its layout has changed;
    LayoutError LAY006 if a value does not fit its field or is not finite; ChannelError SHM101 and others as
    :func:`rosplc.attach`.
    """
    with attach_object(namespace, topic) as attached:
        layout = layout_of(attached)
        if layout.layout_id != layout_id:
            what = "the layout of the channel differs from that of the form"
            raise WebError("WEB010", what, where=topic, remedy="Open the form again.")
        record = bytes(layout.pack(from_form(form_of(layout), message, not_finite=not_finite)))
        writer = attached.snapshot().writer
        if writer.epoch:
            who = f"process {writer.pid}{name_of(writer.pid)}" if writer.pid else "a PLC program"
            raise _claimed(topic, who)
        if attached.identity.direction is Direction.TO_PLC:
            return _to_plc(namespace, attached, record, clock.time_ns())
    with attach_object(namespace, topic, write=True) as attached:
        same_layout = attached.identity.layout_id == layout_id
        return _publish(attached.region, same_layout, topic, record, clock.time_ns())


def _claimed(topic: str, who: str) -> WebError:
    remedy = f"Stop that writer. If it crashed, free its claim: `rosplc release {topic}`."
    return WebError("WEB010", f"{who} holds the writer's claim", where=topic, remedy=remedy)


def _publish(region: Region, same_layout: bool, topic: str, record: bytes, stamp_ns: int) -> int:
    """Claim a free writer's line, publish, and release the claim."""
    try:
        writer = Writer(region, 0, _BEAT_MS)
    except ChannelError as error:
        if error.code == "SHM114":
            raise _claimed(topic, "another writer") from error
        raise
    try:
        if not same_layout:  # replaced between two looks
            raise WebError("WEB010", "the channel's layout has changed", where=topic)
        return writer.publish(record, stamp_ns=stamp_ns, stamp_clock=STAMP_SYSTEM)
    finally:
        writer.release()


def _to_plc(namespace: Namespace, attached: Attached, record: bytes, stamp_ns: int) -> int:
    try:
        with OwnedChannel.take_over(namespace, attached) as channel:
            return _publish(channel.region, True, channel.description.topic, record, stamp_ns)
    except ChannelError as error:
        if error.code == "SHM116":
            what = "a bridge owns the channel and writes messages from ROS to it"
            raise WebError("WEB010", what, where=attached.description.topic) from error
        raise
