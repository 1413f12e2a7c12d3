"""A scan-cycle stand-in for a PLC, for laptops and CI where no PLC runs."""

from __future__ import annotations

from rosplc.virtual_plc.message import Message
from rosplc.virtual_plc.plc import VirtualPlc
from rosplc.virtual_plc.read_block import OnStale, ReadBlock
from rosplc.virtual_plc.stats import CycleStats
from rosplc.virtual_plc.task import Program, Task, TaskState
from rosplc.virtual_plc.write_block import WriteBlock

__all__ = [
    "CycleStats",
    "Message",
    "OnStale",
    "Program",
    "ReadBlock",
    "Task",
    "TaskState",
    "VirtualPlc",
    "WriteBlock",
]
