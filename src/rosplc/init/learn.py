"""Sources of a type's definition: the distribution, the user, ROS's own folders, or the graph.

Definitions from ROS's folders or the graph are kept as text, to be saved beside the configuration: a bridge
must not depend on the network at the time of its setup. In the graph, a ROS 1 publisher sends a definition,
and a node of ROS 2 Iron or later describes its types.

A node's answer is not trusted. The description must have the type hash that the node announces, which covers
names and types. Constants, default values and comments come from the raw source sent with it; a source counts
only if it defines exactly the described fields, since even ROS's own generators mangle some sources.
"""

from __future__ import annotations

import logging
import os
import queue
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from rosplc.bridge.ros_side import LiveTypes, RosSide
from rosplc.clock import SYSTEM, Clock
from rosplc.config import Project, read_config, resolve
from rosplc.config.file import LEARNT, Config
from rosplc.errors import BackendError, MessageTypeError, RosplcError
from rosplc.harmless import one_line
from rosplc.model import TypeStore
from rosplc.model._rosbags import EMPTY_MEMBER
from rosplc.model.fingerprints import rihs01, type_text
from rosplc.model.folders import read, save_definitions, split_definition
from rosplc.model.parse import MAX_TEXT, full_name, parse_definition
from rosplc.ros import SERVICES, Backend, Reply, RosArguments, settled_graph
from rosplc.ros.fields import pack, unpack_whole
from rosplc.ros.names import resolve_topic

MOST_TYPES = 500  # one type's definition has a handful


class Definitions:
    """The known types: at first those of a distribution, later also those that were learned.

    ``folders`` contain the user's ``.msg`` files; ``AMENT_PREFIX_PATH`` and ``ROS_PACKAGE_PATH`` of the
    environment list the folders of a ROS installation. ``texts`` maps full names to the definitions to be
    saved, ``origins`` to their sources in words. Raises MessageTypeError TYP… as for ``types.paths`` of a
    configuration.
    """

    def __init__(
        self, distro: str, folders: Sequence[Path] = (), environment: Mapping[str, str] | None = None
    ) -> None:
        self.store = TypeStore.bundled(distro).with_paths(folders)
        self.texts: dict[str, str] = {}
        self.origins: dict[str, str] = {}
        self._environment = os.environ if environment is None else environment

    def learn(self, type_name: str, text: str, origin: str) -> None:
        """Add a type from a definition text, which is not trusted; raises TYP001 … TYP007."""
        new = self.store.with_definition(type_name, text)
        for name, part in split_definition(type_name, text).items():
            if name not in self.store:
                self.texts[name] = part
                self.origins[name] = origin
        self.store = new

    def find_installed(self, type_name: str) -> bool:
        """Look for a type and its dependencies in a ROS installation; return whether the type is known now.

        Raises MessageTypeError TYP… if its definition is invalid.
        """
        if type_name in self.store:
            return True
        parts: dict[str, str] = {}
        first: Path | None = None
        todo = [full_name(type_name)]
        while todo:
            name = todo.pop(0)
            if name in parts or name in self.store or name.startswith("builtin_interfaces/"):
                continue
            file = self._file(name)
            if file is None or len(parts) == MOST_TYPES:
                return False
            first = first or file
            parts[name] = f"{read(file)}\n"
            with suppress(RosplcError, ValueError):  # learning the text reports what is wrong with it
                (parsed,) = parse_definition(name, parts[name], ros_version=self.store.ros_version)
                todo += parsed.message.needs
        self.learn(type_name, join_texts(parts), str(first))
        return True

    def unknown(self, type_name: str, more: str = "") -> MessageTypeError:
        """Return the error for a type that was not found: TYP001."""
        return MessageTypeError(
            "TYP001",
            f"{type_name} is unknown in {self.store.distro}{more}",
            remedy="Specify the folder of its package with --types, or source the setup.bash of a "
            "workspace that contains the package.",
        )

    def _file(self, type_name: str) -> Path | None:
        package, _, base = type_name.split("/")
        variable, below = "AMENT_PREFIX_PATH", "share"
        if self.store.ros_version == 1:
            variable, below = "ROS_PACKAGE_PATH", ""
        for part in filter(None, self._environment.get(variable, "").split(":")):
            file = Path(part) / below / package / "msg" / f"{base}.msg"
            if file.is_file():
                return file
        return None


def join_texts(texts: Mapping[str, str]) -> str:
    """Return one text for definitions by full name, as ROS tools concatenate them."""
    (_, own), *others = texts.items()
    return own + "".join(f"{'=' * 80}\nMSG: {name.replace('/msg/', '/')}\n{text}" for name, text in others)


