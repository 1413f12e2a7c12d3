"""The demonstration with its PLC program in OpenPLC's own runtime.

``ROSPLC_OPENPLC`` names a checkout of OpenPLC Runtime 4.1 whose ``build/plc_main`` was built,
``ROSPLC_STRUCPP`` one of STruC++; no registry has them. No other runtime may run on the machine meanwhile.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from rosplc.demo.openplc import Runtime
from tests.e2e.test_demo import (
    alive,
    demo,
    everything_arrived,
    objects,
    one_piece_is_missing,
    prefix_of,
    processes,
)
from tests.lib.waiting import wait_for

pytestmark = [
    pytest.mark.needs(variable="ROSPLC_OPENPLC"),
    pytest.mark.needs(variable="ROSPLC_STRUCPP"),
    pytest.mark.serial,
    pytest.mark.timeout(600),
    pytest.mark.verifies("openplc", real="OpenPLC's runtime (where a built checkout is available)"),
]


@pytest.mark.parametrize("kill", [False, True])
def test_messages_cross(kill: bool) -> None:
    """All arrive, whole and once; or, where the bridge is killed, all but one piece. No runtime is left."""
    with demo("--plc", "openplc", "--duration", "4s", "--json", *["--kill"] * kill) as child:
        prefix = prefix_of(wait_for(lambda: processes(child), "three processes", seconds=300))
        out, err = child.communicate(timeout=300)
    assert child.returncode == 0, out + err
    result = json.loads(out)
    (one_piece_is_missing if kill else everything_arrived)(result)
    assert result["plan"]["plc"] == "openplc"
    assert result["cycle"]["scans"] > 300
    assert objects(prefix) == []
    assert Runtime.ask("STATUS") == ""


def test_a_runtime_that_ends_is_named() -> None:
    """The demonstration ends with it, and says so."""
    with demo("--plc", "openplc", "--duration", "600s") as child:
        pids = wait_for(lambda: processes(child), "three processes", seconds=300)
        wait_for(lambda: "RUNNING" in Runtime.ask("STATUS"), "the runtime runs")
        (runtime,) = Path(f"/proc/{pids['openplc']}/task/{pids['openplc']}/children").read_text().split()
        os.kill(int(runtime), signal.SIGKILL)
        out, err = child.communicate(timeout=120)
    assert child.returncode == 1, out + err
    assert "the OpenPLC runtime stopped unexpectedly" in err


def test_a_killed_plc_takes_the_runtime_with_it() -> None:
    """The runtime does not outlive the process that started it; a second demonstration waits for neither."""
    with demo("--plc", "openplc", "--duration", "600s") as child:
        pids = wait_for(lambda: processes(child), "three processes", seconds=300)
        wait_for(lambda: "RUNNING" in Runtime.ask("STATUS"), "the runtime runs")
        second = [sys.executable, "-m", "rosplc", "demo", "--plc", "openplc", "--duration", "1s"]
        refused = subprocess.run(second, capture_output=True, text=True, timeout=100, check=False)
        assert refused.returncode == 1
        assert "another OpenPLC runtime is running" in refused.stderr
        os.kill(pids["openplc"], signal.SIGKILL)
        out, err = child.communicate(timeout=120)
    assert child.returncode == 1, out + err
    assert "the PLC process failed" in err
    assert Runtime.ask("STATUS") == ""
    assert not any(alive(pid) for pid in pids.values())
