"""What comes from outside has a bound: each line of docs/reference/limits.md is exceeded here once."""

from __future__ import annotations

import http.client
import json
import os
import queue
import select
import socket
import threading
from collections.abc import Callable
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from rosplc.codec import Wire
from rosplc.codec.compile import MAX_LOOPS, compile_plan
from rosplc.config import settings, yaml_source
from rosplc.config.file import Config, parse_config
from rosplc.config.plans import ClassicPlan
from rosplc.config.yaml_source import ConfigErrors, Problems
from rosplc.errors import LONGEST_TEXT, RosplcError
from rosplc.layout import Limits, compute_layout, nodes
from rosplc.layout.nodes import MAX_SEQUENCE, MAX_STRING
from rosplc.model import TypeStore, folders, parse, store
from rosplc.plc import build, delivery
from rosplc.plc.plan import LONGEST_NAME
from rosplc.ros import _base as words
from rosplc.ros import names
from rosplc.shm import Description, Namespace, OwnedChannel, constants
from rosplc.shm.header import Identity
from tests.unit.plc.projects import project, read
from tools.generate_limits_reference import groups

pytestmark = pytest.mark.verifies("limits", own="each limit exceeded once")

ROOT = Path(__file__).resolve().parents[2]
TOPIC = "{type: std_msgs/msg/Int8, to: plc}"


def refused(code: str, action: Callable[[], object], says: str = "") -> None:
    with pytest.raises(RosplcError) as caught:
        action()
    assert caught.value.code == code, caught.value
    assert says in str(caught.value)


def yaml(text: str) -> Callable[[], object]:
    return lambda: parse_config(text)


def plan(**words: Any) -> Identity:
    sound: dict[str, Any] = {
        "direction": constants.Direction.TO_PLC,
        "slots": 4,
        "record_size": 8,
        "description_size": 64,
        "layout_id": "00" * 8,
        "generation": 1,
        "bridge_id": bytes(16),
    }
    return Identity.plan(**{**sound, **words})


def not_planned(says: str, **words: Any) -> None:
    with pytest.raises(ValueError, match=says):
        plan(**words)


CHECKS: dict[str, Callable[[pytest.MonkeyPatch, Path], None]] = {}


def beyond(*limits: str) -> Callable[[Any], Any]:
    """Register a check of these limits."""

    def register(check: Any) -> Any:
        for limit in limits:
            CHECKS[f"rosplc.{limit}"] = check
        return check

    return register


@beyond("config.yaml_source.LARGEST_FILE", "config.yaml_source.DEEPEST")
def files_and_nesting(patch: pytest.MonkeyPatch, folder: Path) -> None:
    long = folder / "long.yaml"
    long.write_bytes(b"#" * (yaml_source.LARGEST_FILE + 1))
    refused("CFG001", lambda: yaml_source.read_yaml(long, Problems()), str(yaml_source.LARGEST_FILE))
    refused("CFG002", yaml("[" * (yaml_source.DEEPEST + 1)), str(yaml_source.DEEPEST))


@beyond("config.yaml_source.MOST_ERRORS")
def errors_at_once(patch: pytest.MonkeyPatch, folder: Path) -> None:
    with pytest.raises(ConfigErrors) as caught:
        parse_config("".join(f"wrong{number}: 1\n" for number in range(2 * yaml_source.MOST_ERRORS)))
    assert len(caught.value.errors) == yaml_source.MOST_ERRORS


@beyond(
    "config.settings.MOST_TOPICS",
    "config.settings.MOST_TASKS",
    "config.settings.MOST_PATHS",
    "config.settings.MOST_REMAPPINGS",
)
def many_keys(patch: pytest.MonkeyPatch, folder: Path) -> None:
    topics = {f"/t{number}": {"type": "a/B", "to": "plc"} for number in range(settings.MOST_TOPICS + 1)}
    refused("CFG004", lambda: Config.from_dict({"topics": topics}), str(settings.MOST_TOPICS))
    tasks: dict[str, Any] = {f"T{number}": {} for number in range(settings.MOST_TASKS + 1)}
    refused("CFG004", lambda: Config.from_dict({"tasks": tasks}), str(settings.MOST_TASKS))
    paths = ["x"] * (settings.MOST_PATHS + 1)
    refused("CFG004", lambda: Config.from_dict({"types": {"paths": paths}}), str(settings.MOST_PATHS))
    address = ["tcp/a:1"] * (settings.MOST_PATHS + 1)
    refused("CFG004", lambda: Config.from_dict({"ros": {"zenoh": {"connect": address}}}))
    remap = {f"/a{number}": "/b" for number in range(settings.MOST_REMAPPINGS + 1)}
    refused("CFG004", lambda: Config.from_dict({"ros": {"remap": remap}}), str(settings.MOST_REMAPPINGS))


