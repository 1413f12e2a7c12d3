"""``rosplc types``: which messages, services and actions there are, and how one looks in the PLC.

rosplc types  —  all types of ./rosplc.yaml, else of jazzy

rosplc types sensor_msgs  —  the types of a package

rosplc types geometry_msgs/Twist  —  the fields, offsets and IEC types of a message

rosplc types sensor_msgs/JointState --limits name=6 --limits position=6

rosplc types std_srvs/SetBool  —  the request and response of a service

rosplc types my_msgs/Part --path ./msg  —  a custom type

rosplc types --path ~/ws/src  —  all types, including those of a workspace, and which of these cannot be used

rosplc types --from-topic /pose --save ./msg  —  a custom type of ROS 1, from a running publisher

rosplc types --distros  —  the bundled distributions
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import typer

from rosplc.cli.options import default_config
from rosplc.cli.text import print_json, say, table, warn
from rosplc.cli.verb import verb
from rosplc.errors import BackendError
from rosplc.harmless import plural
from rosplc.layout import Layout, Limits, compute_layout
from rosplc.layout.nodes import ArrayNode, Node, ScalarNode, SequenceNode, StringNode, StructNode
from rosplc.model import DISTROS, MessageType, TypeStore
from rosplc.plc.names import IEC_TYPES, type_prefix


@verb
def command(
    name: str | None = None,
    /,
    *,
    distro: str | None = None,
    path: list[Path] | None = None,
    limits: list[str] | None = None,
    from_topic: str | None = None,
    save: Path | None = None,
    timeout: float = 5.0,
    distros: bool = False,
    as_json: bool = False,
) -> None:
    """List the known message, service and action types, or show the fields and sizes of one type.

    Options:
        name [TYPE]: A type, `package/Name` or `package/msg/Name` (`srv`, `action`), or a package; by
            default all types.
        distro NAME: The ROS distribution whose definitions apply; `noetic` is ROS 1. By default, distribution
            and `types.paths` of `./rosplc.yaml`, else jazzy.
        path FOLDER: A folder with custom .msg, .srv and .action files; may be repeated.
        limits FIELD=N: A capacity: `string=40`, `sequence=8`, or a field's path (`request.FIELD` of a
            service); may be repeated.
        from_topic TOPIC: Get the type and its definition from a publisher of this topic (ROS 1,
            `ROS_MASTER_URI`).
        save FOLDER: With --from-topic: write the definitions to this folder, for `types.paths`.
        timeout SECONDS: With --from-topic: how long to wait for a publisher.
        distros: List the bundled distributions.
    """
    if distros:
        stores = [TypeStore.bundled(each) for each in DISTROS]
        if as_json:
            print_json({store.distro: len(store) for store in stores})
        else:
            rows = ((each.distro, len(each), len(each.services()), len(each.actions())) for each in stores)
            table(rows, header=("distribution", "messages", "services", "actions"))
        return
    wire: dict[str, Any] = {}
    if from_topic is not None:
        if name is not None or path:
            raise typer.BadParameter("cannot be used with TYPE or --path", param_hint="--from-topic")
        if not 0 <= timeout <= 3600:  # NaN neither
            raise typer.BadParameter("must be a number from 0 to 3600", param_hint="--timeout")
        store, name, wire = _ask(from_topic, save, timeout)
    elif save is not None:
        raise typer.BadParameter("requires --from-topic", param_hint="--save")
    else:
        folders = list(path or ())
        if distro is None and (file := default_config()) is not None:
            from rosplc.config import read_config  # takes longer than the rest of this verb

            config = read_config(file)
            distro = config.settings.ros.distro
            folders += config.type_folders
        store = TypeStore.bundled(distro or "jazzy").with_paths(folders)
    every = sorted((*store.names(), *store.services(), *store.actions()))
    package = [each for each in every if each.startswith(f"{name}/")]
    if name is None or package:
        names = package or every
        if as_json:
            print_json(names)
        else:
            say("\n".join(names))
        if name is None:
            for text in dict.fromkeys(
                f"{each.where}: {each.what} [{each.code}]" for each in store.problems()
            ):
                warn(f"cannot be used: {text}")
        return
    full, given = store.resolve(name), parse_limits(limits or [])
    if parts := _parts(store, full):
        _show_parts(store, full, parts, given, as_json=as_json)
        return
    layout = compute_layout(store, store[full].name, given)
    if as_json:
        print_json({**_facts(store, layout), **wire})
        return
    if wire:
        say(f"{wire['topic']} of node {wire['node']}, md5 {wire['md5']}")
    _describe(store, layout)
    for file in wire.get("saved", ()):
        say(f"written: {file}")


def _parts(store: TypeStore, name: str) -> dict[str, MessageType]:
    kind = "msg" if name in store else name.split("/")[1]
    if kind == "srv":
        service = store.service(name)
        return {"request": service.request, "response": service.response}
    if kind == "action":
        action = store.action(name)
        return {"goal": action.goal, "result": action.result, "feedback": action.feedback}
    return {}


def _show_parts(
    store: TypeStore, name: str, parts: dict[str, MessageType], limits: Limits, *, as_json: bool
) -> None:
    own: dict[str, dict[str, int]] = {part: {} for part in parts}
    for path, capacity in limits.fields.items():
        part, _, field = path.partition(".")
        if part not in own:
            words = " or ".join(f"{each}.FIELD" for each in own)
            raise typer.BadParameter(f"{path!r} should be {words}", param_hint="--limits")
        own[part][field] = capacity
    layouts = {
        part: compute_layout(store, message.name, Limits(limits.string, limits.sequence, own[part]))
        for part, message in parts.items()
    }
    kind = "service" if "request" in parts else "action"
    marks: dict[str, str] = {}
    if store.ros_version == 1 and kind == "service":
        marks = {"md5": store.service_md5(name)}
    elif store.ros_version == 2 and store.distro != "humble":  # which has no type hashes
        marks = {"hash": store.service_hash(name) if kind == "service" else store.action_hash(name)}
    if as_json:
        facts = {part: _facts(store, layout) for part, layout in layouts.items()}
        print_json({"type": name, "kind": kind, "distro": store.distro, **marks, **facts})
        return
    say("".join([f"{name} ({store.distro}): {kind}", *(f", {key} {mark}" for key, mark in marks.items())]))
    for layout in layouts.values():
        say()
        _describe(store, layout)


def _ask(topic: str, folder: Path | None, timeout: float) -> tuple[TypeStore, str, dict[str, Any]]:
    """Ask a publisher; return the types, the topic's type, and what is to be printed about it."""
    try:
        from rosplc.ros.rospy import definition_on_wire, save_definition
    except ImportError as error:
        raise BackendError("ROS001", str(error)) from error
    found = definition_on_wire(topic, timeout)
    wire: dict[str, Any] = {"topic": found.topic, "node": found.node, "md5": found.md5}
    if folder is not None:
        wire["saved"] = [str(file) for file in save_definition(found, folder)]
    return found.store, found.type_name, wire


