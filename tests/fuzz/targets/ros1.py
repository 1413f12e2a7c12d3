"""What other ROS 1 programs say: connection headers, definitions in them, answers of nodes and masters."""

from __future__ import annotations

import socket
import xmlrpc.client
from collections.abc import Callable, Iterator
from contextlib import nullcontext, suppress
from types import SimpleNamespace
from typing import Any, cast
from xml.parsers.expat import ExpatError

from rosplc.errors import BackendError, MessageTypeError
from rosplc.model import TypeStore
from rosplc.ros.rospy import slave, topics, wire
from rosplc.ros.rospy._tcp import Loop
from rosplc.ros.rospy.handshake import (
    Definition,
    HandshakeError,
    encode_header,
    mismatch,
    peer_type,
    read_header,
    ros1_name,
    ros2_name,
)
from rosplc.ros.rospy.master import Master, RefusedError, UnreachableError, call
from tests.fuzz.choices import Choices
from tests.fuzz.oracle import refusals
from tests.fuzz.scratch import emptied

__all__ = ["check", "seeds"]

_ALLOWED = (HandshakeError, RefusedError, UnreachableError)


def _header(data: bytes) -> None:
    """A connection header as it comes over a socket, and what is made of its fields."""
    ours, theirs = socket.socketpair()
    with ours, theirs:
        theirs.setblocking(False)
        theirs.send(data)
        theirs.shutdown(socket.SHUT_WR)
        fields = read_header(ours, 5.0)
    kind = peer_type(fields)
    mismatch("/n", "publishes", "/t", kind, ("std_msgs/msg/String", "992ce8a1687cec8c8bd883ec73ca41d1"))
    ros1_name(ros2_name(kind[0]))
    with refusals(BackendError, MessageTypeError):
        found = wire._checked("/t", "/n", fields)
        folder = emptied("ros1")
        written = wire.save_definition(found, folder)
        assert all(path.resolve().is_relative_to(folder) for path in written)
        assert found.type_name in TypeStore.bundled("noetic").with_paths([folder]) or not written


def _stream(choices: Choices) -> None:
    """What follows the headers: messages behind their length, in whatever parts they come."""
    most, loop, sent, got = 5000, Loop(5000), b"", []
    ours, theirs = socket.socketpair()
    with ours, theirs:
        loop.receive(ours.fileno(), None, None)
        while (part := choices.part()[:60_000]) and len(sent) < 60_000:
            sent += part
            with suppress(BrokenPipeError):
                theirs.sendall(part)
            loop.wake()
            for _, messages, _ in loop.wait():
                got += messages
        loop.remove(ours.fileno())
    loop.close()
    for message in got:
        assert len(message) <= most
        assert sent[:4] == len(message).to_bytes(4, "little")
        assert sent[4 : 4 + len(message)] == message
        sent = sent[4 + len(message) :]
    assert len(sent) < 4 or int.from_bytes(sent[:4], "little") > min(most, len(sent) - 4)


class _Answer:
    """A node that answers every call with one value."""

    def __init__(self, value: Any) -> None:
        self._value = value

    def __getattr__(self, name: str) -> Any:
        return lambda *_: self._value


class _Topics:
    """A node that publishes one topic and receives none."""

    parameters = SimpleNamespace(notice=lambda: None)

    def having(self, direction: str) -> dict[str, Any]:
        definition = SimpleNamespace(type_name="std_msgs/msg/String")
        return {"/t": SimpleNamespace(info=list, definition=definition)} if direction == "out" else {}

    def publishers_changed(self, topic: str, uris: tuple[str, ...]) -> None:
        assert isinstance(topic, str)
        assert all(uri.startswith("http://") for uri in uris)

    def told_to_leave(self, caller: str, why: str) -> None:
        assert len(caller) + len(why) <= 512


def _answer(data: bytes) -> None:
    """An answer of a node or a master, or a call of our own node's interface."""
    try:
        values, method = xmlrpc.client.loads(data)
    except (xmlrpc.client.Error, ExpatError, ValueError, TypeError, LookupError, OverflowError):
        return  # what call() and the server take care of; see below
    if method is None:
        master = Master("http://localhost:1", "/n")
        master._server = cast(Any, _Answer(values[0]))
        asks: tuple[Callable[[], Any], ...] = (
            master.state,
            lambda: _publishers(master),
            lambda: master.service_place("/s"),
            lambda: master.node_uri("/m"),
            lambda: master.setting("/use_sim_time"),
            lambda: _request(values[0]),
        )
        for ask in asks:
            with suppress(*_ALLOWED):
                ask()
        return
    handler = slave._Api("http://localhost:1", cast(Any, _Topics()), ("localhost", 1))
    function = getattr(handler, method, None)
    if method in ("publisherUpdate", "requestTopic", "shutdown", "paramUpdate", "getBusInfo") and function:
        try:
            code, text, value = function(*values)
        except TypeError as error:
            if "argument" not in str(error):  # of another number: the server says so to the caller
                raise
            return
        assert isinstance(code, int)
        assert len(text) < 1000
        xmlrpc.client.dumps(((code, text, value),), methodresponse=True)