@beyond("config.settings.LONGEST_NAME", "config.settings.LONGEST_TYPE", "config.settings.LONGEST_TEXT")
def long_names(patch: pytest.MonkeyPatch, folder: Path) -> None:
    name = "/" + "a" * settings.LONGEST_NAME
    assert parse_config(f"topics: {{{name[:-1]}: {TOPIC}}}")
    refused("CFG004", yaml(f"topics: {{{name}: {TOPIC}}}"), str(settings.LONGEST_NAME))
    refused("CFG004", yaml(f"ros: {{namespace: {name}}}"), str(settings.LONGEST_NAME))
    kind = "a/" + "B" * settings.LONGEST_TYPE
    refused("CFG004", yaml(f"topics: {{/a: {{type: {kind}, to: plc}}}}"), str(settings.LONGEST_TYPE))
    path = "a" * (settings.LONGEST_TEXT + 1)
    for text in (
        f"types: {{paths: [{path}]}}",
        f"shm: {{directory: /{path}}}",
        f"ros: {{zenoh: {{config: {path}}}}}",
        f"ros: {{zenoh: {{listen: [tcp/{path}]}}}}",
    ):
        refused("CFG004", yaml(text), str(settings.LONGEST_TEXT))


@beyond("layout.nodes.MAX_STRING", "layout.nodes.MAX_SEQUENCE")
def capacities(patch: pytest.MonkeyPatch, folder: Path) -> None:
    refused("LAY001", lambda: Limits(string=MAX_STRING + 1))
    refused("LAY001", lambda: Limits(sequence=MAX_SEQUENCE + 1))
    refused("LAY001", lambda: Limits(fields={"a": 10**30}))


def defined(text: str) -> TypeStore:
    return TypeStore.from_definition("a/msg/B", text)


@beyond("model.parse.MAX_TEXT", "model.parse.MAX_FIELDS", "model.parse.MAX_NAME", "model.store.MAX_DEPTH")
def definitions(patch: pytest.MonkeyPatch, folder: Path) -> None:
    refused("TYP007", lambda: defined("#" * (parse.MAX_TEXT + 1)), str(parse.MAX_TEXT))
    refused("TYP007", lambda: defined("".join(f"bool a{n}\n" for n in range(parse.MAX_FIELDS + 1))))
    refused("TYP001", lambda: TypeStore.from_definition("a/" + "B" * parse.MAX_NAME, ""))
    refused("TYP002", lambda: defined("bool " + "a" * (parse.MAX_NAME + 1)), str(parse.MAX_NAME))
    line = "=" * 80
    chain = [f"{line}\nMSG: a/C{n}\nC{n + 1} x\n" for n in range(store.MAX_DEPTH + 1)]
    refused("TYP007", lambda: defined(f"C0 x\n{''.join(chain)}{line}\nMSG: a/C{len(chain)}\nbool x\n"))


@beyond("model.folders.MAX_FILES", "model.folders.MAX_ENTRIES")
def folders_of_messages(patch: pytest.MonkeyPatch, folder: Path) -> None:
    for number in range(4):
        (folder / f"M{number}.msg").write_text("bool a\n")
    with patch.context() as lower:
        lower.setattr(folders, "MAX_FILES", 3)
        refused("TYP008", lambda: TypeStore.bundled("jazzy").with_paths([folder]), "3 definitions")
    with patch.context() as lower:
        lower.setattr(folders, "MAX_ENTRIES", 3)
        refused("TYP008", lambda: TypeStore.bundled("jazzy").with_paths([folder]), "more than 3 files")


