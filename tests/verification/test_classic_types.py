"""Messages of many types cross classic memories unchanged; and CODESYS' own two-integer sample."""

from __future__ import annotations

import random
import struct
import subprocess
import sys
from pathlib import Path

from rosplc.codec import Codec, Wire
from rosplc.config.plans import ClassicPlan
from rosplc.layout import Limits
from rosplc.plc.build import build_project
from rosplc.plc.plan import PlcTask, PlcTopic
from rosplc.plc.project import project_texts
from rosplc_st.build import build
from rosplc_st.run_project import load_texts
from tests.verification.classic_cell import ClassicCell, Peer
from tests.verification.crossing import random_record
from tests.verification.plc_cell import READ, WRITE, layout_of, store

_TYPES = (
    "std_msgs/msg/Bool", "std_msgs/msg/String", "std_msgs/msg/ColorRGBA", "geometry_msgs/msg/PoseStamped",
    "sensor_msgs/msg/JointState", "sensor_msgs/msg/BatteryState", "diagnostic_msgs/msg/DiagnosticArray",
    "nav_msgs/msg/Path",
)  # fmt: skip


def test_types_cross_unchanged() -> None:
    """Random records of types with strings, sequences and padding come out as they went in."""
    limits = Limits(12, 4)
    layouts = [layout_of(name, "jazzy", limits) for name in _TYPES]
    topics = [
        PlcTopic(f"/{way[0]}{index}", layout, way, "T", classic=ClassicPlan(f"{way[0]}{index}", "all"))  # type: ignore[arg-type]
        for index, layout in enumerate(layouts)
        for way in ("read", "write")
    ]
    texts = project_texts(build_project(store(), topics, [PlcTask("T")]))
    lines = [
        f"ROS_Write.w{i}.xEnable := ROS_Read.r{i}.xNew;\nROS_Write.w{i}.msg := ROS_Read.r{i}.msg;"
        for i in range(len(layouts))
    ]
    texts["Pass"] = "PROGRAM Pass\n" + "\n".join(lines) + "\nEND_PROGRAM\n"
    draw = random.Random(20)
    with ClassicCell(build(texts)) as cell:
        ends = []
        for index, layout in enumerate(layouts):
            for way in ("r", "w"):
                cell.peers.append(Peer(f"{cell.prefix}{way}{index}", layout.size, "bare"))
            ends.append(cell.peers[-2:])
        cell.machine.scan(READ, "Pass", WRITE)
        for _ in range(4):
            sent = []
            for (reader, _writer), layout in zip(ends, layouts, strict=True):
                codec = Codec(layout, Wire.CDR)
                sent.append(codec.decode(codec.encode(random_record(layout, draw))))
                reader.write(sent[-1])
            cell.machine.scan(READ, "Pass", WRITE)
            for (_reader, writer), layout, expected in zip(ends, layouts, sent, strict=True):
                assert writer.read() == expected, layout.type_name


CONFIG = """\
bridge: cell1
ros: {distro: jazzy}
types: {paths: [msg]}
topics:
  /to_codesys:
    type: codesys_sample/msg/DataExchange
    to: plc
    classic: {name: _CODESYS_SharedMemoryTest_Read, semaphore: none}
  /from_codesys:
    type: codesys_sample/msg/DataExchange
    to: ros
    classic: {name: _CODESYS_SharedMemoryTest_Write, semaphore: none}
"""
PROGRAM = """PROGRAM PLC_PRG
IF ROS_Read.to_codesys.xNew THEN
    ROS_Write.from_codesys.msg.value1 := ROS_Read.to_codesys.msg.value1 + 1;
    ROS_Write.from_codesys.msg.value2 := ROS_Read.to_codesys.msg.value2 - 1;
    ROS_Write.from_codesys.xEnable := TRUE;
END_IF;
END_PROGRAM
"""


def test_the_sample_of_codesys(tmp_path: Path) -> None:
    """A configuration for CODESYS' sample gives blocks that exchange its two integers with a C program."""
    folder = tmp_path / "msg" / "codesys_sample" / "msg"
    folder.mkdir(parents=True)
    (folder / "DataExchange.msg").write_text("int32 value1\nint32 value2\n")
    (tmp_path / "rosplc.yaml").write_text(CONFIG)
    command = [sys.executable, "-m", "rosplc", "generate", "rosplc.yaml", "--out", "plc"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    built = build({**load_texts(tmp_path / "plc"), "PLC_PRG": PROGRAM})
    with ClassicCell(built) as cell:
        read = Peer(f"{cell.prefix}_CODESYS_SharedMemoryTest_Read", 8, "bare")
        write = Peer(f"{cell.prefix}_CODESYS_SharedMemoryTest_Write", 8, "bare")
        cell.peers += [read, write]
        cell.machine.scan(READ, "PLC_PRG", WRITE)
        for first, second in ((5, -5), (2**31 - 2, -(2**31) + 1)):
            read.write(struct.pack("<2i", first, second))
            cell.machine.scan(READ, "PLC_PRG", WRITE)
            assert struct.unpack("<2i", write.read()) == (first + 1, second - 1)
        assert cell.machine.counters().sem_creates == 0
