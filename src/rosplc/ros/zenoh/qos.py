"""Quality of service as the liveliness tokens of ``rmw_zenoh_cpp`` carry it.

The string is ``reliability:durability:history,depth:deadline:lifespan:liveliness``, where the
last three are ``seconds,nanoseconds`` (liveliness: ``kind,seconds,nanoseconds``). Numbers are
those of ``rmw/types.h``; what equals rmw_zenoh's default is left empty. Early releases wrote
the first three parts only, with every number.
"""

from __future__ import annotations

from rosplc.ros.qos import Durability, Qos, Reliability

__all__ = ["decode_qos", "encode_qos"]

_BEST_EFFORT = "2"
_TRANSIENT_LOCAL = "1"
_KINDS = frozenset({"", "0", "1", "2", "3", "4", "5"})  # of rmw's enumerations; empty is the default
_DEPTH = 42  # rmw_zenoh's default, which is not ROS's
_LONGEST = 2**31 - 1
_UNBOUNDED = ":,:,:,,"  # no deadline, no lifespan, automatic liveliness without a lease


def encode_qos(qos: Qos) -> str:
    """Return the settings as a token carries them."""
    reliability = "" if qos.reliability == "reliable" else _BEST_EFFORT
    durability = "" if qos.durability == "volatile" else _TRANSIENT_LOCAL
    depth = "" if qos.depth == _DEPTH else qos.depth
    return f"{reliability}:{durability}:,{depth}{_UNBOUNDED}"


def decode_qos(text: str) -> Qos:
    """Read the settings of a token, of the short form or the long one.

    Raises:
        ValueError: It is neither.
    """
    parts = text.split(":")
    if len(parts) < 3:
        raise ValueError("the QoS has fewer than three parts")
    history, comma, depth = parts[2].partition(",")
    if not comma or not {parts[0], parts[1], history} <= _KINDS:
        raise ValueError("the QoS has kinds that ROS does not know")
    numbers = [depth, *(number for part in parts[3:6] for number in part.split(","))]
    if not all(number == "" or (number.isascii() and number.isdigit()) for number in numbers):
        raise ValueError("the QoS has something else than numbers")
    reliability: Reliability = "best_effort" if parts[0] == _BEST_EFFORT else "reliable"
    durability: Durability = "transient_local" if parts[1] == _TRANSIENT_LOCAL else "volatile"
    return Qos(reliability, durability, max(1, min(int(depth[:20] or _DEPTH), _LONGEST)))
