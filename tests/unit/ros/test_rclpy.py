"""The rclpy backend, over the double: what the suite over all backends does not ask.

Nothing here is rclpy itself: with an installed one the suite of tests/conformance runs over it.
"""

from __future__ import annotations

import importlib
import importlib.util
import itertools
import os
import sys
import threading
import time
import types
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from rosplc.errors import RosplcError
from rosplc.model import TypeStore
from rosplc.ros import LATCHED, Backend, Qos, open_backend
from tests.doubles.ros2 import double, installed
from tests.interop.graphs import STRING, string
from tests.lib.waiting import wait_for

pytestmark = [
    pytest.mark.needs(when=importlib.util.find_spec("rclpy") is None, why="the real rclpy is here"),
]

STORE = TypeStore.bundled("jazzy")
_domains = itertools.count(1)


class Machine:
    """Nodes on the double, in a domain of their own."""

    def __init__(self, rclpy: Any) -> None:
        self.rclpy = rclpy
        self.domain = next(_domains)
        self._open: list[Backend] = []

    def node(self, name: str, store: TypeStore = STORE, **options: Any) -> Any:
        options.setdefault("domain", self.domain)
        backend = open_backend("rclpy", store, name, **options)
        self._open.append(backend)
        return backend

    def native(self, name: str = "native") -> Any:
        """Return a node of the double's own, and a function that makes message classes."""
        context = importlib.import_module("rclpy.context").Context()
        context.init(args=[], domain_id=self.domain)
        return importlib.import_module("rclpy.node").Node(name, context=context)

    def close(self) -> None:
        for backend in self._open:
            backend.close()


