"""A type's plan: wire bytes to record and back, for CDR (ROS 2) and ROS 1.

The plan is compiled here, once per layout and wire, and executed by the C core.
"""

from rosplc._core import Fault
from rosplc.codec.codec import TRUNCATED, Codec
from rosplc.codec.compile import CompiledPlan, compile_plan
from rosplc.codec.wire import Wire

__all__ = ["TRUNCATED", "Codec", "CompiledPlan", "Fault", "Wire", "compile_plan"]
