"""The parts of the ROS 1 backend that need no graph."""

from __future__ import annotations

import socket
import subprocess
import sys
import threading
from pathlib import Path
from xmlrpc.server import SimpleXMLRPCRequestHandler, SimpleXMLRPCServer

import pytest

from rosplc.errors import RosplcError
from rosplc.model import TypeStore
from rosplc.ros import Qos, open_backend
from tests.interop.ros1.graph import free_port

pytestmark = [pytest.mark.needs("python3-rospy"), pytest.mark.timeout(60)]

if not Path("/usr/lib/python3/dist-packages/rospy/__init__.py").exists():
    pytest.skip("Debian package python3-rospy is missing", allow_module_level=True)

from rosplc.ros.rospy import handshake  # noqa: E402
from rosplc.ros.rospy.address import read_address  # noqa: E402
from rosplc.ros.rospy.debian import find  # noqa: E402
from rosplc.ros.rospy.handshake import mismatch  # noqa: E402
from rosplc.ros.rospy.inbound import Incoming, RospySubscription, raw_class  # noqa: E402
from rosplc.ros.rospy.master import Master  # noqa: E402

NOETIC = TypeStore.bundled("noetic")
STRING = "std_msgs/msg/String"


def nowhere() -> dict[str, str]:
    """Return an environment whose master does not run."""
    return {"ROS_MASTER_URI": f"http://127.0.0.1:{free_port()}", "ROS_IP": "127.0.0.1"}


# -- finding rospy


def in_python(code: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)


def test_search_path_is_as_before() -> None:
    """Importing the backend leaves no folder of the system in the search path, and prints nothing."""
    done = in_python(
        "import sys; before = list(sys.path)\nimport logging; logging.basicConfig(level=logging.DEBUG)\n"
        "import rosplc.ros.rospy\nassert sys.path == before, sys.path\nassert 'rospy' in sys.modules"
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


def test_missing_package_is_said_with_its_name(tmp_path: Path) -> None:
    """Where rospy is not installed the error says which package brings it."""
    code = (
        "import sys, rosplc.ros\n"
        "class Hide:\n"
        "    def find_spec(self, name, path=None, target=None):\n"
        "        if name == 'rospy': raise ModuleNotFoundError('no rospy', name='rospy')\n"
        "sys.meta_path.insert(0, Hide())\n"
        "from rosplc.model import TypeStore\n"
        "try: rosplc.ros.open_backend('rospy', TypeStore.bundled('noetic'), 'cell')\n"
        "except rosplc.ros.BackendError as error: print(error)\n"
    ).replace("rosplc.ros.BackendError", "__import__('rosplc.errors').errors.BackendError")
    done = in_python(code)
    assert "ROS001" in done.stdout and "apt-get install python3-rospy" in done.stdout, done


def test_package_that_cannot_be_loaded_is_told_from_a_missing_one(tmp_path: Path) -> None:
    """A rospy that this interpreter cannot load is not called missing."""
    (tmp_path / "rospy").mkdir()
    (tmp_path / "rospy/__init__.py").write_text("import no_such_compiled_module\n")
    code = (
        f"import sys; sys.path.insert(0, {str(tmp_path)!r})\n"
        "try:\n    import rosplc.ros.rospy\nexcept ImportError as error: print(error)\n"
    )
    words = in_python(code).stdout
    assert "cannot load it (No module named 'no_such_compiled_module')" in words
    assert "/usr/bin/python3" in words


def test_rospy_is_found_once_only() -> None:
    """A second search gives the modules of the first."""
    assert find()["rospy.msg"].AnyMsg is find(())["rospy.msg"].AnyMsg


# -- the environment


@pytest.mark.parametrize(
    ("environment", "host", "bind"),
    [
        ({"ROS_IP": "127.0.0.1"}, "127.0.0.1", "127.0.0.1"),
        ({"ROS_IP": "192.168.1.10"}, "192.168.1.10", ""),
        ({"ROS_HOSTNAME": "localhost"}, "localhost", "127.0.0.1"),
        ({"ROS_HOSTNAME": "cell1.local", "ROS_IP": "127.0.0.1"}, "cell1.local", ""),
        ({}, socket.gethostname(), ""),
    ],
)
def test_address_follows_ros1(environment: dict[str, str], host: str, bind: str) -> None:
    """ROS_HOSTNAME comes before ROS_IP, a loopback address is listened at alone, the default is the host."""
    address = read_address(environment)
    assert (address.host, address.bind) == (host, bind)
    assert address.master == "http://localhost:11311"


@pytest.mark.parametrize(
    ("variable", "value"),
    [
        ("ROS_MASTER_URI", "localhost:11311"),
        ("ROS_MASTER_URI", "http://localhost"),
        ("ROS_MASTER_URI", "http://localhost:port"),
        ("ROS_IP", ""),
        ("ROS_IP", "cell1"),
        ("ROS_IP", "192.168.1.10:11311"),
        ("ROS_HOSTNAME", ""),
        ("ROS_HOSTNAME", "http://cell1"),
        ("ROS_IPV6", "on"),
    ],
)
def test_wrong_variable_is_named(variable: str, value: str) -> None:
    """A value that cannot be is refused with the variable's name."""
    with pytest.raises(RosplcError, match=rf"{variable} is .*ROS010"):
        open_backend("rospy", NOETIC, "cell", environment={variable: value})


def test_address_that_cannot_be_listened_at_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """An address that the system refuses is an error of the environment."""

    def refuse(*_: object) -> None:
        raise OSError(99, "Cannot assign requested address")

    monkeypatch.setattr("socketserver.TCPServer.server_bind", refuse)
    with pytest.raises(RosplcError, match=r"cannot listen at 127\.0\.0\.1.*ROS010"):
        open_backend("rospy", NOETIC, "cell", environment=nowhere())


# -- types


def test_ros2_definitions_are_refused() -> None:
    """With the definitions of a ROS 2 distribution the backend does not open."""
    with pytest.raises(RosplcError, match=r"jazzy is ROS 2.*ROS001"):
        open_backend("rospy", TypeStore.bundled("jazzy"), "cell", environment=nowhere())


def test_message_class_carries_the_type() -> None:
    """The class that rospy sees has ROS 1's name of the type, its sum and its definition."""
    text = NOETIC.definition_text(STRING)
    kind = raw_class(STRING, NOETIC.md5(STRING), text)
    assert (kind._type, kind._md5sum, kind._full_text) == (
        "std_msgs/String", "992ce8a1687cec8c8bd883ec73ca41d1", text,
    )  # fmt: skip


def test_one_topic_has_one_type_in_a_node() -> None:
    """A second type on a topic of the same node and direction is refused; the other direction is free."""
    node = open_backend("rospy", NOETIC, "cell", environment=nowhere())
    try:
        node.advertise("/a", STRING, Qos())
        with pytest.raises(RosplcError, match=r"/a as std_msgs/msg/String already.*ROS002"):
            node.advertise("/a", "std_msgs/msg/Int32", Qos())
        node.subscribe("/a", "std_msgs/msg/Int32", Qos(), lambda *_: None)
        assert len(node.status()) == 2
    finally:
        node.close()


@pytest.mark.parametrize(
    ("theirs", "code"),
    [
        (("a/msg/B", "1"), None),
        (("*", "*"), None),
        (("a/msg/B", "*"), None),
        (("*", "2"), "ROS003"),
        (("a/msg/B", "2"), "ROS003"),
        (("a/msg/C", "1"), "ROS003"),
    ],
)
def test_types_are_compared_by_name_and_sum(theirs: tuple[str, str], code: str | None) -> None:
    """A star stands for anything; a difference is told with both sides."""
    found = mismatch("/peer", "publishes", "/t", theirs, ("a/msg/B", "1"))
    assert (found and found[0]) == code
    if found and theirs[1] == "2":
        assert "md5 2 there, 1 here" in found[1]


# -- bytes on a connection


def read(data: bytes, *, close: bool = True) -> dict[str, str]:
    here, there = socket.socketpair()
    with here, there:
        there.sendall(data)
        if close:
            there.shutdown(socket.SHUT_WR)
        return handshake.read_header(here, 0.2)


def test_header_is_read_to_its_end_and_no_further() -> None:
    """What stands behind the header stays in the connection."""
    here, there = socket.socketpair()
    with here, there:
        handshake.write_header(there, {"topic": "/a", "note": "x=y"})
        there.sendall(b"behind")
        assert handshake.read_header(here, 5.0) == {"topic": "/a", "note": "x=y"}
        assert here.recv(100) == b"behind"


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"\1\0",
        b"\xff\xff\xff\xff",
        b"\4\0\0\0abcd",
        b"\5\0\0\0\0\0\0\0x",
        b"\6\0\0\0\2\0\0\0\xff=",
        b"\x08\0\0\0",
    ],
    ids=repr,
)
def test_no_header_is_an_error(data: bytes) -> None:
    """Nonsense, endless lengths and early ends are one kind of error."""
    with pytest.raises(handshake.HandshakeError):
        read(data)