@beyond("layout.nodes.MAX_ITEMS", "layout.nodes.MAX_RECORD", "codec.compile.MAX_LOOPS")
def records(patch: pytest.MonkeyPatch, folder: Path) -> None:
    wide = "".join(f"Inner i{n}\n" for n in range(300)) + "=" * 80 + "\nMSG: a/Inner\n"
    wide += "".join(f"bool b{n}\n" for n in range(300))
    refused("LAY003", lambda: compute_layout(defined(wide), "a/msg/B"), str(nodes.MAX_ITEMS))
    large = f"uint8[{nodes.MAX_RECORD + 1}] a\n"
    refused("LAY003", lambda: compute_layout(defined(large), "a/msg/B"))
    # Each level of types may bring one sequence: the types' own depth is reached first.
    assert store.MAX_DEPTH <= MAX_LOOPS
    line = "=" * 80
    chain = "".join(f"{line}\nMSG: a/C{n}\nC{n + 1}[] x\n" for n in range(store.MAX_DEPTH - 2))
    deepest = f"C0[] x\n{chain}{line}\nMSG: a/C{store.MAX_DEPTH - 2}\nstring[] x\n"
    compile_plan(compute_layout(defined(deepest), "a/msg/B", Limits(1, 1)).root, Wire.CDR)


@beyond("shm.constants.MAX_NAME")
def object_names(patch: pytest.MonkeyPatch, folder: Path) -> None:
    assert len(Namespace().object_name("/" + "a" * 1000)) == 80


@beyond(
    "shm.constants.MAX_OBJECT_SIZE",
    "shm.constants.MAX_RECORD_SIZE",
    "shm.constants.MAX_DESCRIPTION_SIZE",
    "shm.constants.MAX_SLOTS",
)
def objects(patch: pytest.MonkeyPatch, folder: Path) -> None:
    not_planned("record_size", record_size=constants.MAX_RECORD_SIZE + 1)
    not_planned("slot_count", slots=2 * constants.MAX_SLOTS)
    not_planned("description_size", description_size=constants.MAX_DESCRIPTION_SIZE + 1)
    not_planned("object_size", record_size=constants.MAX_RECORD_SIZE)
    # The same sums hold for what others made: conformance/test_regions.py, fuzz/targets/object.py.


@beyond("shm.constants.READER_LINES", "shm.constants.MAX_RETRIES", "shm.constants.MAX_BEAT_MS")
def channels(patch: pytest.MonkeyPatch, folder: Path) -> None:
    from rosplc.shm.attach import Liveness

    assert constants.reader_line(constants.READER_LINES - 1)
    with pytest.raises(IndexError):
        constants.reader_line(constants.READER_LINES)
    # A promise of weeks does not block a claim for weeks.
    peer = Liveness(2**32 - 1)
    assert [peer.observe(beat, 0, 0) for beat in (1, 2)] == [False, True]
    assert not peer.observe(2, 0, 3 * constants.MAX_BEAT_MS * 1_000_000)
    # Retries: tests/unit/core/channel_test.c and tests/fuzz/native/channel_fuzz.c count them.


@beyond("ros.names.LONGEST_NAME")
def ros_names(patch: pytest.MonkeyPatch, folder: Path) -> None:
    refused("ROS005", lambda: names.validate_topic("/" + "a" * names.LONGEST_NAME))
    assert names.validate_topic("/" + "a" * (names.LONGEST_NAME - 1))


@beyond("ros._base.MOST_REASONS", "ros._base.LONGEST_REASON", "ros._base.MOST_REMEMBERED")
def reasons(patch: pytest.MonkeyPatch, folder: Path) -> None:
    text = words.listed(f"{number} \x1b[2J\n" + "x" * 5000 for number in range(500))
    assert text.isprintable()
    assert text.endswith(f"and {500 - words.MOST_REASONS} more")
    assert len(text) < (words.MOST_REASONS + 1) * (words.LONGEST_REASON + 2)
    said = words.LogOnce()
    assert sum(said.first(number) for number in range(3 * words.MOST_REMEMBERED)) == words.MOST_REMEMBERED
    assert not said.first(0)


