"""The simulated robot: a turtle on wheels that obeys velocity commands."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from rosplc.demo.messages import BEAMS, JOINTS, joint_state, laser_scan

__all__ = ["Turtle", "steer"]

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
            return joint_state([self.wheel] * JOINTS, self.forward / _WHEEL_RADIUS)
        away = math.hypot(self.x, self.y)
        return laser_scan([_ROOM_RADIUS - away * math.cos(beam * math.tau / BEAMS) for beam in range(BEAMS)])


def steer(x: float, y: float, heading: float, corner: int) -> tuple[float, float, int]:
    """Compute the command that leads round a square: the virtual PLC's control law.

    Args:
        x: Position, metres.
        y: Position, metres.
        heading: Direction, radians.
        corner: Index of the corner aimed at.

    Returns:
        Forward speed (m/s), turning speed (rad/s) and the corner to aim at next.
    """
    goal_x, goal_y = _CORNERS[corner % len(_CORNERS)]
    if math.hypot(goal_x - x, goal_y - y) < 0.1:
        corner = (corner + 1) % len(_CORNERS)
        goal_x, goal_y = _CORNERS[corner]
    error = math.remainder(math.atan2(goal_y - y, goal_x - x) - heading, math.tau)
    turn = max(-2.0, min(2.0, 3.0 * error))
    forward = 0.5 * max(0.0, math.cos(error))
    return forward, turn, corner
