"""Types that are taken from a running publisher."""

from __future__ import annotations

import json
import os
import socket
import threading
import xmlrpc.server
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from rosplc.errors import RosplcError
from rosplc.model import TypeStore
from rosplc.ros import LATCHED, Qos, open_backend
from tests.interop.ros1.graph import PACKAGES, Graph, lend
from tests.interop.ros1.test_peers import PART, PART_FILE, PART_STORE, Inbox, part_defines, string
from tests.lib.waiting import wait_for

pytestmark = [
    pytest.mark.needs(*PACKAGES),
    pytest.mark.timeout(120),
    pytest.mark.verifies("ros1-definitions", real="roscpp", own="publishers of false definitions"),
]

STORE = TypeStore.bundled("noetic")


@pytest.fixture
def ros1() -> Iterator[Graph]:
    with lend() as graph:
        yield graph


def wire() -> Any:
    """Return the module under test; it can be imported where rospy is."""
    import rosplc.ros.rospy

    return rosplc.ros.rospy


def test_custom_type_is_learnt_from_a_roscpp_program(ros1: Graph, tmp_path: Path) -> None:
    """A type known to a roscpp program alone is asked of it, saved, and then carries messages both ways."""
    peer = ros1.peer("roscpp", "cpp", *part_defines())
    said = peer.advertise("/parts", PART, LATCHED)
    found = wire().definition_on_wire("/parts", environment=ros1.environment)
    assert (found.node, found.type_name, found.latching) == ("/cpp", PART, True)
    assert found.md5 == PART_STORE.md5(PART)
    saved = wire().save_definition(found, tmp_path)
    assert saved == (tmp_path / "cell_msgs/msg/Part.msg",)
    assert wire().save_definition(found, tmp_path) == saved  # again: nothing to change
    store = STORE.with_paths([tmp_path])
    assert store.md5(PART) == found.md5
    cell = open_backend("rospy", store, "cell", environment=ros1.environment)
    try:
        inbox = Inbox()
        subscription = cell.subscribe("/parts", PART, Qos(), inbox)
        wait_for(lambda: subscription.matched)
        said.write(bytes(12) + string("base") + string("S-17") + bytes(56) + bytes(4) + b"\1")
        wait_for(lambda: inbox)
        assert inbox[0][4:] == bytes(8) + string("base") + string("S-17") + bytes(56) + bytes(4) + b"\1"
    finally:
        cell.close()


def test_comments_and_dependencies_are_saved(ros1: Graph, tmp_path: Path) -> None:
    """The files hold the text as it came, comments included, one for each type that noetic lacks."""
    tree = {
        "cell_msgs/msg/Part.msg": PART_FILE + "Side[2] sides  # left and right\n",
        "cell_msgs/msg/Side.msg": "# One side.\nother_msgs/Colour colour\n",
        "other_msgs/msg/Colour.msg": "uint8[3] rgb\n",
    }
    for name, text in tree.items():
        (tmp_path / "there" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "there" / name).write_text(text)
    theirs = STORE.with_paths([tmp_path / "there"])
    cell = open_backend("rospy", theirs, "cell", environment=ros1.environment)
    try:
        cell.advertise("/parts", PART, Qos())
        found = wire().definition_on_wire("/parts", environment=ros1.environment)
    finally:
        cell.close()
    saved = wire().save_definition(found, tmp_path / "here")
    assert {str(file.relative_to(tmp_path / "here")) for file in saved} == set(tree)
    assert STORE.with_paths([tmp_path / "here"]).md5(PART) == theirs.md5(PART)
    (tmp_path / "here/cell_msgs/msg/Side.msg").write_text("uint8 other\n")
    with pytest.raises(RosplcError, match=r"Side\.msg: .*contains another definition.*TYP009"):
        wire().save_definition(found, tmp_path / "here")


def test_nobody_to_ask_is_said(ros1: Graph) -> None:
    """Without a publisher, and without a master, the error says so."""
    with pytest.raises(RosplcError, match=r"no node publishes /parts.*ROS017"):
        wire().definition_on_wire("/parts", 0.0, environment=ros1.environment)
    ros1.kill_master()
    with pytest.raises(RosplcError, match=r"does not answer.*ROS014"):
        wire().definition_on_wire("/parts", 0.0, environment=ros1.environment)


