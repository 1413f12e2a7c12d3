"""Actions between a PLC and a real rclpy, through a whole bridge, both ways, with kills of either side."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import pytest

from rosplc.reasons import Reason
from rosplc.ros.goals import GoalStatus
from rosplc.shm import Namespace
from rosplc.shm.constants import ErrorNumber
from tests.interop.actions.cell import Cell, StartPeer, the_plc_carries_goals_out, the_plc_sends_goals
from tests.interop.graphs import LOCAL
from tests.interop.ros2.test_actions import start

pytestmark = [pytest.mark.ros2, pytest.mark.timeout(600), pytest.mark.verifies("rclpy-calls", real="rclpy")]


@pytest.fixture
def backend() -> str:
    return "rclpy"


@pytest.fixture
def cell(tmp_path: Path, shm_namespace: Namespace, domain: int, backend: str) -> Iterator[Cell]:
    ros = f"{{backend: {backend}, distro: kilted, domain: {domain}}}"
    opened = Cell(tmp_path, shm_namespace.prefix, ros, {**os.environ, **LOCAL})
    yield opened
    opened.close()


@pytest.mark.parametrize("scenario", [the_plc_sends_goals, the_plc_carries_goals_out])
def test_actions(scenario: Callable[[Cell, StartPeer], None], cell: Cell, domain: int) -> None:
    """Goals, decisions, feedback, requests to cancel and results pass, also after kills."""
    scenario(cell, partial(start, domain))


def test_a_plc_that_stops_has_its_goal_canceled(cell: Cell, domain: int) -> None:
    """The robot stops as well."""
    peer = start(domain, serve="/move")
    cell.send(60)
    cell.until(lambda: cell.client.xActive and cell.fed, "feedback")
    cell.client.close()  # and its program starts again
    cell.fed.clear()
    cell.send(2)
    assert cell.ended() == (True, False, GoalStatus.SUCCEEDED, None)
    assert peer.wait(60, "canceled")
    peer.close()


SERVICES = ("send_goal", "cancel_goal", "get_result")


@pytest.mark.parametrize("backend", ["dds"])
def test_a_fast_dds_server_is_refused_over_dds(cell: Cell, domain: int) -> None:
    """Nothing is sent that it would misread, and a warning about each of its services says so."""
    peer, client = start(domain, serve="/move"), cell.client
    try:
        refused = [f"serves /move/_action/{service} as" for service in SERVICES]
        cell.until(lambda: all(words in warnings(cell) for words in refused), "the warnings")
        client.xExecute, client.tTimeout = True, 0.5
        cell.scan()
        assert cell.ended() == (False, False, GoalStatus.UNKNOWN, ErrorNumber.NOT_EXECUTED)
        assert (client.eReason, client.xServer) == (Reason.TIME_OUT, False)
        assert not peer.words(0, "began")
    finally:
        peer.close()


@pytest.mark.parametrize("backend", ["dds"])
def test_a_fast_dds_client_is_refused_over_dds(cell: Cell, domain: int) -> None:
    """It finds no server, and a warning about each service that it calls says why."""
    peer = start(domain, use="/cell")
    try:
        refused = [f"calls /cell/_action/{service} as" for service in SERVICES]
        cell.until(lambda: all(words in warnings(cell) for words in refused), "the warnings")
        peer.tell(look="/cell")
        cell.until(lambda: peer.words(0, "server") == [False], "what the client knows")
        assert not cell.server.xGoal
    finally:
        peer.close()


def warnings(cell: Cell) -> str:
    """Return what the bridge has logged of peers on another DDS."""
    return "".join(line for line in cell.bridge.log.read_text().splitlines() if "[ROS021]" in line)