@pytest.fixture(params=["jazzy", "humble"])
def distro(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture
def machine(distro: str, monkeypatch: pytest.MonkeyPatch) -> Iterator[Machine]:
    monkeypatch.delenv("ROS_DOMAIN_ID", raising=False)
    with double(distro) as rclpy:
        machine = Machine(rclpy)
        yield machine
        machine.close()


def refused(call: Callable[[], object]) -> RosplcError:
    with pytest.raises(RosplcError) as caught:
        call()
    return caught.value


def message_class(name: str) -> Any:
    return importlib.import_module("rosplc.ros.rclpy.endpoint").message_class(name)


# -- types


FIELDS = {
    # As the generated classes of ROS 2 have them, e.g. sensor_msgs/msg/_joint_state.py.
    "sensor_msgs/msg/JointState": {
        "header": "std_msgs/Header",
        "name": "sequence<string>",
        "position": "sequence<double>",
        "velocity": "sequence<double>",
        "effort": "sequence<double>",
    },
    "geometry_msgs/msg/PoseWithCovariance": {"pose": "geometry_msgs/Pose", "covariance": "double[36]"},
    "std_msgs/msg/Byte": {"data": "octet"},
    "std_msgs/msg/Char": {"data": "uint8"},
    "std_msgs/msg/Bool": {"data": "boolean"},
    "std_msgs/msg/Float32": {"data": "float"},
    "diagnostic_msgs/msg/DiagnosticStatus": {
        "level": "octet",
        "name": "string",
        "message": "string",
        "hardware_id": "string",
        "values": "sequence<diagnostic_msgs/KeyValue>",
    },
}


@pytest.mark.parametrize("name", FIELDS)
def test_fields_are_written_as_generated_classes_write_them(name: str) -> None:
    """The comparison's own words are those of classes that ROS generates."""
    with double():
        field_text = importlib.import_module("rosplc.ros.rclpy.endpoint").field_text
        assert {field.name: field_text(field.type) for field in STORE[name].fields} == FIELDS[name]
        assert message_class(name).get_fields_and_field_types() == FIELDS[name]


def test_bounds_are_part_of_the_comparison() -> None:
    """Bounded strings and sequences are written with their bounds."""
    store = STORE.with_definition("cell_msgs/msg/B", "string<=8 a\nint32[<=5] b\nstring<=3[] c\nbyte[4] d\n")
    with double():
        field_text = importlib.import_module("rosplc.ros.rclpy.endpoint").field_text
        texts = [field_text(field.type) for field in store["cell_msgs/msg/B"].fields]
    assert texts == ["string<8>", "sequence<int32, 5>", "sequence<string<3>>", "octet[4]"]


def test_missing_message_package_is_named(machine: Machine) -> None:
    """A type whose package is not installed is refused with the package's name, in both directions."""
    node = machine.node("node")
    with installed(STORE, without=["sensor_msgs"]):
        for call in (
            lambda: node.advertise("/joints", "sensor_msgs/msg/JointState", Qos()),
            lambda: node.subscribe("/joints", "sensor_msgs/msg/JointState", Qos(), lambda *_: None),
            lambda: node.check("sensor_msgs/msg/JointState"),
        ):
            error = refused(call)
            assert error.code == "ROS011"
            assert "sensor_msgs" in error.what
            assert "ros-DISTRO-sensor-msgs" in error.remedy
    assert node.status() == ()


def test_missing_message_in_a_package_is_named(machine: Machine) -> None:
    """A package that is installed without the message is told apart."""
    store = STORE.with_definition("std_msgs/msg/Newest", "int32 a\n")
    error = refused(lambda: machine.node("node", store).advertise("/n", "std_msgs/msg/Newest", Qos()))
    assert (error.code, "has no message Newest" in error.what) == ("ROS011", True)


def test_message_class_of_ros_1_is_told_apart(machine: Machine, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where ROS 1's package of the same name comes first, the error says so, and where it lies."""
    module = types.ModuleType("std_msgs.msg")
    module.__file__ = "/usr/lib/python3/dist-packages/std_msgs/msg/__init__.py"
    module.String = type("String", (), {"_type": "std_msgs/String"})  # type: ignore[attr-defined]
    node = machine.node("node")
    monkeypatch.setitem(sys.modules, "std_msgs.msg", module)
    error = refused(lambda: node.advertise("/chatter", STRING, Qos()))
    assert error.code == "ROS011"
    assert f"not a ROS 2 package ({module.__file__})" in error.what


@pytest.mark.parametrize(
    ("theirs", "words"),
    [
        ("int32 a\nfloat32 b\n", "field 2: `float b` in the package, `int32 b` in the bridge"),
        ("int32 b\nint32 a\n", "field 1: `int32 b` in the package, `int32 a` in the bridge"),
        ("int32 a\n", "`int32 b` exists only in the bridge"),
        ("int32 a\nint32 b\nint32 c\n", "`int32 c` exists only in the package"),
    ],
)
def test_another_installed_definition_is_refused(machine: Machine, theirs: str, words: str) -> None:
    """A type that is installed with other fields is refused, and the first difference is named."""
    name = "cell_msgs/msg/State"
    node = machine.node("node", STORE.with_definition(name, "int32 a\nint32 b\n"))
    with installed(STORE.with_definition(name, theirs)):
        error = refused(lambda: node.advertise("/state", name, Qos()))
    assert error.code == "ROS012"
    assert words in error.what


def test_difference_in_a_nested_type_is_found(machine: Machine) -> None:
    """The comparison goes through nested types, also in arrays."""
    outer, inner = "cell_msgs/msg/Outer", "cell_msgs/msg/Inner"
    ours = STORE.with_definition(inner, "int32 a\n").with_definition(outer, "cell_msgs/Inner[3] parts\n")
    theirs = STORE.with_definition(inner, "uint32 a\n").with_definition(outer, "cell_msgs/Inner[3] parts\n")
    node = machine.node("node", ours)
    with installed(theirs):
        error = refused(lambda: node.check(outer))
    assert error.code == "ROS012"
    assert inner in error.what


# -- whose process it is


def test_nothing_of_the_process_is_touched(machine: Machine) -> None:
    """No default context, no signal handlers and no arguments of the program are used."""
    node = machine.node("node")
    node.advertise("/chatter", STRING, Qos())
    node.close()
    assert machine.rclpy.USED_PROCESS_WIDE == []


def test_given_node_is_left_alone(machine: Machine) -> None:
    """On a node that the caller spins, endpoints are closed with the backend, and the node stays."""
    native = machine.native()
    executor = importlib.import_module("rclpy.executors").SingleThreadedExecutor(context=native.context)
    executor.add_node(native)
    thread = threading.Thread(target=executor.spin)
    thread.start()
    backend = importlib.import_module("rosplc.ros.rclpy").from_node(native, STORE)
    got: list[bytes] = []
    backend.subscribe("/chatter", STRING, Qos(), lambda payload, _: got.append(payload))
    publisher = machine.node("talker").advertise("/chatter", STRING, Qos())
    publisher.write(string("hello"))
    wait_for(lambda: got)
    backend.close()
    wait_for(lambda: publisher.matched == 0)
    assert native.context.ok()
    assert executor.get_nodes() == [native]
    executor.shutdown()
    thread.join()
    native.context.try_shutdown()


def test_context_that_somebody_shuts_down_is_noticed(
    machine: Machine, caplog: pytest.LogCaptureFixture
) -> None:
    """If the context is shut down from outside, the status says so, and closing still works."""
    node = machine.node("node")
    publisher = node.advertise("/chatter", STRING, Qos())
    node._node.context.try_shutdown()
    wait_for(lambda: publisher.status().reason == "the ROS context was shut down")
    assert publisher.status().code == "ROS009"
    assert "the ROS context was shut down by other code" in caplog.text
    node.close()


# -- names, arguments, domains, parameters


def test_ros_arguments_apply_to_the_node(machine: Machine) -> None:
    """`ros_args` rename the node and its topics, as on the command line of any node."""
    arguments = ["--ros-args", "-r", "__node:=cell", "-r", "__ns:=/robot1", "-r", "cmd_vel:=base/cmd_vel"]
    node = machine.node("rosplc", options={"ros_args": arguments})
    assert node.node == "/robot1/cell"
    assert node.advertise("cmd_vel", STRING, Qos()).topic == "/robot1/base/cmd_vel"
    assert [one.topic for one in node.status()] == ["/robot1/base/cmd_vel"]


@pytest.mark.parametrize(
    "options",
    [{"ros_arg": []}, {"ros_args": "-r a:=b"}, {"ros_args": [1]}],
    ids=str,
)
def test_wrong_options_are_refused(machine: Machine, options: dict[str, object]) -> None:
    """A misspelt key or a value of another kind is an error that says what would be right."""
    assert refused(lambda: machine.node("node", options=options)).code == "ROS013"


def test_arguments_that_rcl_refuses_are_reported(machine: Machine) -> None:
    """What the middleware says of wrong arguments is passed on, and nothing is left behind."""
    before = threading.active_count()
    error = refused(lambda: machine.node("node", options={"ros_args": ["--remapp", "a:=b"]}))
    assert (error.code, "unknown ROS argument" in error.what) == ("ROS002", True)
    assert threading.active_count() == before


@pytest.mark.parametrize(
    ("domain", "environment", "expected"),
    [(None, {"ROS_DOMAIN_ID": "41"}, 41), (42, {"ROS_DOMAIN_ID": "41"}, 42)],
)
def test_domain_comes_from_settings_or_environment(
    machine: Machine, domain: int | None, environment: dict[str, str], expected: int
) -> None:
    """The configuration's domain comes before ``ROS_DOMAIN_ID``."""
    assert machine.node("node", domain=domain, environment=environment).domain == expected


def test_domain_of_the_process_is_left_to_rcl(machine: Machine, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without settings the process's ``ROS_DOMAIN_ID`` holds; one that is no number is refused."""
    monkeypatch.setenv("ROS_DOMAIN_ID", "43")
    assert machine.node("node", domain=None).domain == 43
    error = refused(lambda: machine.node("node", domain=None, environment={"ROS_DOMAIN_ID": "x"}))
    assert error.code == "ROS010"


def test_domain_that_the_middleware_refuses_is_reported(machine: Machine) -> None:
    """A domain that is too large is ROS002."""
    assert refused(lambda: machine.node("node", domain=9999)).code == "ROS002"


def test_ros_1_types_are_refused(machine: Machine) -> None:
    """The backend speaks ROS 2."""
    assert refused(lambda: machine.node("node", TypeStore.bundled("noetic"))).code == "ROS001"


@pytest.mark.parametrize("served", [True, False])
def test_services_of_parameters(machine: Machine, monkeypatch: pytest.MonkeyPatch, served: bool) -> None:
    """A node has rclpy's, unless the bridge serves them."""
    backend = importlib.import_module("rosplc.ros.rclpy.backend")
    asked: dict[str, object] = {}
    make = backend.Node
    monkeypatch.setattr(backend, "Node", lambda *names, **how: asked.update(how) or make(*names, **how))
    machine.node("node", options={} if served else {"parameter_services": False})
    assert asked["start_parameter_services"] is served


# -- messages


def test_stamp_is_the_senders_where_rclpy_tells_it(machine: Machine, distro: str) -> None:
    """Since Iron the source stamp is handed on; on Humble it is the time of arrival."""
    got: list[int] = []
    publisher = machine.node("talker").advertise("/map", STRING, LATCHED)
    publisher.write(string("old"))
    sent = time.time_ns()
    machine.node("listener").subscribe("/map", STRING, LATCHED, lambda _, stamp: got.append(stamp))
    wait_for(lambda: got)
    assert (got[0] <= sent) is (distro == "jazzy")


@pytest.mark.parametrize("lacking", [False, True])
def test_waiting_messages_are_taken_at_once(
    machine: Machine, lacking: bool, caplog: pytest.LogCaptureFixture
) -> None:
    """What waits behind a message is taken without another wait, up to a bound, in order; by any executor."""
    executors = importlib.import_module("rclpy.executors")
    implementation = importlib.import_module("rclpy.impl.implementation_singleton").rclpy_implementation
    waits: list[str] = []

    def counted(name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        return lambda *arguments: waits.append(name) or function(*arguments)  # type: ignore[func-returns-value]

    executors._take = counted("executor", executors._take)
    implementation.WaitSet.wait = counted("wait set", implementation.WaitSet.wait)
    if lacking:
        del implementation.WaitSet
    got: list[bytes] = []
    node = machine.node("listener")
    hold = threading.Event()
    qos = Qos(depth=500)
    node.subscribe("/a", STRING, qos, lambda payload, _: (hold.wait(), got.append(payload)))
    publisher = machine.node("talker").advertise("/a", STRING, qos)
    publisher.write(string("0"))
    time.sleep(0.1)
    waits.clear()
    for number in range(1, 300):
        publisher.write(string(str(number)))
    hold.set()
    wait_for(lambda: len(got) == 300)
    assert got == [string(str(number)) for number in range(300)]
    assert 1 <= len(waits) <= 10
    assert set(waits) == {"executor" if lacking else "wait set"}
    assert ("rclpy's executor receives all messages" in caplog.text) is lacking


def test_events_are_seen_between_messages(machine: Machine, caplog: pytest.LogCaptureFixture) -> None:
    """A node that receives without a pause notices a peer that does not fit."""
    got: list[bytes] = []
    node, talker = machine.node("listener"), machine.node("talker")
    node.subscribe("/busy", STRING, Qos(), lambda payload, _: got.append(payload))
    node.subscribe("/chatter", STRING, Qos(), lambda *_: None)
    publisher = talker.advertise("/busy", STRING, Qos())
    publisher.write(string("first"))
    wait_for(lambda: got)
    profile = importlib.import_module("rclpy.qos").QoSProfile(
        depth=1, reliability=importlib.import_module("rclpy.qos").ReliabilityPolicy.BEST_EFFORT
    )
    machine.native("peer").create_publisher(message_class(STRING), "/chatter", profile)

    def noticed() -> bool:
        publisher.write(string("more"))
        return "node /peer publishes /chatter" in caplog.text

    wait_for(noticed)


def test_task_that_comes_during_a_look_is_done(machine: Machine) -> None:
    """What is given to the executor after it has looked for tasks, and before it waits, is not forgotten."""
    executors = importlib.import_module("rclpy.executors")
    node, done, looks = machine.node("node"), threading.Event(), []
    looked = executors.Executor._ready

    def look(self: Any) -> Any:
        if (work := looked(self)) is None and not looks:
            looks.append(1)
            self.create_task(done.set)
        return work

    executors.Executor._ready = look
    node._node.executor.wake()
    wait_for(done.is_set)


def test_refusing_middleware_is_an_error_of_the_write(machine: Machine) -> None:
    """If publishing fails the writer is told, and later messages go through."""
    graph = importlib.import_module("rclpy._graph")
    publisher = machine.node("talker").advertise("/chatter", STRING, Qos())
    graph.unsupported.add("publish")
    assert refused(lambda: publisher.write(string("x"))).code == "ROS002"
    graph.unsupported.clear()
    assert publisher.write(string("y"))
    assert publisher.status().sent == 1


def test_bytes_are_given_to_rclpy_as_bytes(machine: Machine) -> None:
    """The middleware takes ``bytes`` alone; views and bytearrays are converted."""
    got: list[bytes] = []
    machine.node("listener").subscribe("/chatter", STRING, Qos(), lambda payload, _: got.append(payload))
    publisher = machine.node("talker").advertise("/chatter", STRING, Qos())
    publisher.write(memoryview(bytearray(string("x"))))
    wait_for(lambda: got)
    assert got == [string("x")]


# -- events and reasons


@pytest.mark.parametrize("missing", ["message_lost", "incompatible_qos", "incompatible_type"])
def test_events_that_the_middleware_lacks_are_done_without(machine: Machine, missing: str) -> None:
    """An event that the RMW does not support keeps no endpoint from being created."""
    graph = importlib.import_module("rclpy._graph")
    graph.unsupported.add(missing)
    node = machine.node("node")
    node.advertise("/a", STRING, Qos())
    node.subscribe("/a", STRING, Qos(), lambda *_: None)
    assert {status.matched for status in node.status()} == {1}


def test_misfit_is_logged_once_with_its_reason(machine: Machine, caplog: pytest.LogCaptureFixture) -> None:
    """The middleware's event leads to one line in the log that names the peer and the settings."""
    machine.node("talker").advertise("/chatter", STRING, Qos(reliability="best_effort"))
    subscription = machine.node("listener").subscribe("/chatter", STRING, Qos(), lambda *_: None)
    words = (
        f"node /talker publishes /chatter as {STRING}, but the publisher is best_effort "
        "and the subscriber requests reliable"
    )
    wait_for(lambda: words in caplog.text)
    assert caplog.text.count(words) == 1
    assert subscription.status().code == "ROS004"


@pytest.mark.parametrize(
    ("wish", "words"),
    [
        ({"deadline": 1_000_000}, "offers no deadline and the subscriber requests 1 ms"),
        ({"liveliness_lease_duration": 2_000_000}, "no liveliness lease and the subscriber requests 2 ms"),
        ({"liveliness": 3}, "the subscriber requests manual liveliness"),
        ({}, ""),
    ],
)
def test_promises_that_keep_a_peer_away_are_named(machine: Machine, wish: dict[str, int], words: str) -> None:
    """What discovery shows as infinite is no wish; a deadline, a lease and manual liveliness are."""
    qos, duration = importlib.import_module("rclpy.qos"), importlib.import_module("rclpy.duration").Duration
    wishes = {
        name: value if name == "liveliness" else duration(nanoseconds=value) for name, value in wish.items()
    }
    profile = qos.QoSProfile(depth=1, **wishes)
    machine.native("peer").create_subscription(
        message_class(STRING), "/chatter", lambda _: None, profile, raw=True
    )
    status = machine.node("talker").advertise("/chatter", STRING, Qos()).status()
    assert status.code == ("ROS004" if words else "")
    assert words in status.reason


@pytest.mark.parametrize("payload", [b"", b"\0", b"\0\7\0\0"])
def test_message_that_is_none_does_not_stop_the_others(machine: Machine, payload: bytes) -> None:
    """Bytes that are no CDR are counted, even those that the middleware's take fails on."""
    got: list[bytes] = []
    subscription = machine.node("listener").subscribe("/a", STRING, Qos(), lambda p, _: got.append(p))
    publisher = machine.native("peer").create_publisher(
        message_class(STRING), "/a", importlib.import_module("rclpy.qos").QoSProfile(depth=10)
    )
    for each in (payload, string("x"), payload, payload, string("y")):
        publisher.publish(each)
    wait_for(lambda: len(got) == 2)
    assert got == [string("x"), string("y")]
    status = subscription.status()
    assert (status.received, status.rejected) == (2, 3)
    assert "were not valid ROS 2 messages" in status.reason


def test_match_that_nothing_explains_is_told_after_a_while(
    machine: Machine, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A peer that should match and does not is first not matched yet, then called a mismatch."""
    backend = importlib.import_module("rosplc.ros.rclpy.backend")
    endpoint = importlib.import_module("rclpy._graph").Endpoint
    machine.node("listener").subscribe("/chatter", STRING, Qos(), lambda *_: None)
    publisher = machine.node("talker").advertise("/chatter", STRING, Qos())
    monkeypatch.setattr(endpoint, "matched", lambda _: [])
    assert publisher.status().code == ""
    assert publisher.status().reason.endswith("not matched yet")
    monkeypatch.setattr(backend.RclpyBackend, "_settling", lambda *_: False)
    assert publisher.status().code == "ROS003"
    words = f"node /listener subscribes to /chatter as {STRING} with another definition, or access rules"
    assert publisher.status().reason == f"{words} prevent the connection"


def test_participant_without_a_node_is_called_so(machine: Machine) -> None:
    """A plain DDS program on a topic has no node's name."""
    native = machine.native("_CREATED_BY_BARE_DDS_APP_")
    qos = importlib.import_module("rclpy.qos").QoSProfile(depth=1)
    native.create_publisher(message_class("std_msgs/msg/Int32"), "/chatter", qos)
    subscription = machine.node("listener").subscribe("/chatter", STRING, Qos(), lambda *_: None)
    assert subscription.status().reason.startswith("a participant without a ROS node publishes /chatter")


# -- threads


def test_closing_while_the_receiver_is_blocked_waits_for_it(machine: Machine) -> None:
    """``close`` returns when the running callback has ended."""
    begun, go, ended = threading.Event(), threading.Event(), threading.Event()

    def slow(payload: bytes, stamp_ns: int) -> None:
        begun.set()
        go.wait()
        ended.set()

    node = machine.node("listener")
    subscription = node.subscribe("/chatter", STRING, Qos(), slow)
    machine.node("talker").advertise("/chatter", STRING, Qos()).write(string("x"))
    begun.wait()
    closer = threading.Thread(target=subscription.close)
    closer.start()
    closer.join(0.1)
    assert closer.is_alive()
    go.set()
    closer.join()
    assert ended.is_set()


def test_callbacks_come_one_at_a_time_in_one_thread(machine: Machine) -> None:
    """However many topics there are, no two callbacks run at once."""
    running, most, threads = [0], [0], set()

    def receive(payload: bytes, stamp_ns: int) -> None:
        running[0] += 1
        most[0] = max(most[0], running[0])
        threads.add(threading.get_ident())
        time.sleep(0.001)
        running[0] -= 1
        done.append(1)

    done: list[int] = []
    node, talker = machine.node("listener"), machine.node("talker")
    for number in range(5):
        node.subscribe(f"/t{number}", STRING, Qos(), receive)
    for number in range(5):
        publisher = talker.advertise(f"/t{number}", STRING, Qos())
        for _ in range(4):
            publisher.write(string("x"))
    wait_for(lambda: len(done) == 20)
    assert (most[0], len(threads)) == (1, 1)


def test_double_leaves_no_trace() -> None:
    """After a test with the double, rclpy cannot be imported, and the backend says so."""
    environment = os.environ.get("ROS_DISTRO")
    with double():
        importlib.import_module("rosplc.ros.rclpy")
    assert "rclpy" not in sys.modules
    assert os.environ.get("ROS_DISTRO") == environment
    assert refused(lambda: open_backend("rclpy", STORE, "node")).code == "ROS001"