def _publishers(master: Master) -> None:
    node = SimpleNamespace(turn=nullcontext(), uri="http://n:1")
    definition = Definition("std_msgs/msg/String", "992ce8a1687cec8c8bd883ec73ca41d1", "string data\n")
    incoming = topics.Incoming(node, "/t", definition)
    incoming.register(master)
    assert all(isinstance(uri, str) for uri in incoming.publishers)


def _request(value: Any) -> None:
    setattr(topics, "proxy", lambda *_: _Closing(value))  # noqa: B010 - a name that it has imported
    host, port = topics.request("http://n:1", "/n", "/t")
    assert isinstance(host, str)
    assert 0 < port < 65536


class _Closing(_Answer):
    def __call__(self, _: str) -> Any:
        return lambda: None


def _raw(data: bytes) -> None:
    """Bytes in an answer's place: whatever the standard library makes of them, ours is one error."""

    class Server:
        def __getattr__(self, name: str) -> Any:
            def ask(*_: Any) -> Any:
                parser, target = xmlrpc.client.getparser(use_builtin_types=False)
                parser.feed(data)
                parser.close()
                values = target.close()
                return values[0] if len(values) == 1 else values

            return ask

    call(cast(Any, Server()), "getSystemState", "/n")


def check(data: bytes) -> None:
    """Whatever they say is refused with one of the backend's errors, or harmless."""
    choices = Choices(data)
    how = choices.below(5)
    try:
        if how == 0:
            _header(choices.rest()[:3000])
        elif how == 1:
            _header(_from_fields(choices))
        elif how == 4:
            _stream(choices)
        elif how == 2:
            _answer(choices.rest())
        else:
            _raw(choices.rest())
    except _ALLOWED as error:
        assert len(str(error)) < 4000


def _from_fields(choices: Choices) -> bytes:
    """Make a header of fields that are mostly those of a publisher."""
    names = ("callerid", "type", "md5sum", "message_definition", "latching", "error", "topic")
    parts = []
    for name in names[: 1 + choices.below(7)]:
        parts.append(name.encode() + b"=" + choices.part()[:2500])
    kind, text = b"", b""
    for part in parts:
        kind = part[5:] if part.startswith(b"type=") else kind
        text = part[19:] if part.startswith(b"message_definition=") else text
    if kind and text:  # the sum that this definition has, or every definition would end at it
        with refusals(MessageTypeError):
            try:
                name = kind.decode()
                store = TypeStore.bundled("noetic").with_definition(name, text.decode())
            except UnicodeDecodeError:
                pass
            else:
                parts = [part for part in parts if not part.startswith(b"md5sum=")]
                parts.append(b"md5sum=" + store.md5(name).encode())
    body = b"".join(len(part).to_bytes(4, "little") + part for part in parts)
    return len(body).to_bytes(4, "little") + body


def seeds() -> Iterator[bytes]:
    """Sound headers, definitions, answers and calls."""
    store = TypeStore.bundled("noetic")
    text = store.definition_text("sensor_msgs/msg/Imu")
    fields = {
        "callerid": "/n", "type": "sensor_msgs/Imu", "md5sum": store.md5("sensor_msgs/msg/Imu"),
        "message_definition": text, "latching": "1", "topic": "/t",
    }  # fmt: skip
    yield b"\0" + encode_header(fields)
    yield b"\0" + encode_header({"error": "no"})
    yield b"\4\3\0\0\0abc\4\0\0\xff\0abcd\xff\0\0\0\0\xff\xff\xff\xff\x7f"
    own = (
        "uint8 A=1\nstring B=x # y\nHeader header\nInner[] in\ntime t\n"
        + "=" * 80
        + "\nMSG: own_msgs/Inner\nint8 x\n"
    )
    for name, definition in (("own_msgs/Own", own), ("../x/Own", own), ("std_msgs/String", "string data\n")):
        yield b"\1\6" + b"\xff".join((b"/n", name.encode(), b"*", definition.encode(), b"1", b"", b"/t"))
    state = [[["/t", ["/n"]]], [["/t", ["/m"]]], []]
    for value in (
        [1, "", state],
        [1, "", [["/t", "std_msgs/String"]]],
        [1, "", ["TCPROS", "h", 9]],
        [0, "no", 0],
        [1, "", ["http://n:1", 3, ["http://m:1"]]],
    ):
        answer = xmlrpc.client.dumps((value,), methodresponse=True).encode()
        yield b"\2" + answer
        yield b"\3" + answer
    yield b"\2" + xmlrpc.client.dumps(("/n", "/t", ["http://n:1", "ftp://x", 3]), "publisherUpdate").encode()
    yield b"\2" + xmlrpc.client.dumps(("/n", "/t", [["TCPROS"], "x"]), "requestTopic").encode()
    yield b"\2" + xmlrpc.client.dumps(("/n", "why"), "shutdown").encode()
    yield b"\3" + b'<?xml version="1.0"?><!DOCTYPE x [<!ENTITY a "aa"><!ENTITY b "&a;&a;">]><x>&b;</x>'