def parse_limits(texts: list[str]) -> Limits:
    """Return the limits that ``FIELD=N`` options give; ``string`` and ``sequence`` are the defaults.

    Raises BadParameter, a text is not of that form; LayoutError LAY001, a capacity is out of range.
    """
    given: dict[str, int] = {}
    for text in texts:
        field, equals, number = text.rpartition("=")
        if not equals or not field or not number.isascii() or not number.isdigit():
            raise typer.BadParameter(
                f"{text!r} should be FIELD=N, such as string=40 or name=6", param_hint="--limits"
            )
        given[field] = int(number)
    own = {key: given.pop(key) for key in ("string", "sequence") if key in given}
    return Limits(fields=given, **own)


def _facts(store: TypeStore, layout: Layout) -> dict[str, Any]:
    message = store[layout.type_name]
    keys = ("path", "offset", "size", "ros", "iec")
    fields = [(path, offset, node.size, *_names(node)) for path, offset, node in layout.fields()]
    return {
        "type": layout.type_name,
        "distro": store.distro,
        "size": layout.size,
        "align": layout.align,
        "layout_id": layout.layout_id,
        "limits": layout.limits.to_dict(),
        "fields": [dict(zip(keys, field, strict=True)) for field in fields],
        "initial": layout.to_dict(layout.initial()),
        "constants": {each.name: each.value for each in message.constants},
        "dependencies": list(store.dependencies(layout.type_name)),
        "definition": store.definition_text(layout.type_name),
    }


def _describe(store: TypeStore, layout: Layout) -> None:
    message = store[layout.type_name]
    say(
        f"{layout.type_name} ({store.distro}): {plural(layout.size, 'byte')} per record, "
        f"layout id {layout.layout_id}"
    )
    say()
    rows = [(offset, node.size, path, *_names(node)) for path, offset, node in layout.fields()]
    table(rows, header=("offset", "bytes", "field", "ROS", "IEC 61131-3"))
    defaults = [(field.name, field.default) for field in message.fields if field.default is not None]
    if defaults:
        say("\nDefault values:")
        table(defaults, indent=2)
    if message.constants:
        say("\nConstants:")
        table(((each.name, str(each.type), each.value) for each in message.constants), indent=2)
    say("\nDefinition:")
    for line in store.definition_text(layout.type_name).splitlines():
        say(f"  {line}" if line else "")


def _names(node: Node) -> tuple[str, str]:
    """Return a node's type in ROS's words, with its capacity, and in IEC 61131-3."""
    if isinstance(node, ScalarNode):
        return node.kind, IEC_TYPES[node.kind]
    if isinstance(node, StringNode):
        return f"string (up to {node.capacity} bytes)", f"STRING({node.capacity})"
    if isinstance(node, ArrayNode | SequenceNode):
        ros, iec = _names(node.element)
        ros, iec = ros.partition(" ")[0], f"ARRAY[0..{node.capacity - 1}] OF {iec}"
        if isinstance(node, ArrayNode):
            return f"{ros}[{node.capacity}]", iec
        return f"{ros}[] (up to {node.capacity})", f"UDINT, {iec}"
    if isinstance(node, StructNode):
        return node.type_name, type_prefix(node.type_name)
    return "padding", ""
