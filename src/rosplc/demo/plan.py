"""What one run of the demonstration consists of; handed to its processes as JSON."""

from __future__ import annotations

import json
import math
import random
import secrets
import socket
import zlib
from array import array
from collections.abc import Callable, Iterable
from contextlib import ExitStack
from dataclasses import asdict, dataclass, field
from operator import attrgetter
from typing import Any

from rosplc.errors import SetupError

SECOND_NS = 1_000_000_000

_JOINTS = tuple(f"wheel_{side}_{end}" for end in ("front", "rear") for side in ("left", "right"))
_BEAMS = 64


@dataclass(frozen=True, slots=True)
class Opened:
    """What a received message says about itself.

    ``number`` is of the sender's count, from 1, and 0 if the seal is broken; ``whole``: seal and contents
    agree; ``stamp_ns``: when it was made, ns since 1970, 0 where it carries none.
    """

    number: int
    whole: bool
    stamp_ns: int = 0


@dataclass(frozen=True, slots=True)
class Kind:
    """A kind of message that the robot sends.

    ``name`` is its topic's last part, ``frame`` is in ``header.frame_id``; ``numbers`` returns every
    number of a message (a dict or a record view), as ``float64`` values.
    """

    name: str
    type_name: str
    frame: str
    numbers: Callable[[Any], Iterable[float]]

    def seal(self, value: dict[str, Any], number: int, stamp_ns: int) -> dict[str, Any]:
        """Return ``value`` with a header that numbers, dates and seals it."""
        crc = _crc(number, stamp_ns, self.numbers(_Dotted(value)))
        value["header"] = {
            "stamp": {"sec": stamp_ns // SECOND_NS, "nanosec": stamp_ns % SECOND_NS},
            "frame_id": f"{self.frame} {number} {crc:08x}",
        }
        return value

    def open(self, message: Any) -> Opened:
        """Check a received message (attribute access, as a record view gives it)."""
        stamp = message.header.stamp
        stamp_ns = stamp.sec * SECOND_NS + stamp.nanosec
        try:
            frame, number, crc = message.header.frame_id.split(" ")
            whole = frame == self.frame and int(crc, 16) == _crc(int(number), stamp_ns, self.numbers(message))
        except ValueError:
            return Opened(0, False)
        return Opened(int(number) if whole else 0, whole, stamp_ns)


class _Dotted:
    """Attribute access to nested dicts, so that one function reads dicts and views."""

    def __init__(self, value: dict[str, Any]) -> None:
        self._value = value

    def __getattr__(self, name: str) -> Any:
        value = self._value[name]
        return _Dotted(value) if isinstance(value, dict) else value


def _crc(number: int, stamp_ns: int, numbers: Iterable[float]) -> int:
    head = number.to_bytes(4, "little") + stamp_ns.to_bytes(8, "little")
    return zlib.crc32(array("d", numbers).tobytes(), zlib.crc32(head))


_pose = ("position.x", "position.y", "position.z", *(f"orientation.{axis}" for axis in "xyzw"))
_POSE = Kind("pose", "geometry_msgs/msg/PoseStamped", "odom", attrgetter(*(f"pose.{part}" for part in _pose)))
_JOINT = Kind(
    "joint_states", "sensor_msgs/msg/JointState", "base", lambda m: [*m.position, *m.velocity, *m.effort]
)
_SCAN = Kind(
    "scan", "sensor_msgs/msg/LaserScan", "laser", lambda m: [m.angle_min, m.angle_max, m.range_max, *m.ranges]
)

COMMAND = ("/turtle/cmd_vel", "geometry_msgs/msg/Twist")  # topic and type of what the PLC sends back


def robot_topics(count: int) -> dict[str, Kind]:
    """Return the robot's first ``count`` topics: pose, joint states, then laser scans."""
    topics = {"/turtle/pose": _POSE, "/turtle/joint_states": _JOINT, "/turtle/scan": _SCAN}
    for number in range(4, count + 1):
        topics[f"/turtle/scan_{number}"] = _SCAN
    return dict(list(topics.items())[:count])


def command(number: int, forward: float, turn: float) -> dict[str, Any]:
    """Return a Twist that drives ``forward`` (m/s) and turns (rad/s), numbered and sealed."""
    seal = float(_crc(number, 0, [forward, turn]))
    return {
        "linear": {"x": forward, "y": 0.0, "z": float(number)},
        "angular": {"x": seal, "y": 0.0, "z": turn},
    }


def open_command(message: Any) -> Opened:
    """Check a received command."""
    linear, angular = message.linear, message.angular
    if not (linear.z.is_integer() and 0 < linear.z < 2**32):
        return Opened(0, False)
    number = int(linear.z)
    whole = linear.y == angular.y == 0.0 and angular.x == _crc(number, 0, [linear.x, angular.z])
    return Opened(number if whole else 0, whole)


_WHEEL_RADIUS = 0.05
_ROOM_RADIUS = 10.0
_CORNERS = ((2.0, 0.0), (2.0, 2.0), (0.0, 2.0), (0.0, 0.0))


@dataclass(slots=True)
class Turtle:
    """Where the robot is and how it moves: metres, radians, seconds."""

    x: float = 0.0
    y: float = 0.0
    heading: float = 0.0
    forward: float = 0.0
    turn: float = 0.0
    wheel: float = 0.0
    way: float = 0.0

    def obey(self, forward: float, turn: float) -> None:
        """Take over a command."""
        self.forward, self.turn = forward, turn

    def move(self, seconds: float) -> None:
        """Go on for ``seconds`` with the present command."""
        self.heading = math.remainder(self.heading + self.turn * seconds, math.tau)
        self.x += self.forward * math.cos(self.heading) * seconds
        self.y += self.forward * math.sin(self.heading) * seconds
        self.wheel += self.forward / _WHEEL_RADIUS * seconds
        self.way += abs(self.forward) * seconds

    def contents(self, kind: str) -> dict[str, Any]:
        """Return what a message of ``kind`` says about the robot now, without its header."""
        if kind == "pose":
            half = self.heading / 2
            orientation = {"x": 0.0, "y": 0.0, "z": math.sin(half), "w": math.cos(half)}
            return {"pose": {"position": {"x": self.x, "y": self.y, "z": 0.0}, "orientation": orientation}}
        if kind == "joint_states":
            values = {
                "position": self.wheel,
                "velocity": self.forward / _WHEEL_RADIUS,
                "effort": 0.1 * self.wheel,
            }
            return {"name": list(_JOINTS), **{key: [value] * len(_JOINTS) for key, value in values.items()}}
        away = math.hypot(self.x, self.y)
        distances = [_ROOM_RADIUS - away * math.cos(beam * math.tau / _BEAMS) for beam in range(_BEAMS)]
        low, high, far, *ranges = array("f", [-3.14159, 3.14159, 30.0, *distances])  # as the type rounds them
        return {"angle_min": low, "angle_max": high, "range_max": far, "ranges": ranges}


def steer(x: float, y: float, heading: float, corner: int) -> tuple[float, float, int]:
    """Compute the command that leads round a square: the virtual PLC's control law.

    From a position (m), a heading (rad) and the index of the corner aimed at, return forward speed (m/s),
    turning speed (rad/s) and the corner to aim at next.
    """
    goal_x, goal_y = _CORNERS[corner % len(_CORNERS)]
    if math.hypot(goal_x - x, goal_y - y) < 0.1:
        corner = (corner + 1) % len(_CORNERS)
        goal_x, goal_y = _CORNERS[corner]
    error = math.remainder(math.atan2(goal_y - y, goal_x - x) - heading, math.tau)
    turn = max(-2.0, min(2.0, 3.0 * error))
    forward = 0.5 * max(0.0, math.cos(error))
    return forward, turn, corner


@dataclass(slots=True)
class Tally:
    """What one receiver saw of one topic; numbers start at 1.

    ``received`` are whole messages with a new number, ``missing`` numbers left out so far and ``gaps`` how
    often that was; ``torn`` do not agree with their seal, ``repeated`` have a number at or below ``newest``.
    """

    received: int = 0
    missing: int = 0
    gaps: int = 0
    torn: int = 0
    repeated: int = 0
    newest: int = 0

    def add(self, number: int, *, whole: bool) -> None:
        """Count one message."""
        if not whole:
            self.torn += 1
        elif number <= self.newest:
            self.repeated += 1
        else:
            self.missing += number - self.newest - 1
            self.gaps += number > self.newest + 1
            self.newest = number
            self.received += 1


_FIRST, _LAST = 1, 101  # above 101 the ports meet those that Linux gives to clients
_PARTICIPANTS = 8


class FreeDomain:
    """A DDS domain in 1 … 101, ``number``, whose UDP ports are free, kept from other demonstrations.

    Raises SetupError SYS003 if no such domain was found.
    """

    def __init__(self) -> None:
        for number in random.sample(range(_FIRST, _LAST + 1), _LAST):
            # Two demonstrations that start together would find the same ports free. An abstract socket can
            # be bound once per network namespace, as the ports can, and vanishes with its process.
            claim = _bound(socket.AF_UNIX, f"\0rosplc-demo-domain-{number}")
            if claim is not None and _is_free(number):
                self.number, self._claim = number, claim
                return
            if claim is not None:
                claim.close()
        raise SetupError("SYS003", f"every DDS domain from {_FIRST} to {_LAST} is in use")

    def close(self) -> None:
        """Let others have it; a second call does nothing."""
        self._claim.close()


def _is_free(number: int) -> bool:
    # Ports of the DDSI-RTPS standard: 7400 + 250 × domain, + 0 and + 1 for multicast, then two
    # per participant from + 10 on.
    base = 7400 + 250 * number
    with ExitStack() as stack:
        for port in (base, base + 1, *range(base + 10, base + 10 + 2 * _PARTICIPANTS)):
            probe = _bound(socket.AF_INET, ("127.0.0.1", port))
            if probe is None:
                return False
            stack.enter_context(probe)
    return True


def _bound(family: socket.AddressFamily, address: str | tuple[str, int]) -> socket.socket | None:
    """Return a datagram socket that has an address; None if another has it."""
    found = socket.socket(family, socket.SOCK_DGRAM)
    try:
        found.bind(address)
    except OSError:
        found.close()
        return None
    return found


@dataclass(frozen=True, slots=True)
class Plan:
    """The run's settings.

    DDS ``domain`` and ``prefix`` are unused by others, so that nothing else is touched. The robot sends so
    many ``topics`` with ``rate`` Hz each; ``interval`` is the PLC's cycle in seconds; message definitions are
    those of ``distro``.
    """

    domain: int
    rate: float
    topics: int
    prefix: str = field(default_factory=lambda: f"demo-{secrets.token_hex(4)}")
    interval: float = 0.01
    distro: str = "jazzy"

    def to_json(self) -> str:
        """Return the plan as one line of JSON."""
        return json.dumps(asdict(self))

    @classmethod
    def from_json(cls, text: str) -> Plan:
        """Read what :meth:`to_json` wrote."""
        return cls(**json.loads(text))

    @property
    def slots(self) -> int:
        """Slots per channel: two seconds' worth, since a busy machine stops a process that long."""
        return min(4096, 1 << math.ceil(math.log2(max(16.0, 2 * max(self.rate, 1 / self.interval)))))

    @property
    def per_scan(self) -> int:
        """Messages of a topic that the PLC takes in one scan: enough to catch up after a stop."""
        return max(8, math.ceil(8 * self.rate * self.interval))

    def configuration(self) -> dict[str, Any]:
        """Return the bridge's configuration, as ``rosplc run`` reads it."""
        kept = {"every": True, "slots": self.slots}
        scan = {"ranges": 64, "intensities": 1}
        topics: dict[str, Any] = {
            name: {"type": kind.type_name, "to": "plc", **kept, "limits": scan if kind.name == "scan" else {}}
            for name, kind in robot_topics(self.topics).items()
        }
        command, type_name = COMMAND
        topics[command] = {"type": type_name, "to": "ros", **kept}
        return {
            "bridge": "demo",
            "prefix": self.prefix,
            "ros": {"backend": "dds", "distro": self.distro, "domain": self.domain},
            "diagnostics": {"enabled": False},
            "topics": topics,
        }