_log = logging.getLogger("rosplc.run")
_SERVICE = "type_description_interfaces/srv/GetTypeDescription"
_LOOK_S = 5.0
_PATIENCE_S = 3.0  # how long a node may take to be found, and to answer
_MOST_NODES = 3


def learn(definitions: Definitions, backend: Backend, topic: str, type_name: str) -> None:
    """Make sure that a topic's type is known: from a ROS installation, else from a node that uses the topic.

    Raises MessageTypeError TYP… if no node can describe it, and for ROS 1 BackendError ROS014 or ROS017.
    """
    if definitions.find_installed(type_name):
        return
    if backend.name == "rospy":
        from rosplc.ros.rospy import definition_on_wire

        found = definition_on_wire(topic, 2.0)
        if found.type_name != type_name:
            raise BackendError("ROS017", f"node {found.node} publishes {topic} as {found.type_name}")
        definitions.learn(type_name, found.text, f"node {found.node}")
        return
    graph = backend.graph()
    servers = {
        end.topic for end in graph.services if end.direction == "in"
    }  # none where services have no topics
    ends = [end for end in graph.endpoints if (end.topic, end.type_name) == (topic, type_name)]
    ends.sort(key=lambda end: end.direction == "in")  # publishers first
    nodes = {end.node: end.type_hash for end in ends if end.node and end.type_hash}
    trouble = f"no node uses {topic} with this type"
    if ends and not nodes:
        trouble = f"the nodes that use {topic} announce no type hash (ROS 2 Humble has none)"
    for node, type_hash in list(nodes.items())[:_MOST_NODES]:
        service = f"{node}/get_type_description"
        try:
            if servers and service not in servers:
                raise _refused("it does not offer a service for type descriptions")
            answer = _ask(backend, definitions.store, service, type_name, type_hash)
            take(definitions, answer, type_name, type_hash, f"node {node}")
        except RosplcError as error:
            trouble = f"node {node} cannot describe the type: {error.what}"
        else:
            return
    raise definitions.unknown(type_name, f", and {trouble}")


def _ask(
    backend: Backend, store: TypeStore, service: str, type_name: str, type_hash: str, clock: Clock = SYSTEM
) -> dict[str, Any]:
    """Return a node's answer; raises MessageTypeError TYP010 or CodecError."""
    if f"{_SERVICE}_Request" not in store:
        raise _refused(f"{store.distro} (ros.distro) has no service for type descriptions")
    request = {"type_name": type_name, "type_hash": type_hash, "include_type_sources": True}
    replies: queue.SimpleQueue[Reply] = queue.SimpleQueue()
    client = backend.client(service, _SERVICE, SERVICES)
    try:
        end = clock.monotonic_ns() + round(_PATIENCE_S * 1e9)
        while not client.ready:
            status = client.status()
            if status.code or clock.monotonic_ns() > end:
                raise _refused(status.reason or "its service is not ready")
            clock.sleep(50_000_000)
        client.call(pack(store, f"{_SERVICE}_Request", request), replies.put)
        reply = replies.get(timeout=_PATIENCE_S)
    except queue.Empty:
        raise _refused(f"it did not answer within {_PATIENCE_S:g} s") from None
    finally:
        client.close()
    if reply.payload is None:
        raise _refused(reply.text or reply.outcome)
    if len(reply.payload) > MAX_TEXT:
        raise _refused(f"its answer is {len(reply.payload)} bytes long; the limit is {MAX_TEXT}")
    return unpack_whole(store, f"{_SERVICE}_Response", reply.payload)


def take(
    definitions: Definitions, answer: Mapping[str, Any], type_name: str, type_hash: str, origin: str
) -> None:
    """Add the type that an answer of GetTypeDescription describes, with its dependencies.

    Raises MessageTypeError: TYP010 if the answer does not describe this type with this hash; TYP002, TYP003,
    TYP004 or TYP007 if the description is malformed, recursive, unsupported or too large; TYP005 if a known
    type has a different definition.
    """
    described = _described(answer, type_name, type_hash)
    needed = described.dependencies(type_name)
    for name in needed:
        if name in definitions.store and _fields(definitions.store, name) != _fields(described, name):
            what = f"{name} differs between {origin} and {definitions.store.distro}"
            raise MessageTypeError("TYP005", what)
    plain = split_definition(type_name, described.definition_text(type_name))
    sources = {source["type_name"]: source for source in answer["type_sources"]}
    texts: dict[str, str] = {}
    incomplete: list[str] = []
    for name in reversed(needed):  # itself first
        if name not in definitions.store:
            source = _source(sources.get(name, {}), name, described)
            texts[name] = plain[name] if source is None else source
            incomplete += [name] * (source is None)
    definitions.learn(type_name, join_texts(texts), origin)
    for name in incomplete:
        definitions.origins[name] += ", without constants and default values: the source text cannot be used"


