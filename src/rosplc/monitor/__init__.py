"""Read-only looks at running channels, for people and for tools."""

from __future__ import annotations

from rosplc.monitor.expected import Expectation, Expected
from rosplc.monitor.message import Message, numbers
from rosplc.monitor.picture import BridgeView, ChannelView, Event, Picture, ReaderView, State
from rosplc.monitor.watch import CallObject, ObjectState, Watch, find_calls, find_objects

__all__ = [
    "BridgeView",
    "CallObject",
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
    "find_calls",
    "find_objects",
    "numbers",
]
