"""From what was seen of a channel to its state and a sentence."""

from __future__ import annotations

from rosplc.monitor.picture import ChannelView
from rosplc.monitor.states import State

__all__ = ["judge", "silence_words"]


def judge(
    seen: ChannelView, *, starting: bool = False, refused_lately: bool = False, lost_lately: bool = False
) -> tuple[State, str]:
    """Return how a channel is, in a word and a sentence; of several things the worst counts.

    Args:
        seen: What was seen of it.
        starting: Whether the bridge has a claim, and is too young to be expected to beat.
        refused_lately: Whether messages were refused lately.
        lost_lately: Whether messages were lost lately where each one counts.
    """
    to_plc = seen.direction == "to_plc"
    if seen.bridge_alive is False:
        if seen.bridge_pid:
            return State.DEAD, f"the bridge does not beat any more; it was process {seen.bridge_pid}"
        return State.NO_BRIDGE, "the bridge has ended; this is what it left"
    if seen.plc_alive is False and seen.plc_claimed:
        if to_plc:
            tasks = ", ".join(reader.task or f"process {reader.pid}" for reader in seen.readers)
            return State.DEAD, f"the PLC task that reads it does not beat any more: {tasks}"
        return State.DEAD, "the PLC task that writes it does not beat any more"
    if starting:
        return (
            State.UNKNOWN,
            f"the bridge is starting, and does not beat yet; it is process {seen.bridge_pid}",
        )
    if refused_lately:
        return State.REFUSED, "messages do not fit and are refused; the bridge's log says why"
    if lost_lately:
        return State.LOST, "messages are lost, and each one counts; raise slots: or read more per scan"
    # Before silence, which begins with time: the same in the first second as in the tenth.
    if seen.plc_alive is False and not seen.received:
        return _no_plc(seen)
    if seen.silent:
        return (State.STALE if seen.received else State.SILENT), silence_words(seen)
    if seen.bridge_alive is None or (seen.plc_alive is None and seen.plc_claimed):
        return State.UNKNOWN, "looking for signs of life"
    if seen.plc_alive is False:
        return _no_plc(seen)
    if seen.ros_peers == 0:
        return State.OK, "nobody publishes" if to_plc else "nobody subscribes"
    if not seen.received:
        return State.OK, "no message yet"
    return State.OK, "messages come" if seen.rate_hz else "no message at present, which is allowed"


def _no_plc(seen: ChannelView) -> tuple[State, str]:
    if seen.direction != "to_plc":
        return State.NO_PLC, "no PLC task writes it"
    nothing = "" if seen.received else f", and {silence_words(seen)}"
    return State.NO_PLC, f"no PLC task reads it{nothing}"


def silence_words(seen: ChannelView) -> str:
    """Return a sentence on a source that is silent, or was until a moment ago."""
    to_plc = seen.direction == "to_plc"
    source = "ROS" if to_plc else "the PLC"
    nobody = to_plc and seen.ros_peers == 0
    if not seen.received:
        return f"no message yet from {source}" + (": nobody publishes" if nobody else "")
    if not seen.stale:
        return f"messages come again from {source}, after silence"
    gone = "; nobody publishes any more" if nobody else ""
    return f"no message from {source} for longer than it may be silent{gone}"
