"""From what was seen of a channel to its state and a sentence."""

from __future__ import annotations

from dataclasses import dataclass

from rosplc.monitor.picture import ChannelView, ReaderView
from rosplc.monitor.states import State

__all__ = ["Signs", "judge", "silence_words"]


@dataclass(slots=True)
class Signs:
    """What is judged; names as in :class:`rosplc.monitor.ChannelView` mean the same.

    Attributes:
        to_plc: Whether messages go to the PLC.
        bridge_starting: Whether the bridge has a claim, and is too young to be expected to beat.
        moving: Whether messages came over the last seconds.
        refused_lately: Whether messages were refused lately.
        lost_lately: Whether messages were lost lately where each one counts.
        silent: Whether the source is silent for longer than it may be, and than one late message lasts.
    """

    to_plc: bool
    bridge_alive: bool | None
    bridge_pid: int
    bridge_starting: bool
    plc_alive: bool | None
    plc_claimed: bool
    readers: tuple[ReaderView, ...]
    received: int
    ros_peers: int | None
    stale: bool
    moving: bool
    refused_lately: bool
    lost_lately: bool
    silent: bool


def judge(signs: Signs) -> tuple[State, str]:
    """Return how a channel stands; of several things the worst counts."""
    if signs.bridge_alive is False:
        if signs.bridge_pid:
            return State.DEAD, f"the bridge does not beat any more; it was process {signs.bridge_pid}"
        return State.NO_BRIDGE, "the bridge has ended; this is what it left"
    if signs.plc_alive is False and signs.plc_claimed:
        if signs.to_plc:
            tasks = ", ".join(reader.task or f"process {reader.pid}" for reader in signs.readers)
            return State.DEAD, f"the PLC task that reads it does not beat any more: {tasks}"
        return State.DEAD, "the PLC task that writes it does not beat any more"
    if signs.bridge_starting:
        return (
            State.UNKNOWN,
            f"the bridge is starting, and does not beat yet; it is process {signs.bridge_pid}",
        )
    if signs.refused_lately:
        return State.REFUSED, "messages do not fit and are refused; the bridge's log says why"
    if signs.lost_lately:
        return State.LOST, "messages are lost, and each one counts; raise slots: or read more per scan"
    # Before silence, which begins with time: the same in the first second as in the tenth.
    if signs.plc_alive is False and not signs.received:
        return _no_plc(signs)
    if signs.silent:
        return (State.STALE if signs.received else State.SILENT), silence_words(signs)
    if signs.bridge_alive is None or (signs.plc_alive is None and signs.plc_claimed):
        return State.UNKNOWN, "looking for signs of life"
    if signs.plc_alive is False:
        return _no_plc(signs)
    if signs.ros_peers == 0:
        return State.OK, "nobody publishes" if signs.to_plc else "nobody subscribes"
    if not signs.received:
        return State.OK, "no message yet"
    return State.OK, "messages come" if signs.moving else "no message at present, which is allowed"


def _no_plc(signs: Signs) -> tuple[State, str]:
    if not signs.to_plc:
        return State.NO_PLC, "no PLC task writes it"
    nothing = "" if signs.received else f", and {silence_words(signs)}"
    return State.NO_PLC, f"no PLC task reads it{nothing}"


def silence_words(seen: Signs | ChannelView) -> str:
    """Return a sentence on a source that is silent, or was until a moment ago."""
    to_plc = seen.to_plc if isinstance(seen, Signs) else seen.direction == "to_plc"
    source = "ROS" if to_plc else "the PLC"
    nobody = to_plc and seen.ros_peers == 0
    if not seen.received:
        return f"no message yet from {source}" + (": nobody publishes" if nobody else "")
    if not seen.stale:
        return f"messages come again from {source}, after silence"
    gone = "; nobody publishes any more" if nobody else ""
    return f"no message from {source} for longer than it may be silent{gone}"
