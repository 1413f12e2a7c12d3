"""What is really there: handles, a nest, a press, a robot's arm; and what must never happen.

It outlives bridge and PLC, as steel does. Whatever goes wrong between the two shows here: a handle pressed
twice, a collision, a handle that is lost or delivered unfinished is written down as a mishap.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from examples.assembly_cell.handshake import HandshakeReply

__all__ = ["ASSEMBLING", "IDLE", "PLACE", "PLACING", "REMOVE", "REMOVING", "Handle", "World"]

IDLE, ASSEMBLING, PLACING, REMOVING = range(4)
PLACE, REMOVE = 1, 2

_ASSEMBLE_S, _REACH_S, _STROKE_S = 0.3, 0.2, 0.15


@dataclass
class Handle:
    """One door handle."""

    serial: int
    pins: int = 0


@dataclass
class World:
    """The cell; :meth:`step` lets time pass.

    Args:
        tray: Handles that are to be made.

    Attributes:
        nest: The handle in the machine.
        gripper: The handle in the robot's hand.
        box: Serial numbers of what was delivered, in order.
        phase: What the robot does.
        stopped: The robot's protective stop.
        placed: Serial number of the handle that was placed last.
        cylinder: 0 is up, 1 is down.
        mishaps: What must never have happened.
    """

    tray: int
    nest: Handle | None = None
    gripper: Handle | None = None
    box: list[int] = field(default_factory=list)
    phase: int = IDLE
    stopped: bool = False
    placed: int = 0
    cylinder: float = 0.0
    mishaps: list[str] = field(default_factory=list)
    reply: HandshakeReply = field(default_factory=HandshakeReply)
    _way: float = 0.0
    _wish: tuple[int, int] = (0, 0)

    @property
    def zone_free(self) -> bool:
        """The light barrier: whether the arm is out of the machine."""
        return self.phase not in (PLACING, REMOVING)

    def wish(self, number: int, what: int, serial: int) -> None:
        """Take over what the PLC wants of the robot."""
        self.reply.wish(number)
        self._wish = what, serial

    def step(self, seconds: float, *, press_down: bool) -> None:
        """Let time pass, with the press's output as it is."""
        self._press(seconds, down=press_down)
        if not self.stopped:
            self._robot(seconds)

    def _press(self, seconds: float, *, down: bool) -> None:
        before = self.cylinder
        self.cylinder = min(1.0, max(0.0, before + (seconds if down else -seconds) / _STROKE_S))
        if self.cylinder > before and not self.zone_free:
            self.mishaps.append(f"the press came down on the robot, with handle {self.placed}")
        if self.cylinder == 1.0 and before < 1.0:
            if self.nest is None:
                self.mishaps.append("the press came down on an empty nest")
            else:
                self.nest.pins += 1
                if self.nest.pins > 1:
                    self.mishaps.append(f"handle {self.nest.serial} was pressed {self.nest.pins} times")

    def _robot(self, seconds: float) -> None:
        if self.phase == IDLE:
            if self.reply.start():
                self._begin()
            return
        before, self._way = self._way, self._way + seconds
        if self.phase == ASSEMBLING and self._way >= _ASSEMBLE_S:
            self.tray -= 1
            self.gripper = Handle(self.placed + 1)
            self.phase, self._way = PLACING, 0.0
        elif self.phase in (PLACING, REMOVING):
            if before < _REACH_S <= self._way:
                self._put_down() if self.phase == PLACING else self._take()
            if self._way >= 2 * _REACH_S:
                if self.phase == REMOVING and self.gripper is not None:
                    self.box.append(self.gripper.serial)
                    self.gripper = None
                self.phase = IDLE
                self.reply.finish()

    def _begin(self) -> None:
        what, serial = self._wish
        self._way = 0.0
        if what == PLACE and serial == self.placed + 1 and self.tray:
            self.phase = ASSEMBLING
        elif what == REMOVE and serial == len(self.box) + 1 and serial == self.placed:
            self.phase = REMOVING
        else:
            if serial > self.placed:
                self.mishaps.append(f"a job that cannot be done: {what}, handle {serial}")
            self.reply.finish()  # was done before: the wish came twice

    def _put_down(self) -> None:
        if self.nest is not None:
            self.mishaps.append(f"handle {self.placed + 1} was put on handle {self.nest.serial}")
        if self.cylinder > 0.0:
            self.mishaps.append(f"the robot ran into the press with handle {self.placed + 1}")
        self.nest, self.gripper = self.gripper, None
        self.placed += 1

    def _take(self) -> None:
        if self.nest is None:
            self.mishaps.append("the robot took a handle that was not there")
        elif self.nest.pins != 1:
            self.mishaps.append(f"handle {self.nest.serial} was taken with {self.nest.pins} pins")
        if self.cylinder > 0.0:
            self.mishaps.append("the robot ran into the press")
        self.gripper, self.nest = self.nest, None