@beyond(
    "ros.dds.peers.LONGEST_NAME",
    "ros.dds.peers.MOST_PARTICIPANTS",
    "ros.dds.backend.MAX_DOMAIN",
)
def over_dds(patch: pytest.MonkeyPatch, folder: Path) -> None:
    pytest.importorskip("cyclonedds")
    from rosplc.ros.dds import backend as domains
    from rosplc.ros.dds import peers as graph

    types = TypeStore.bundled("jazzy")
    node = graph.NodeEntities("/", "n" * (graph.LONGEST_NAME + 1))
    data = graph.encode_announcement(types, bytes(16), [node])
    refused("ROS008", lambda: graph.decode_announcement(types, data), "too long")
    for domain in (str(domains.MAX_DOMAIN + 1), "9" * 5000):
        refused("ROS010", lambda domain=domain: domains.domain_id(None, {"ROS_DOMAIN_ID": domain}))
    samples = [
        (graph.encode_announcement(types, number.to_bytes(16, "little"), []), _Valid())
        for number in range(1, 5)
    ]
    patch.setattr(graph, "MOST_PARTICIPANTS", 3)
    patch.setattr(graph, "ddspy_take", lambda *_: samples)
    announcer = graph.Announcer.__new__(graph.Announcer)
    announcer.__dict__.update(
        reader=0, _types=types, _guid=b"", _lock=threading.RLock(), _others={}, _names={}
    )
    announcer.take()
    assert len(announcer._others) == 3


class _Valid:
    valid_data = True


@beyond("ros.zenoh.keys.LONGEST_TOKEN", "ros.zenoh.keys.MOST_TOKENS", "ros.zenoh.backend.LARGEST_FILE")
def over_zenoh(patch: pytest.MonkeyPatch, folder: Path) -> None:
    pytest.importorskip("zenoh")
    from rosplc.ros.zenoh import backend as session
    from rosplc.ros.zenoh import keys

    token = "@ros2_lv/0/s/0/{}/NN/%/%/node"
    with pytest.raises(ValueError, match="characters"):
        keys.parse_token(token.format(1) + "/x" * keys.LONGEST_TOKEN)
    patch.setattr(keys, "MOST_TOKENS", 3)
    table = keys.TokenTable()
    for number in range(5):
        table.appeared(token.format(number))
    assert (len(table._entities), table.malformed) == (3, 2)
    long = folder / "zenoh.json5"
    long.write_text("{}" + " " * session.LARGEST_FILE)
    refused("ROS013", lambda: session.session_config({"config": str(long)}, {}), str(session.LARGEST_FILE))
    refused("ROS010", lambda: session.session_config({}, {"ZENOH_SESSION_CONFIG_URI": "/dev/zero"}))


