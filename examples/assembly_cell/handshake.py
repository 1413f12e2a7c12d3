"""RosPlc_Handshake and RosPlc_HandshakeReply of the generated project, in Python.

The asking side stands in the virtual PLC, the replying one in the robot: in the source it would be C++
or Python as well. Names are those of the function blocks.
"""

from __future__ import annotations

import time

__all__ = ["Handshake", "HandshakeReply"]

_NUMBERS = 1 << 32


class Handshake:
    """The asking side: a job is asked for once, whatever restarts in between."""

    def __init__(self) -> None:
        self.udiJob = 0
        self.xBusy = self.xDone = self.xError = False
        self._held = False
        self._number = 0

    def __call__(self, *, xExecute: bool, udiDone: int, xPeerAlive: bool) -> None:
        """Run one scan; ``xExecute`` asks with its rising edge."""
        if not xExecute:
            self._held = self.xDone = self.xError = False
        if xExecute and not self._held and not self.xBusy:
            self._held = True
            if xPeerAlive:
                self._ask(udiDone)
            else:
                self.xError = True
        if self.xBusy:
            done = udiDone == self.udiJob
            if done or not xPeerAlive:
                self.xDone, self.xError = done and self._held, not done and self._held
                self.xBusy, self.udiJob = False, 0

    def _ask(self, done: int) -> None:
        if self._number == 0:
            # The other side may have a job in hand that was asked for before this one was started anew.
            self._number = (done + time.monotonic_ns() // 1_000_000 % 1_000_000) % _NUMBERS
        elif done and (done - self._number) % _NUMBERS < _NUMBERS // 2:
            self._number = done
        self._number = (self._number + 1) % _NUMBERS or 1
        self.udiJob = self._number
        self.xBusy = True


class HandshakeReply:
    """The doing side: each job is begun once."""

    def __init__(self) -> None:
        self.xBusy = False
        self.udiDone = 0
        self._wanted = self._current = 0

    def wish(self, job: int) -> None:
        """Take over what the other side wants; 0: nothing."""
        self._wanted = job

    def start(self) -> bool:
        """Return whether a job is to be begun now; it is in hand then."""
        if self.xBusy or self._wanted in (0, self._current, self.udiDone):
            return False
        self._current = self._wanted
        self.xBusy = True
        return True

    def finish(self) -> None:
        """Report the job in hand as done."""
        self.xBusy = False
        self.udiDone = self._current
