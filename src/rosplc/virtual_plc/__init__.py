"""A simulated PLC with scan cycles, for laptops and CI machines without a PLC."""

from rosplc.virtual_plc.block import Message, OnStale, ReadBlock, WriteBlock
from rosplc.virtual_plc.call_blocks import ActionClient, ActionServer, ServiceClient, ServiceServer
from rosplc.virtual_plc.task import CycleStats, Program, Task, TaskState, VirtualPlc

__all__ = [
    "ActionClient", "ActionServer", "CycleStats", "Message", "OnStale", "Program", "ReadBlock",
    "ServiceClient", "ServiceServer", "Task", "TaskState", "VirtualPlc", "WriteBlock",
]  # fmt: skip
