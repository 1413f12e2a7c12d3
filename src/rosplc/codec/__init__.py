"""A type's plan, CDR or ROS 1 to record and back: compiled once per layout and wire, run by the C core."""

from rosplc._core import Fault
from rosplc.codec.compile import TRUNCATED, Codec, CompiledPlan, Wire, compile_plan

__all__ = ["TRUNCATED", "Codec", "CompiledPlan", "Fault", "Wire", "compile_plan"]
