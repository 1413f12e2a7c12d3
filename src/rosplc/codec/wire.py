"""The two serializations that ROS sends."""

from __future__ import annotations

import enum


class Wire(enum.Enum):
    """How a message is laid out on the wire; the values are those in a plan's head.

    ``CDR`` is ROS 2: plain CDR version 1 behind a 4-byte encapsulation header, either byte
    order read, little-endian written (OMG DDS-XTypes 1.3, section 7.4.1). ``ROS1`` is what
    ROS 1 sends: little-endian without any alignment.
    """

    CDR = 0
    ROS1 = 1
