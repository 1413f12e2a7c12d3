"""What is really there: handles, a nest, a press, a robot's arm; and what must never happen.

It outlives bridge and PLC, as steel does. Whatever goes wrong between the two shows here: a handle pressed
twice, a collision, a handle that is lost or delivered unfinished is written down as a mishap.
"""

from __future__ import annotations

from dataclasses import dataclass, field

__all__ = ["ASSEMBLING", "IDLE", "PLACE", "PLACING", "REMOVE", "REMOVING", "Handle", "World"]

IDLE, ASSEMBLING, PLACING, REMOVING = range(4)
PLACE, REMOVE = 1, 2

_ASSEMBLE_S, _REACH_S, _STROKE_S = 0.3, 0.2, 0.15
_LASTS = {IDLE: 1.0, ASSEMBLING: _ASSEMBLE_S, PLACING: 2 * _REACH_S, REMOVING: 2 * _REACH_S}  # seconds


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
        ended: How many jobs the robot has ended.
        moved: Whether it moved for the last of them.
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
    ended: int = 0
    moved: bool = False
    _since: float = 0.0
    _job: tuple[int, int] | None = None

    @property
    def zone_free(self) -> bool:
        """The light barrier: whether the arm is out of the machine."""
        return self.phase not in (PLACING, REMOVING)

    @property
    def way(self) -> float:
        """How much of the robot's phase is done, 0 to 1."""
        return min(1.0, self._since / _LASTS[self.phase])

    def take(self, what: int, serial: int) -> bool:
        """Take a job in hand; False if it cannot be done, or while there is another."""
        if self._job is not None:
            return False
        next_one = self.placed + bool(self.tray) if what == PLACE else min(len(self.box) + 1, self.placed)
        if what not in (PLACE, REMOVE) or serial > next_one:
            self.mishaps.append(f"a job that cannot be done: {what}, handle {serial}")
            return False
        self._job = what, serial
        return True

    def drop(self) -> bool:
        """Give the job in hand back; False once the arm is in the machine, where it finishes its way."""
        if self._job is None or not self.zone_free:
            return False
        self.phase, self._since, self._job = IDLE, 0.0, None
        return True

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
            if self._job is not None:
                self._begin(*self._job)
            return
        before, self._since = self._since, self._since + seconds
        if self.phase == ASSEMBLING and self._since >= _ASSEMBLE_S:
            self.tray -= 1
            self.gripper = Handle(self.placed + 1)
            self.phase, self._since = PLACING, 0.0
        elif not self.zone_free:
            if before < _REACH_S <= self._since:
                self._put_down() if self.phase == PLACING else self._take()
            if self._since >= 2 * _REACH_S:
                if self.phase == REMOVING and self.gripper is not None:
                    self.box.append(self.gripper.serial)
                    self.gripper = None
                self._end(moved=True)

    def _begin(self, what: int, serial: int) -> None:
        if serial <= (len(self.box) if what == REMOVE else self.placed):
            self._end(moved=False)  # it was done before: the PLC has asked twice
        else:
            self.phase, self._since = (REMOVING if what == REMOVE else ASSEMBLING), 0.0

    def _end(self, *, moved: bool) -> None:
        self.phase, self._since, self._job = IDLE, 0.0, None
        self.ended, self.moved = self.ended + 1, moved

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
