"""The technician's tutorial: its program does what the page says, as translated Structured Text."""

from __future__ import annotations

import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from tests.lib.waiting import wait_for

pytest.importorskip("blark")
if shutil.which("gcc") is None:
    pytest.skip("Debian package gcc is missing", allow_module_level=True)

from rosplc.bridge import Bridge
from rosplc.codec import Codec, Wire
from rosplc.config import load_config
from rosplc.ros import DEFAULT, open_backend
from rosplc.shm import Namespace
from tests.docs.pages import blocks

pytestmark = pytest.mark.verifies("documentation", own="translated Structured Text")

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "tutorial" / "codesys.md"
WATCHDOG_S = 100.0


def page_files(folder: Path, prefix: str) -> None:
    """Write the page's configuration and its program, and generate what it says."""
    (configuration,) = (block.text for block in blocks(PAGE) if block.directives.get("file") == "rosplc.yaml")
    (program,) = (block.text for block in blocks(PAGE) if block.text.startswith("PROGRAM PLC_PRG"))
    own = f"prefix: {prefix}\n{configuration.replace('distro: jazzy', 'distro: jazzy, backend: memory')}"
    (folder / "rosplc.yaml").write_text(own, encoding="utf-8")
    command = [str(Path(sys.executable).parent / "rosplc"), "generate", "rosplc.yaml", "--out", "plc"]
    subprocess.run(command, cwd=folder, check=True, capture_output=True)
    (folder / "plc" / "st" / "PLC_PRG.st").write_text(f"{program}END_PROGRAM\n", encoding="utf-8")


@pytest.mark.verify(minutes=1.5)
def test_the_wheels_follow_the_command_and_stop_without_it(tmp_path: Path, shm_namespace: Namespace) -> None:
    """A speed of 0.5 m/s is 5 rad/s on /wheel_speed, and 0 again half a second after the last command."""
    page_files(tmp_path, shm_namespace.prefix)
    bridge = Bridge(load_config(tmp_path / "rosplc.yaml"))
    store = bridge.project.store
    bridge.backend = open_backend("memory", store, "bridge")
    robot = open_backend("memory", store, "robot")
    twist = Codec(bridge.project.topic("/cmd_vel").layout, Wire.CDR)
    number = Codec(bridge.project.topic("/wheel_speed").layout, Wire.CDR)
    speeds: list[float] = []

    def on_speed(payload: bytes, _: int) -> None:
        speeds.append(number.layout.view(number.decode(payload)).data)

    tasks = ["--task", "10ms", "SharedMemory_Read", "PLC_PRG", "SharedMemory_Write"]
    command = [sys.executable, "-m", "rosplc_st.run_project", str(tmp_path / "plc" / "st"), *tasks]
    with bridge:
        robot.subscribe("/wheel_speed", "std_msgs/msg/Float64", DEFAULT, on_speed)
        cmd_vel = robot.advertise("/cmd_vel", "geometry_msgs/msg/Twist", DEFAULT)
        plc = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=ROOT)
        try:
            assert plc.stdout is not None and plc.stdout.readline().startswith("running")
            wait_for(lambda: speeds, "the first message")
            assert set(speeds) == {0.0}, "without a command nothing turns"

            def commanded() -> bool:
                cmd_vel.write(twist.encode(twist.layout.pack({"linear": {"x": 0.5}})))
                return 5.0 in speeds

            wait_for(commanded, "5 rad/s")
            wait_for(lambda: speeds[-1] == 0.0, "the stop")
        finally:
            plc.send_signal(signal.SIGTERM)
            plc.communicate()
    robot.close()
    assert set(speeds) == {0.0, 5.0}