def test_header_that_does_not_come_is_not_waited_for() -> None:
    """A connection that says nothing is given up."""
    with pytest.raises(handshake.HandshakeError, match="in time"):
        read(b"\x10\0\0\0", close=False)


def incoming() -> Incoming:
    lock, many = threading.RLock(), threading.Semaphore(1)
    return Incoming("/node", "/t", STRING, "0", "string data\n", lock, many, lambda: None)


def test_messages_beyond_the_depth_give_way_and_are_counted() -> None:
    """Of messages that arrive together the newest ``depth`` are handed over, in order."""
    topic, got = incoming(), []
    subscription = RospySubscription(
        topic, Qos(depth=3), lambda payload, _: got.append(payload), lambda _: ("", ""), lambda _: None
    )
    topic.add(subscription)
    topic.deliver([bytes([number]) for number in range(10)])
    assert got == [b"\7", b"\x08", b"\x09"]
    assert (subscription.status().received, subscription.status().dropped) == (3, 7)


# -- the master


def test_large_graphs_are_read_call_after_call() -> None:
    """An answer that Python's servers would compress is read, and so is the next on the same connection."""

    class Handler(SimpleXMLRPCRequestHandler):
        protocol_version = "HTTP/1.1"  # as rosmaster's: the connection is kept

    rows = [[f"/topic{number}", ["/node"]] for number in range(500)]
    with SimpleXMLRPCServer(("127.0.0.1", 0), Handler, logRequests=False) as server:
        server.register_function(lambda _caller: (1, "", [rows, [], []]), "getSystemState")
        server.register_function(lambda _caller: (1, "", []), "getTopicTypes")
        threading.Thread(target=server.serve_forever, daemon=True).start()
        master = Master(f"http://127.0.0.1:{server.server_address[1]}", "/caller")
        try:
            for _ in range(3):
                assert len(master.state().publishers) == 500
        finally:
            master.close()
            server.shutdown()
