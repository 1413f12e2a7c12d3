"""Services of a whole bridge: its threads, its objects' life, and other configurations while it runs."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from rosplc.bridge import Bridge
from rosplc.bridge.diagnostics import diagnostic_status
from rosplc.bridge.use import Use
from rosplc.config import ConfigErrors
from rosplc.config import parse_config as parse
from rosplc.errors import BackendError, ChannelError
from rosplc.ros import SERVICES, Reply
from rosplc.ros.lifecycle import LifecycleBackend
from rosplc.ros.memory import MemoryServer, open_backend
from rosplc.shm import Namespace, Part, attach
from rosplc.virtual_plc import ServiceClient, ServiceServer
from tests.lib.waiting import repeat_until, wait_for
from tests.unit.bridge.conftest import DOMAIN, INT, STORE, Cell, unwire, wire

SET_BOOL = "std_srvs/srv/SetBool"
SERVED = f"  /start: {{type: {SET_BOOL}, server: plc}}\n"
CALLED = f"  /grip: {{type: {SET_BOOL}, server: ros, clients: [pick]}}\n"


@pytest.fixture
def plc(shm_namespace: Namespace) -> Iterator[tuple[ServiceServer, ServiceClient]]:
    names: Any = {"prefix": shm_namespace.prefix, "directory": str(shm_namespace.directory)}
    blocks = ServiceServer("/start", **names), ServiceClient("/grip", "pick", **names)
    yield blocks
    for block in blocks:
        block.close()


def config(cell: Cell, services: str, topics: str = "", **more: Any) -> Any:
    return parse(cell.config(topics, more=f"services:\n{services}", **more))


def start(cell: Cell, services: str, **more: Any) -> Bridge:
    cell.bridge = Bridge(config(cell, services, **more))
    cell.bridge.start()
    return cell.bridge


def serve(server: ServiceServer) -> bool:
    """Run the block once; answer what it shows."""
    server.xReply = server()
    if server.response is not None and server.request is not None:
        server.response.update({"success": server.request.data, "message": "from the PLC"})
    return server.xAttached and server.xPeerAlive


def ask(cell: Cell, data: bool = True) -> list[Reply]:
    client = cell.peer.client("/start", SET_BOOL, SERVICES)
    replies: list[Reply] = []
    client.call(wire(f"{SET_BOOL}_Request", {"data": data}), replies.append)
    return replies


def text(replies: list[Reply]) -> str:
    assert replies[0].payload is not None
    return str(unwire(f"{SET_BOOL}_Response", replies[0].payload)["message"])


def answered(server: ServiceServer, replies: list[Reply]) -> list[Reply]:
    return repeat_until(lambda: serve(server), lambda: replies, "the answer", every=0.005)


def call(client: ServiceClient) -> ServiceClient:
    """Call once, to the end."""
    client.xExecute = False
    client()
    client.xExecute = True
    repeat_until(client, lambda: not client.xBusy and client._before, "the end of a call", every=0.005)
    return client


def test_both_ways(cell: Cell, plc: tuple[ServiceServer, ServiceClient]) -> None:
    server, client = plc
    bridge = start(cell, SERVED + CALLED)
    wait_for(lambda: serve(server), every=0.01)
    assert text(answered(server, ask(cell))) == "from the PLC"

    def on_request(data: bytes, who: bytes, _: int) -> None:
        said = unwire(f"{SET_BOOL}_Request", data)["data"]
        ros.reply(who, wire(f"{SET_BOOL}_Response", {"success": said, "message": "from ROS"}))

    repeat_until(client, lambda: client.xAttached, every=0.005)
    assert not client.xServer
    ros = cell.peer.serve("/grip", SET_BOOL, SERVICES, on_request)
    client.request.data = True
    assert call(client).xDone
    assert client.response is not None
    assert (client.response.success, client.response.message) == (True, "from ROS")
    ros.close()
    repeat_until(client, lambda: not client.xServer, every=0.005)
    start_, grip = bridge.status().services
    assert (start_.done, start_.received, grip.done, grip.received) == (1, 1, 1, 1)
    status = bridge.status()
    entries = (diagnostic_status(one, "cell") for one in (status, *status.calls))
    names = {entry["name"]: entry["values"] for entry in entries}
    assert names["rosplc: cell: service /grip pick"]["done"] == "1"
    assert names["rosplc: cell: service /start"]["not executed"] == "0"
    assert [each["done"] for each in bridge.status().to_dict()["services"]] == [1, 1]


def test_without_a_plc(cell: Cell) -> None:
    start(cell, SERVED.replace("plc}", "plc, fallback: {message: no PLC}}"))
    replies = ask(cell)
    wait_for(lambda: replies)
    assert text(replies) == "no PLC"


def test_services_come_and_go(cell: Cell, plc: tuple[ServiceServer, ServiceClient]) -> None:
    """What stays is not disturbed; what leaves has its objects retired."""
    server, client = plc
    bridge = start(cell, SERVED)
    wait_for(lambda: serve(server), every=0.01)
    said = str(bridge.reload(config(cell, SERVED + CALLED, f"  /t: {{type: {INT}, to: plc}}\n")))
    assert said == "added /t, service /grip pick; topics and services unchanged: 1"
    assert text(answered(server, ask(cell))) == "from the PLC"
    repeat_until(client, lambda: client.xAttached, every=0.005)
    again = SERVED.replace("plc}", "plc, depth: 3}")
    assert str(bridge.reload(config(cell, again))) == (
        "removed /t, service /grip pick; changed service /start; topics unchanged: 0"
    )
    names = [name.removeprefix(cell.namespace.prefix) for name, _ in cell.namespace.objects()]
    assert names == [".sq.start", ".sr.start"]
    assert text(answered(server, ask(cell))) == "from the PLC"
    assert [use.done for use in bridge.status().services] == [1]


@pytest.mark.parametrize("change", ["removed", "another layout"])
def test_a_call_that_the_plc_carries_out_while_its_service_leaves(
    cell: Cell, plc: tuple[ServiceServer, ServiceClient], change: str
) -> None:
    """Its objects are given up, so that no answer can come: the caller is told, and the call is counted."""
    server, _ = plc
    served = SERVED.replace("plc}", "plc, fallback: {message: unknown}}")
    bridge = start(cell, served)
    wait_for(lambda: serve(server), every=0.01)
    server.xReply = False
    replies = ask(cell)
    repeat_until(server, lambda: server.xRequest, every=0.005)
    left = bridge._streams[0]
    longer = served.replace("plc,", "plc, limits: {response.message: 90},")
    bridge.reload(config(cell, CALLED if change == "removed" else longer))
    assert text(replies) == "unknown"
    assert isinstance(left, Use)
    assert left.status(0).fate_unknown == {"bridge_restarted": 1}
    assert left.status(0).outstanding == 0


def test_a_reload_that_fails_changes_nothing(
    cell: Cell, plc: tuple[ServiceServer, ServiceClient], monkeypatch: pytest.MonkeyPatch
) -> None:
    server, _ = plc
    bridge = start(cell, SERVED)
    wait_for(lambda: serve(server), every=0.01)

    def refuse(*_: Any) -> None:
        raise BackendError("ROS002", "no more clients")

    monkeypatch.setattr(bridge.backend, "client", refuse)
    with pytest.raises(BackendError, match="no more clients"):
        bridge.reload(config(cell, SERVED.replace("plc}", "plc, depth: 3}") + CALLED))
    assert [name.split(".", 1)[1] for name, _ in cell.namespace.objects()] == ["sq.start", "sr.start"]
    assert text(answered(server, ask(cell))) == "from the PLC"


def test_a_type_that_is_redefined_is_refused(cell: Cell, tmp_path: Any) -> None:
    definition = tmp_path / "cell_msgs" / "srv" / "Go.srv"
    definition.parent.mkdir(parents=True)
    definition.write_text("bool fast\n---\nbool done\n")
    more = f"types: {{paths: [{tmp_path}]}}\nservices:\n  /go: {{type: cell_msgs/srv/Go, server: plc}}\n"
    cell.bridge = Bridge(parse(cell.config("", more=more)))
    cell.bridge.start()
    definition.write_text("bool fast\n---\nbool done\nstring why\n")
    with pytest.raises(ConfigErrors, match=r"definition of cell_msgs/srv/Go_Response.*CFG012") as caught:
        cell.bridge.reload(parse(cell.config("", more=more)))
    assert "services./go.type" in str(caught.value)


def test_a_name_that_another_bridge_holds(cell: Cell) -> None:
    start(cell, CALLED)
    with pytest.raises(ChannelError, match=r"holds /grip pick \[SHM116\]"), Bridge(config(cell, CALLED)):
        pass


def test_services_that_left_the_configuration_are_retired(cell: Cell) -> None:
    """A shortened name, which does not give the service away, is retired like any other."""
    long = f"  /{'s' * 100}: {{type: {SET_BOOL}, server: plc}}\n"
    start(cell, SERVED + CALLED + long)
    assert any("~" in name for name, _ in cell.namespace.objects())
    cell.stop()
    start(cell, SERVED)
    assert len(cell.namespace.objects()) == 2


def test_an_object_that_was_removed_is_created_again(
    cell: Cell, plc: tuple[ServiceServer, ServiceClient]
) -> None:
    server, _ = plc
    bridge = start(cell, SERVED)
    wait_for(lambda: serve(server), every=0.01)
    for name, _ in cell.namespace.objects():
        (Path(cell.namespace.directory) / name).unlink()
    wait_for(lambda: len(cell.namespace.objects()) == 2)

    def asked() -> bool:
        replies = ask(cell)
        repeat_until(lambda: serve(server), lambda: replies or not bridge.status().services[0].outstanding)
        return bool(replies) and replies[0].payload is not None

    wait_for(asked, "an answer of the new objects")


def test_an_inactive_node_serves_and_calls_nothing(
    cell: Cell, plc: tuple[ServiceServer, ServiceClient]
) -> None:
    server, client = plc
    node = LifecycleBackend(open_backend(STORE, "cell", domain=DOMAIN))
    cell.bridge = Bridge(config(cell, SERVED + CALLED), node)
    cell.bridge.start()
    cell.peer.serve("/grip", SET_BOOL, SERVICES, lambda *_: None)
    caller = cell.peer.client("/start", SET_BOOL, SERVICES)
    wait_for(lambda: serve(server), every=0.01)
    repeat_until(client, lambda: client.xAttached, every=0.005)
    assert (caller.ready, client.xServer) == (False, False)
    node.activate()
    repeat_until(client, lambda: client.xServer, every=0.005)
    assert text(answered(server, ask(cell))) == "from the PLC"
    node.deactivate()
    repeat_until(client, lambda: not client.xServer, every=0.005)
    assert not caller.ready
    node.close()


def test_a_ros_side_that_hangs_stops_no_beat(
    cell: Cell, plc: tuple[ServiceServer, ServiceClient], monkeypatch: pytest.MonkeyPatch
) -> None:
    server, _ = plc
    bridge = start(cell, SERVED)
    wait_for(lambda: serve(server), every=0.01)
    hangs, go_on = threading.Event(), threading.Event()

    def hang(*_: Any) -> bool:
        hangs.set()
        return go_on.wait(100)

    monkeypatch.setattr(MemoryServer, "present", hang)
    ask(cell)
    repeat_until(lambda: serve(server), hangs.is_set, every=0.005)
    with attach(cell.namespace, "/start", part=Part.REQUEST) as seen:
        before = seen.snapshot().writer.beat
        wait_for(lambda: seen.snapshot().writer.beat > before + 3, "beats")
    wait_for(lambda: "sends to ROS has been stuck" in bridge.stuck(100_000_000))
    go_on.set()
    wait_for(lambda: not bridge.stuck(100_000_000))