@beyond(
    "ros.rospy.handshake.MOST_HEADER",
    "ros.rospy.topics.LARGEST_MESSAGE",
    "ros.rospy.master.MOST_ANSWER",
    "ros.rospy.slave.MOST_REQUEST",
    "ros.rospy.slave.MOST_CALLERS",
    "ros.rospy.slave.MOST_GREETINGS",
)
def over_ros1(patch: pytest.MonkeyPatch, folder: Path) -> None:
    from rosplc.ros.rospy import handshake, master, slave, topics
    from rosplc.ros.rospy.master import Address

    ours, theirs = socket.socketpair()
    with ours, theirs:
        theirs.sendall((handshake.MOST_HEADER + 1).to_bytes(4, "little"))
        with pytest.raises(handshake.HandshakeError, match=str(handshake.MOST_HEADER)):
            handshake.read_header(ours, 60.0)

    received = topics.Connections("limits")
    with socket.socket() as ours, socket.create_server(("127.0.0.1", 0)) as server:
        ours.connect(server.getsockname())
        theirs, ends = server.accept()[0], queue.SimpleQueue[str]()
        received.loop.receive(ours.fileno(), SimpleNamespace(end=ends.put), None)
        theirs.sendall((topics.LARGEST_MESSAGE + 1).to_bytes(4, "little"))
        assert ends.get(timeout=60.0) == f"a message of {topics.LARGEST_MESSAGE + 1} bytes was announced"
        received.let_go(ours)
        theirs.close()
    received.close()

    patch.setattr(master, "MOST_ANSWER", 1000)
    with _answering(b" " * 2000) as uri, pytest.raises(master.UnreachableError, match="1000 bytes"):
        master.Master(uri, "/n").state()

    class Nobody:
        def outgoing(self) -> dict[str, Any]:
            return {}

        incoming = outgoing

    patch.setattr(slave, "MOST_CALLERS", 2)
    patch.setattr(slave, "MOST_GREETINGS", 2)
    patch.setattr(slave, "TIMEOUT_S", 600.0)  # nothing but the limit closes a connection
    servers = slave.Servers(Address("http://127.0.0.1:1", "127.0.0.1", "127.0.0.1"), Nobody())
    try:
        port = int(servers.uri.rstrip("/").rpartition(":")[2])
        caller = http.client.HTTPConnection("127.0.0.1", port, timeout=60)
        caller.putrequest("POST", "/")
        caller.putheader("Content-Length", str(slave.MOST_REQUEST + 1))
        caller.endheaders()
        assert caller.getresponse().status == 413
        caller.close()
        for place in (port, servers.data.port):
            held = [socket.create_connection(("127.0.0.1", place), 60) for _ in range(3)]
            # One is closed at once; not always the third, as the caller before may still count.
            assert _closed_one(held)
            for one in held:
                one.close()
    finally:
        servers.close()


def _closed_one(held: list[socket.socket]) -> bool:
    closed, _, _ = select.select(held, [], [], 60)
    return bool(closed) and closed[0].recv(1) == b""


class _answering:
    """A server that answers every call with the same bytes; a context manager that gives its URI."""

    def __init__(self, body: bytes) -> None:
        class Handler(BaseHTTPRequestHandler):
            def do_POST(self) -> None:
                self.send_response(200)
                self.send_header("Content-Length", str(len(body)))
                self.end_headers()
                self.wfile.write(body)

            def log_message(self, *_: Any) -> None:
                pass

        self._server = HTTPServer(("127.0.0.1", 0), Handler)

    def __enter__(self) -> str:
        threading.Thread(target=self._server.serve_forever, daemon=True).start()
        return f"http://127.0.0.1:{self._server.server_address[1]}"

    def __exit__(self, *_: object) -> None:
        self._server.shutdown()
        self._server.server_close()


@beyond("plc.build.MOST_TASKS", "plc.build.LONGEST_TOPIC", "plc.plan.LONGEST_NAME")
def plc_code(patch: pytest.MonkeyPatch, folder: Path) -> None:
    many = [read(f"/t{number}", task=f"T{number}") for number in range(build.MOST_TASKS + 1)]
    refused("PLC003", lambda: project(*many))
    refused("PLC006", lambda: project(read("/" + "a" * build.LONGEST_TOPIC)))
    memory = ClassicPlan("m" * (LONGEST_NAME + 1), "s")
    refused("PLC007", lambda: project(read("/a", classic=memory)))


@beyond("plc.delivery.LARGEST_MANIFEST", "doctor.code.LARGEST_FILE")
def generated_files(patch: pytest.MonkeyPatch, folder: Path) -> None:
    from rosplc.doctor import code

    text = json.dumps({"files": {}})
    (folder / delivery.MANIFEST).write_text(text)
    patch.setattr(delivery, "LARGEST_MANIFEST", len(text) - 1)
    refused("PLC001", lambda: delivery.write_files(folder, {}))
    (folder / "Base").mkdir()
    (folder / "Base/RosPlc_Settings.st").write_text(
        "    sPrefix : STRING := 'a';\n    xFenced : BOOL := TRUE;\n"
    )
    assert code.read_generated(folder).prefix == "a"
    patch.setattr(code, "LARGEST_FILE", 30)
    with pytest.raises(ValueError, match="prefix"):
        code.read_generated(folder)


