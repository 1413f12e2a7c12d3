"""A generated project as a PLC process, by the machine's clock."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from pathlib import Path

from tests.verification.plc_cell import Cell, cell_texts, pattern

_ROOT = Path(__file__).resolve().parents[2]
_ECHO = """PROGRAM Echo
ROS_Write.out.msg := ROS_Read.plain.msg;
ROS_Write.out.xEnable := ROS_Read.plain.xNew;
END_PROGRAM
"""


def test_project_runs_as_a_process(tmp_path: Path) -> None:
    """The project echoes a message in real time, and ends cleanly on SIGTERM."""
    for name, text in {**cell_texts(), "Echo": _ECHO}.items():
        (tmp_path / f"{name}.st").write_text(text)
    with Cell() as cell:
        writer = cell.channel("/plain").writer()
        channel = cell.channel("/out")
        reader = channel.reader()
        plc = subprocess.Popen(
            [sys.executable, "-m", "rosplc_st.run_project", str(tmp_path),
             "--directory", str(cell.folder),
             "--task", "2ms", "SharedMemory_Read", "Echo", "SharedMemory_Write"],
            stdout=subprocess.PIPE, text=True, cwd=_ROOT,
        )  # fmt: skip
        assert plc.stdout is not None
        assert plc.stdout.readline().startswith("running")
        out, number = bytearray(48), 0
        while reader.latest(out) is None:
            number += 1
            writer.publish(pattern(number))
            reader.beat()
            time.sleep(0.02)
        assert bytes(out) in [pattern(n) for n in range(1, number + 1)]
        plc.send_signal(signal.SIGTERM)
        rest = plc.stdout.read()
        assert plc.wait() == 0
        assert "scans" in rest
        assert channel.snapshot().writer.epoch == 0, "the claim was given back"


def test_what_cannot_run_is_said(tmp_path: Path) -> None:
    """A folder without programs, or with text that CODESYS would refuse, is an error with its place."""
    (tmp_path / "P.st").write_text("PROGRAM P\nVAR\n    a : INT;\nEND_VAR\na := b;\nEND_PROGRAM\n")
    done = subprocess.run(
        [sys.executable, "-m", "rosplc_st.run_project", str(tmp_path)],
        capture_output=True, text=True, cwd=_ROOT, check=False,
    )  # fmt: skip
    assert done.returncode == 1
    assert "P:5: unknown name B" in done.stderr
