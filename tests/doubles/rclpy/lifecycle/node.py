"""rclpy/lifecycle/node.py: rcl_lifecycle's default state machine, without its services."""

from __future__ import annotations

from enum import Enum
from typing import Any, NamedTuple

from rclpy._handles import RCLError
from rclpy.node import Node


class TransitionCallbackReturn(Enum):
    SUCCESS = 97
    FAILURE = 98
    ERROR = 99


class LifecycleState(NamedTuple):
    label: str
    state_id: int


# transition: (states it starts from, where success leads; failure leads back)
_TRANSITIONS = {
    "configure": (("unconfigured",), "inactive"),
    "cleanup": (("inactive",), "unconfigured"),
    "activate": (("inactive",), "active"),
    "deactivate": (("active",), "inactive"),
    "shutdown": (("unconfigured", "inactive", "active"), "finalized"),
}
_IDS = {"unconfigured": 1, "inactive": 2, "active": 3, "finalized": 4}


class LifecycleNodeMixin:
    def __init__(self, *, enable_communication_interface: bool = True, callback_group: Any = None) -> None:
        self.state = "unconfigured"  # the double's own: a test reads it

    def on_configure(self, state: Any) -> TransitionCallbackReturn:
        return TransitionCallbackReturn.SUCCESS

    def on_cleanup(self, state: Any) -> TransitionCallbackReturn:
        return TransitionCallbackReturn.SUCCESS

    def on_shutdown(self, state: Any) -> TransitionCallbackReturn:
        return TransitionCallbackReturn.SUCCESS

    def on_activate(self, state: Any) -> TransitionCallbackReturn:
        return TransitionCallbackReturn.SUCCESS

    def on_deactivate(self, state: Any) -> TransitionCallbackReturn:
        return TransitionCallbackReturn.SUCCESS

    def on_error(self, state: Any) -> TransitionCallbackReturn:
        return TransitionCallbackReturn.SUCCESS

    def _change(self, transition: str) -> TransitionCallbackReturn:
        starts, goal = _TRANSITIONS[transition]
        if self.state not in starts:
            raise RCLError(f"Failed to trigger lifecycle state machine transition: {transition}")
        before = LifecycleState(self.state, _IDS[self.state])
        result = self._call(f"on_{transition}", before)
        if result is TransitionCallbackReturn.SUCCESS:
            self.state = goal
        elif result is TransitionCallbackReturn.ERROR or transition == "shutdown":
            recovered = self._call("on_error", before) is TransitionCallbackReturn.SUCCESS
            self.state = "unconfigured" if recovered else "finalized"
        return result

    def _call(self, callback: str, before: LifecycleState) -> TransitionCallbackReturn:
        try:
            result = getattr(self, callback)(before)
        except Exception:  # rclpy swallows it without a word
            return TransitionCallbackReturn.ERROR
        assert isinstance(result, TransitionCallbackReturn)
        return result

    def trigger_configure(self) -> TransitionCallbackReturn:
        return self._change("configure")

    def trigger_cleanup(self) -> TransitionCallbackReturn:
        return self._change("cleanup")

    def trigger_shutdown(self) -> TransitionCallbackReturn:
        return self._change("shutdown")

    def trigger_activate(self) -> TransitionCallbackReturn:
        return self._change("activate")

    def trigger_deactivate(self) -> TransitionCallbackReturn:
        return self._change("deactivate")


class LifecycleNode(LifecycleNodeMixin, Node):
    def __init__(self, node_name: str, *, enable_communication_interface: bool = True, **kwargs: Any) -> None:
        Node.__init__(self, node_name, **kwargs)
        LifecycleNodeMixin.__init__(self, enable_communication_interface=enable_communication_interface)