@beyond("recorder.mcap_file.MAX_CHUNK")
def recordings(patch: pytest.MonkeyPatch, folder: Path) -> None:
    from mcap.writer import Writer

    from rosplc.recorder import mcap_file

    path = folder / "a.mcap"
    with path.open("wb") as file:
        writer: Any = Writer(file)
        writer.start("ros2")
        channel = writer.register_channel("/a", "cdr", writer.register_schema("a/B", "ros2msg", b""))
        writer.add_message(channel, 1, bytes(500), 1)
        writer.finish()
    patch.setattr(mcap_file, "MAX_CHUNK", 100)
    (part,) = mcap_file.survey(path).parts
    refused("REC003", lambda: mcap_file.read_part(path, part), "100")


@beyond("monitor.watch.MAX_CHANNELS", "monitor.watch.MAX_RECORD")
def watched(patch: pytest.MonkeyPatch, folder: Path) -> None:
    from rosplc.monitor import watch as watching
    from tests.channels import layout_of

    kind, namespace = layout_of("geometry_msgs/msg/Twist"), Namespace("T", folder)
    for name in ("/a", "/b"):
        text = {"topic": name, "type": kind.type_name, "limits": kind.limits.to_dict(), "bridge": "test"}
        description = Description(
            **text,
            distro="jazzy",
            direction=constants.Direction.TO_PLC,
            layout_id=kind.layout_id,
            definition=kind.store.definition_text(kind.type_name),
        )
        OwnedChannel.open(namespace, description, record_size=kind.size, slots=4).close()
    patch.setattr(watching, "MAX_CHANNELS", 1)
    patch.setattr(watching, "MAX_RECORD", kind.size - 1)
    with watching.Watch(directory=str(folder)) as watch:
        picture = watch.look()
        assert len(picture.channels) == 1
        refused("SHM112", lambda: watch.message(picture.channels[0]), "too large")


@beyond("web.live.MAX_MESSAGES", "web.live.MAX_PLOTS", "web.live.MAX_PATH")
def page(patch: pytest.MonkeyPatch, folder: Path) -> None:
    from rosplc.web.live import MAX_MESSAGES, MAX_PATH, MAX_PLOTS, Wants

    refused("WEB009", lambda: Wants.of({"messages": ["a"] * (MAX_MESSAGES + 1)}))
    refused("WEB009", lambda: Wants.of({"plots": {"a": ["x"] * (MAX_PLOTS + 1)}}))
    refused("WEB009", lambda: Wants.of({"plots": {"a": ["x" * (MAX_PATH + 1)]}}))


@beyond("errors.LONGEST_TEXT")
def error_texts(patch: pytest.MonkeyPatch, folder: Path) -> None:
    error = RosplcError("CFG004", "a" * 10**6, where="b" * 10**6)
    assert max(len(error.what), len(error.where)) <= LONGEST_TEXT
    assert error.what.startswith("aaa")


LISTED = {f"{limit.module}.{limit.name}": limit for limits in groups().values() for limit in limits}


@pytest.mark.parametrize(
    "check", sorted(set(CHECKS.values()), key=lambda f: f.__name__), ids=lambda f: f.__name__
)
def test_what_exceeds_a_limit_is_refused(
    check: Callable[[pytest.MonkeyPatch, Path], None], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """One more than the limit is an error with its code, or is cut off as the page says."""
    check(monkeypatch, tmp_path)


def test_every_limit_is_checked() -> None:
    """Each limit on the page has a check, and each check's limit is on the page."""
    assert set(CHECKS) == set(LISTED)
    assert all(limit.value > 0 for limit in LISTED.values())


def test_pipes_and_devices_are_not_read(tmp_path: Path) -> None:
    """A pipe or a device among definitions stops nobody, and is not read."""
    os.mkfifo(tmp_path / "Pipe.msg")
    (tmp_path / "Device.msg").symlink_to("/dev/zero")
    (tmp_path / "Own.msg").write_text("bool a\n")
    found = TypeStore.bundled("jazzy").with_paths([tmp_path])
    assert any(name.endswith("/Own") for name in found.names())
    assert not any(name.endswith(("/Pipe", "/Device")) for name in found.names())
