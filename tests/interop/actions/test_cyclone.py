"""Actions between a PLC and a peer that does as rmw_cyclonedds' sources, through a whole bridge over DDS."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest

pytest.importorskip("cyclonedds", reason="no wheel of cyclonedds for this machine")

from rosplc.shm import Namespace
from tests.interop.actions.cell import Cell, Peer, StartPeer, the_plc_carries_goals_out, the_plc_sends_goals
from tests.interop.graphs import LOCAL, free_domain

pytestmark = [
    pytest.mark.foreign,
    pytest.mark.timeout(600),
    pytest.mark.verifies("cyclone-calls", own="a peer written from rmw_cyclonedds' sources"),
]

# As rmw_cyclonedds sets it for LOCALHOST. The interface: the wheel takes no announcement from another one.
CYCLONE = (
    '<CycloneDDS><Domain><General><Interfaces><NetworkInterface address="127.0.0.1"/></Interfaces>'
    "<AllowMulticast>false</AllowMulticast></General><Discovery><ParticipantIndex>auto</ParticipantIndex>"
    "<MaxAutoParticipantIndex>32</MaxAutoParticipantIndex>"
    '<Peers><Peer Address="localhost"/></Peers></Discovery></Domain></CycloneDDS>'
)


@pytest.mark.parametrize(
    "scenario",
    [the_plc_sends_goals, partial(the_plc_carries_goals_out, remembered=True)],
    ids=["sent", "served"],
)
def test_actions(
    scenario: Callable[[Cell, StartPeer], None], tmp_path: Path, shm_namespace: Namespace
) -> None:
    """Goals, decisions, feedback, requests to cancel and results pass, also after kills.

    A result that the client asked a killed bridge for is delivered by the next one.
    """
    with free_domain() as domain:
        ros = f"{{backend: dds, distro: kilted, domain: {domain}}}"
        command = [sys.executable, "-m", "tests.interop.actions.cyclone_peer", str(domain)]
        cell = Cell(tmp_path, shm_namespace.prefix, ros, {**os.environ, **LOCAL})
        try:
            scenario(cell, partial(Peer, command, {**os.environ, "CYCLONEDDS_URI": CYCLONE}))
        finally:
            cell.close()
