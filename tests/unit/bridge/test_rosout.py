"""What the bridge sends to /rosout, decoded by an independent library."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack
from typing import Any

import pytest
from rosbags.typesys import Stores, get_typestore

from rosplc.bridge import Bridge
from rosplc.bridge.rosout import QOS, TOPIC, Rosout
from rosplc.clock import SYSTEM
from rosplc.config import ConfigErrors, parse_config
from rosplc.config.resolve import resolve
from rosplc.errors import BackendError
from rosplc.model import TypeStore
from rosplc.ros import LATCHED, RosArguments, open_backend
from tests.interop.graphs import free_domain
from tests.interop.zenoh.processes import Router, free_port
from tests.lib.waiting import wait_for
from tests.unit.bridge.conftest import DOMAIN, Cell

TYPE, ROS1_TYPE = "rcl_interfaces/msg/Log", "rosgraph_msgs/msg/Log"
NONE = "  {}\n"
LOGGER = logging.getLogger("rosplc.bridge")


@pytest.fixture(autouse=True)
def level() -> Iterator[None]:
    """Let the whole log through, as `rosplc run --verbose` does."""
    logger = logging.getLogger("rosplc")
    before = logger.level
    logger.setLevel(logging.DEBUG)
    yield
    logger.setLevel(before)


def lines(messages: list[bytes]) -> list[Any]:
    store = get_typestore(Stores.ROS2_JAZZY)
    return [store.deserialize_cdr(data, TYPE) for data in list(messages)]


def test_the_log_of_the_bridge_is_on_rosout(cell: Cell) -> None:
    """Each level, under the node's name, with stamp and place; the start is there for late subscribers."""
    cell.start(NONE)
    for number in (10, 20, 30, 40, 50):
        LOGGER.log(number, "level %d", number)
    messages = cell.listen(TOPIC, TYPE, LATCHED)
    wait_for(lambda: len([line for line in lines(messages) if line.msg.startswith("level")]) == 5)
    found = {line.msg: line for line in lines(messages)}
    assert any(text.startswith("bridge cell carries") for text in found)
    assert [found[f"level {number}"].level for number in (10, 20, 30, 40, 50)] == [10, 20, 30, 40, 50]
    line = found["level 30"]
    assert (line.name, line.function) == (
        "rosplc_cell",
        "test_the_log_of_the_bridge_is_on_rosout",
    )
    assert line.file.endswith("test_rosout.py")
    assert line.line > 0
    assert abs(line.stamp.sec - SYSTEM.time_ns() // 10**9) < 3600
    cell.stop()
    before = len(messages)
    LOGGER.warning("nobody sends this")
    assert len(messages) == before
    assert not any(isinstance(handler, Rosout) for handler in logging.getLogger("rosplc").handlers)


@pytest.mark.parametrize("backend", ["dds", "zenoh"])
def test_the_log_over_a_network(cell: Cell, backend: str) -> None:
    """A late subscriber in the graph of the middleware gets it, too."""
    with ExitStack() as stack:
        options, more = {}, ""
        if backend == "zenoh":
            router = stack.enter_context(Router(stack.enter_context(free_port())))
            options = {"mode": "peer", "connect": [router.endpoint]}
            more = f", zenoh: {{mode: peer, connect: [{router.endpoint}]}}"
        domain = stack.enter_context(free_domain())
        ros = f"{{backend: {backend}, domain: {domain}{more}}}"
        text = cell.config(NONE).replace(f"{{backend: memory, domain: {DOMAIN}}}", ros)
        stack.enter_context(Bridge(parse_config(text)))
        peer = open_backend(backend, TypeStore.bundled("jazzy"), "peer", domain=domain, options=options)
        stack.callback(peer.close)
        messages: list[bytes] = []
        peer.subscribe(TOPIC, TYPE, LATCHED, lambda data, _: messages.append(data))
        wait_for(lambda: any(line.msg.startswith("bridge cell carries") for line in lines(messages)))


def test_the_profile_is_that_of_rclpy() -> None:
    """Reliable, transient local, depth 1000, lifespan 10 s: rcl_qos_profile_rosout_default."""
    assert (QOS.reliability, QOS.durability, QOS.depth) == ("reliable", "transient_local", 1000)
    assert QOS.lifespan_ns == 10_000_000_000


def test_ros_1_has_its_own_message(cell: Cell) -> None:
    """rosgraph_msgs/Log, with ROS 1's levels and the node's full name."""
    text = cell.config(NONE).replace("backend: memory", "distro: noetic, backend: memory")
    store = TypeStore.bundled("noetic")
    peer = open_backend("memory", store, "peer1", domain=DOMAIN)
    messages: list[bytes] = []
    peer.subscribe(TOPIC, ROS1_TYPE, LATCHED, lambda data, _: messages.append(data))
    typestore = get_typestore(Stores.ROS1_NOETIC)
    with Bridge(parse_config(text)):
        for number in (10, 20, 30, 40, 50):
            LOGGER.log(number, "level %d", number)

        def found() -> list[Any]:
            read = [typestore.deserialize_ros1(data, ROS1_TYPE) for data in list(messages)]
            return [line for line in read if line.msg.startswith("level")]

        wait_for(lambda: len(found()) == 5)
    peer.close()
    assert [line.level for line in found()] == [1, 2, 4, 8, 16]
    assert {line.name for line in found()} == {"/rosplc_cell"}
    assert all(line.header.stamp.sec for line in found())


@pytest.mark.parametrize("how", ["file", "argument"])
def test_it_can_be_turned_off(cell: Cell, how: str) -> None:
    """By the configuration, or as for every node of ROS 2; then the topic is not even advertised."""
    more = "rosout: {bridge: false}" if how == "file" else ""
    given = RosArguments.parse(["--disable-rosout-logs"] if how == "argument" else [])
    with Bridge(parse_config(cell.config(NONE, more=more)), arguments=given):
        assert TOPIC not in {end.topic for end in cell.peer.graph().endpoints}


class Failing:
    """A publisher that logs and fails, or hangs."""

    matched = 0

    def __init__(self) -> None:
        self.writes = 0
        self.fail = True
        self.proceed = threading.Event()

    def write(self, *_: object) -> bool:
        self.writes += 1
        logging.getLogger("rosplc.ros").warning("writing failed")
        if self.fail:
            raise BackendError("ROS002", "no room")
        self.proceed.wait(60)
        return True

    def close(self) -> None:
        pass


@pytest.fixture
def rosout(cell: Cell) -> Iterator[tuple[Rosout, Failing]]:
    """Give the handler over a publisher that fails."""
    made = Rosout(resolve(parse_config(cell.config(NONE))), cell.peer, SYSTEM)
    publisher = made.publisher = Failing()  # type: ignore[assignment]
    logging.getLogger("rosplc").addHandler(made)
    yield made, publisher
    publisher.fail = False
    publisher.proceed.set()
    made.leave()


def test_a_failure_to_send_is_logged_once_and_not_sent(
    rosout: tuple[Rosout, Failing], caplog: pytest.LogCaptureFixture
) -> None:
    """Neither what sending logs nor its failure becomes a line, so that there is no loop."""
    handler, publisher = rosout
    for _ in range(3):
        LOGGER.warning("a line")
        handler.send()
    handler.send()
    handler.send()
    assert publisher.writes == 3
    assert caplog.text.count("the log cannot be sent to /rosout") == 1


def test_nobody_who_logs_waits_for_ros(rosout: tuple[Rosout, Failing]) -> None:
    """While sending hangs, lines wait, 1000 at most; the next line tells how many had no room."""
    handler, publisher = rosout
    publisher.fail = False
    LOGGER.warning("the first")
    thread = threading.Thread(target=handler.send)
    thread.start()
    wait_for(lambda: publisher.writes == 1)
    for number in range(1200):
        LOGGER.warning("line %d", number)
    handler.send()  # as a stopping bridge does
    assert publisher.writes == 1
    sent: list[str] = []
    publisher.proceed.set()
    thread.join()
    publisher.write = lambda data, _: bool(sent.append(lines([data])[0].msg)) or True  # type: ignore[method-assign]
    handler.send()
    assert len(sent) == 1000
    assert sent[-1] == "dropped 200 log lines: the buffer was full"
    assert sent[0] == "line 201"


def test_lines_of_the_plc(cell: Cell) -> None:
    """They get the node's name and a stamp; more than 50 in a second are kept back, and counted."""
    messages = cell.listen(TOPIC, TYPE, LATCHED)
    cell.start(NONE, more="rosout: {plc: true, bridge: false}")
    plc = cell.plc(TOPIC)
    plc.write({"level": 40, "msg": "too \x1b[31mhot", "name": "x"})

    def texts() -> list[Any]:
        return [line for line in lines(messages) if line.name == "rosplc_cell.plc"]

    wait_for(texts)
    assert [(line.level, line.msg) for line in texts()] == [(40, "too \\x1b[31mhot")]
    assert texts()[0].stamp.sec > 1_600_000_000
    plc.write({"level": 255, "msg": "no such level"})
    wait_for(lambda: len(texts()) == 2)
    assert texts()[-1].level == 50
    assert cell.bridge is not None

    def suppressed() -> bool:
        for _ in range(20):  # reading all lines after each would be too slow for 50 in a second under load
            plc.write({"level": 20, "msg": "again"})
            time.sleep(0.002)
        return any(line.msg.endswith("suppressed") for line in texts())

    wait_for(suppressed)
    assert cell.bridge.status().topics[0].lost == 0


def test_the_topic_is_carried_once(cell: Cell) -> None:
    """A topic /rosout of the file and the PLC's log exclude each other."""
    topics = f"  /rosout: {{type: {TYPE}, to: plc}}\n"
    cell.make(topics)
    with pytest.raises(ConfigErrors, match="the bridge itself already carries /rosout"):
        cell.make(topics, more="rosout: {plc: true}")


def test_a_reload_keeps_the_log(cell: Cell) -> None:
    """Its task can change while the bridge runs; the switch itself cannot."""
    messages = cell.listen(TOPIC, TYPE, LATCHED)
    more = "rosout: {plc: true}\ntasks: {A: {}, B: {}}"
    bridge = cell.start(NONE, more=more)
    changes = bridge.reload(
        parse_config(cell.config(NONE, more=more.replace("A: {}, B: {}", "B: {}, A: {}")))
    )
    assert [new.topic for _, new in changes.changed] == [TOPIC]
    cell.plc(TOPIC).write({"level": 20, "msg": "after the reload"})
    wait_for(lambda: any(line.msg == "after the reload" for line in lines(messages)))
    with pytest.raises(ConfigErrors, match=r"rosout\.plc"):
        bridge.reload(parse_config(cell.config(NONE)))
