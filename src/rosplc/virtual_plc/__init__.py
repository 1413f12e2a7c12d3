"""A scan-cycle stand-in for a PLC, for laptops and CI where no PLC runs."""

from rosplc.virtual_plc.call_blocks import ActionClient, ActionServer, ServiceClient, ServiceServer
from rosplc.virtual_plc.read_block import OnStale, ReadBlock
from rosplc.virtual_plc.task import CycleStats, Program, Task, TaskState, VirtualPlc
from rosplc.virtual_plc.write_block import Message, WriteBlock

__all__ = [
    "ActionClient",
    "ActionServer",
    "CycleStats",
    "Message",
    "OnStale",
    "Program",
    "ReadBlock",
    "ServiceClient",
    "ServiceServer",
    "Task",
    "TaskState",
    "VirtualPlc",
    "WriteBlock",
]
