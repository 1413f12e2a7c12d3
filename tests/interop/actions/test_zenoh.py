"""Actions between a PLC and zenoh-ros2-sdk, through a whole bridge over Zenoh.

The SDK has no actions; ``fibonacci.py`` makes them of its services and topics.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import pytest

pytest.importorskip("zenoh")
pytest.importorskip("zenoh_ros2_sdk")

from rosplc.shm import Namespace
from tests.interop.actions.cell import Cell, Peer, StartPeer, the_plc_carries_goals_out, the_plc_sends_goals
from tests.interop.zenoh.processes import Router, free_port

pytestmark = [
    pytest.mark.foreign,
    pytest.mark.timeout(600),
    pytest.mark.verifies("zenoh-actions", own="rcl_action's rules, implemented on zenoh-ros2-sdk"),
]

DOMAIN = 19


@pytest.mark.parametrize("scenario", [the_plc_sends_goals, the_plc_carries_goals_out])
def test_actions(
    scenario: Callable[[Cell, StartPeer], None], router: Router, tmp_path: Path, shm_namespace: Namespace
) -> None:
    """Goals, decisions, feedback, requests to cancel and results pass, also after kills."""
    clean = {name: value for name, value in os.environ.items() if not name.startswith("ZENOH_")}
    # A client has no other way than the router: nothing is lost because links change.
    zenoh = f"{{mode: client, connect: [{router.endpoint}]}}"
    ros = f"{{backend: zenoh, distro: kilted, domain: {DOMAIN}, zenoh: {zenoh}}}"
    command = [sys.executable, "-m", "tests.interop.actions.sdk_peer", str(router.port), str(DOMAIN)]
    environment = {**clean, "ZENOH_CONFIG_OVERRIDE": "transport/shared_memory/enabled=false"}
    cell = Cell(tmp_path, shm_namespace.prefix, ros, clean)
    try:
        scenario(cell, partial(Peer, command, environment))
    finally:
        cell.close()


@pytest.fixture
def router() -> Iterator[Router]:
    with free_port() as port, Router(port) as router:
        yield router
