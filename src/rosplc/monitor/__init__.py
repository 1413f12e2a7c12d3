"""Read-only views of running channels, for people and tools."""

from rosplc.monitor.classic import Expectation, Expected
from rosplc.monitor.message import Message, numbers
from rosplc.monitor.picture import BridgeView, CallView, ChannelView, Event, Picture, ReaderView, State
from rosplc.monitor.watch import ObjectState, Watch, find_objects

__all__ = [
    "BridgeView", "CallView", "ChannelView", "Event", "Expectation", "Expected", "Message", "ObjectState",
    "Picture", "ReaderView", "State", "Watch", "find_objects", "numbers",
]  # fmt: skip
