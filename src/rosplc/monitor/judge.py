"""From what was seen of a channel to its state and a sentence."""

from __future__ import annotations

from rosplc.monitor.picture import ChannelView
from rosplc.monitor.states import State

__all__ = ["judge"]


def judge(view: ChannelView, *, refused: bool, lost: bool, silent: bool, held: bool) -> tuple[State, str]:
    """Return how a channel stands; of several things the worst counts.

    Args:
        view: What was seen; its state and words do not matter.
        refused: Whether messages were refused lately.
        lost: Whether messages were lost lately where each one counts.
        silent: Whether the source is silent for longer than it may be, and than one late message lasts.
        held: Whether the PLC's side holds a claim.
    """
    to_plc = view.direction == "to_plc"
    if view.bridge_alive is False:
        if view.bridge_pid:
            return State.DEAD, f"the bridge does not beat any more; it was process {view.bridge_pid}"
        return State.NO_BRIDGE, "the bridge has ended; this is what it left"
    if view.plc_alive is False and held:
        tasks = ", ".join(reader.task or f"process {reader.pid}" for reader in view.readers)
        if to_plc:
            return State.DEAD, f"the PLC task that reads it does not beat any more: {tasks}"
        return State.DEAD, "the PLC task that writes it does not beat any more"
    if refused:
        return State.REFUSED, "messages do not fit and are refused; the bridge's log says why"
    if lost:
        return State.LOST, "messages are lost, and each one counts; raise depth: or read more per scan"
    if silent:
        return (State.STALE if view.received else State.SILENT), _silence(view, to_plc=to_plc)
    if view.bridge_alive is None or (view.plc_alive is None and held):
        return State.UNKNOWN, "looking for signs of life"
    if view.plc_alive is False:
        return State.NO_PLC, "no PLC task reads it" if to_plc else "no PLC task writes it"
    if view.ros_peers == 0:
        return State.OK, "nobody publishes" if to_plc else "nobody subscribes"
    if not view.received:
        return State.OK, "no message yet"
    return State.OK, "messages come" if view.rate_hz else "no message at present, which is allowed"


def _silence(view: ChannelView, *, to_plc: bool) -> str:
    source = "ROS" if to_plc else "the PLC"
    if view.received:
        if not view.stale:
            return f"messages come again from {source}, after silence"
        gone = "; nobody publishes any more" if to_plc and view.ros_peers == 0 else ""
        return f"no message from {source} for longer than it may be silent{gone}"
    gone = ": nobody publishes" if to_plc and view.ros_peers == 0 else ""
    return f"no message yet from {source}{gone}"