def _described(answer: Mapping[str, Any], type_name: str, type_hash: str) -> TypeStore:
    """Return the types that an answer describes, and no others."""
    if not answer["successful"]:
        raise _refused(one_line(answer["failure_reason"][:200]) or "it gave no reason")
    parts = answer["type_description"]
    own, others = parts["type_description"], parts["referenced_type_descriptions"]
    if own["type_name"] != type_name:
        raise _refused(f"it describes {one_line(own['type_name'][:80])!r} instead")
    if len(others) > MOST_TYPES:
        raise MessageTypeError("TYP007", f"it depends on {len(others)} types; the limit is {MOST_TYPES}")
    texts = {each["type_name"]: _text(each) for each in (own, *others)}
    store = TypeStore.from_definition(type_name, join_texts(texts))
    if (found := store.type_hash(type_name)) != type_hash:
        raise _refused(f"its description has the hash {found}, not {one_line(type_hash[:80])}")
    return store


def _text(description: Mapping[str, Any]) -> str:
    """Return a definition's text; its parser judges names and numbers."""
    fields = description["fields"]
    if [field["name"] for field in fields] == [EMPTY_MEMBER]:
        return ""
    return "".join(f"{type_text(**field['type'])} {field['name']}\n" for field in fields)


def _fields(store: TypeStore, name: str) -> str:
    return rihs01(store[name], [])


def _source(source: Mapping[str, Any], name: str, described: TypeStore) -> str | None:
    """Return the text of a raw source that defines one type, with the fields described; None for another."""
    text = source.get("raw_file_contents", "") if source.get("encoding") == "msg" else None
    with suppress(MessageTypeError):
        if text is not None:
            found = parse_definition(name, text, siblings=described.names())
            if len(found) == 1 and rihs01(found[0].message, []) == _fields(described, name):
                return f"{text}\n"
    return None


def _refused(what: str) -> MessageTypeError:
    return MessageTypeError("TYP010", what)


def load(path: Path, arguments: RosArguments | None = None) -> Project:
    """Read a configuration as :func:`rosplc.config.load_project` does, and learn its unknown types.

    Learned types are logged and saved beside the file, in the folder :data:`~rosplc.config.file.LEARNT`,
    where later readers of the configuration find them. Raises MessageTypeError TYP009 if saving fails.
    """
    config = read_config(path)
    try:
        definitions = Definitions(config.settings.ros.distro, config.type_folders)
    except MessageTypeError:
        return resolve(config)  # which names the folder and its line
    topics = config.settings.topics.items()
    if missing := {name: entry.type for name, entry in topics if _is_unknown(definitions.store, entry.type)}:
        _learn_all(config, arguments or RosArguments(), definitions, missing)
    return resolve(config)


def _is_unknown(store: TypeStore, name: str) -> bool:
    try:
        _ = store[name]
    except MessageTypeError as error:  # of a type that this one needs the error has the place
        return error.code == "TYP001" and not error.where
    return False


def _learn_all(
    config: Config, arguments: RosArguments, definitions: Definitions, missing: Mapping[str, str]
) -> None:
    side, types = RosSide(config, arguments), LiveTypes(definitions.store)
    node, namespace, remap = side.names()
    try:
        backend, _ = side.open(types)
    except BackendError as error:
        _log.warning("cannot look for unknown types in the graph: %s", error.what)
        return
    try:
        names = {
            topic: resolve_topic(topic, namespace=namespace, node_name=node, remap=remap) for topic in missing
        }
        settled_graph(backend.graph, _LOOK_S, tuple(names.values()))
        for topic, type_name in missing.items():
            try:
                learn(definitions, backend, names[topic], full_name(type_name))
                types.store = definitions.store
            except RosplcError as error:
                _log.warning("%s: %s", topic, error.what)
    finally:
        backend.close()
    folder = config.base / LEARNT
    save_definitions(definitions.texts, folder)
    for name, origin in definitions.origins.items():
        _log.info("learned %s from %s; saved in %s", name, origin, folder)
