"""Read-only looks at running channels, for people and for tools."""

from __future__ import annotations

from rosplc.monitor.expected import Expectation, Expected
from rosplc.monitor.message import Message, numbers
from rosplc.monitor.picture import BridgeView, ChannelView, Event, Picture, ReaderView
from rosplc.monitor.snapshot import ObjectState, find_objects
from rosplc.monitor.states import State
from rosplc.monitor.watch import Watch

__all__ = [
    "BridgeView",
    "ChannelView",
    "Event",
    "Expectation",
    "Expected",
    "Message",
    "ObjectState",
    "Picture",
    "ReaderView",
    "State",
    "Watch",
    "find_objects",
    "numbers",
]