class Liar:
    """A publisher that answers with a header of the test's choice."""

    def __init__(self, ros1: Graph, answer: bytes) -> None:
        self._data = socket.create_server(("127.0.0.1", 0))
        self._answer = answer
        port = self._data.getsockname()[1]
        self._rpc = xmlrpc.server.SimpleXMLRPCServer(("127.0.0.1", 0), logRequests=False)
        self._rpc.register_function(lambda *_: [1, "ready", ["TCPROS", "127.0.0.1", port]], "requestTopic")
        self._threads = [threading.Thread(target=work) for work in (self._rpc.serve_forever, self._serve)]
        for thread in self._threads:
            thread.start()
        uri = f"http://127.0.0.1:{self._rpc.server_address[1]}/"
        master = xmlrpc.client.ServerProxy(ros1.environment["ROS_MASTER_URI"])
        master.registerPublisher("/liar", "/parts", "cell_msgs/Part", uri)
        master("close")()

    def _serve(self) -> None:
        while True:
            try:
                sock, _ = self._data.accept()
            except OSError:
                return
            with sock:
                sock.recv(65536)
                sock.sendall(self._answer)

    def close(self) -> None:
        self._data.shutdown(socket.SHUT_RDWR)
        self._data.close()
        self._rpc.shutdown()
        self._rpc.server_close()
        for thread in self._threads:
            thread.join()


def header(**fields: str) -> bytes:
    parts = [f"{name}={value}".encode() for name, value in fields.items()]
    body = b"".join(len(part).to_bytes(4, "little") + part for part in parts)
    return len(body).to_bytes(4, "little") + body


LIES = {
    "nothing": (b"", "ROS017"),
    "an endless header": (b"\xff\xff\xff\xff", "ROS017"),
    "no header": (b"\4\0\0\0abcd", "ROS017"),
    "no definition": (header(type="cell_msgs/Part", md5sum="0" * 32), "ROS017"),
    "another sum": (header(type="cell_msgs/Part", md5sum="0" * 32, message_definition="uint8 a\n"), "ROS017"),
    "no syntax": (header(type="cell_msgs/Part", md5sum="0" * 32, message_definition="uint8 =\n"), "TYP002"),
    "a path for a name": (
        header(type="../../etc/x", md5sum="0" * 32, message_definition="uint8 a\n"),
        "TYP001",
    ),
    "noetic's own, changed": (
        header(type="std_msgs/String", md5sum="0" * 32, message_definition="uint8 data\n"),
        "TYP005",
    ),
    "itself": (header(type="a/B", md5sum="0" * 32, message_definition="B b\n"), "TYP003"),
    "a million fields": (
        header(
            type="a/B", md5sum="0" * 32, message_definition="".join(f"uint8 f{n}\n" for n in range(20_000))
        ),
        "TYP007",
    ),
}


@pytest.mark.parametrize("lie", LIES)
def test_lies_are_refused(ros1: Graph, lie: str) -> None:
    """A publisher that tells nonsense gets a clear error, and nothing of it is used."""
    answer, code = LIES[lie]
    liar = Liar(ros1, answer)
    try:
        with pytest.raises(RosplcError) as refused:
            wire().definition_on_wire("/parts", 0.0, environment=ros1.environment)
        assert refused.value.code == code
    finally:
        liar.close()


def test_verb_asks_and_saves(ros1: Graph, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """`rosplc types --from-topic` shows the type as the PLC will have it, and --save writes it."""
    from typer.testing import CliRunner

    from rosplc.cli.app import app

    for name, value in ros1.environment.items():
        monkeypatch.setenv(name, value)
    ros1.peer("roscpp", "cpp", *part_defines()).advertise("/parts", PART)
    wire()
    folder = tmp_path / "msg"
    shown = CliRunner().invoke(app, ["types", "--from-topic", "/parts", "--save", str(folder)])
    assert shown.exit_code == 0, shown.output
    assert f"/parts of node /cpp, md5 {PART_STORE.md5(PART)}" in shown.output
    assert f"written: {folder}/cell_msgs/msg/Part.msg" in shown.output
    again = CliRunner().invoke(app, ["types", "--from-topic", "/parts", "--json"])
    facts = json.loads(again.output)
    assert (facts["type"], facts["node"], facts["md5"]) == (PART, "/cpp", PART_STORE.md5(PART))
    assert os.listdir(folder) == ["cell_msgs"]
    for wrong in (
        ["--save", "x"],
        ["--from-topic", "/a", "std_msgs/String"],
        ["--from-topic", "/a", "--timeout", "nan"],
    ):
        assert CliRunner().invoke(app, ["types", *wrong]).exit_code == 2
