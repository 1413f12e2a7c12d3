"""Read-only looks at running channels, for people and for tools."""

from __future__ import annotations

from rosplc.monitor.classic import Expectation as Expectation
from rosplc.monitor.classic import Expected as Expected
from rosplc.monitor.message import Message as Message
from rosplc.monitor.message import numbers as numbers
from rosplc.monitor.picture import BridgeView as BridgeView
from rosplc.monitor.picture import CallView as CallView
from rosplc.monitor.picture import ChannelView as ChannelView
from rosplc.monitor.picture import Event as Event
from rosplc.monitor.picture import Picture as Picture
from rosplc.monitor.picture import ReaderView as ReaderView
from rosplc.monitor.picture import State as State
from rosplc.monitor.watch import ObjectState as ObjectState
from rosplc.monitor.watch import Watch as Watch
from rosplc.monitor.watch import find_objects as find_objects
