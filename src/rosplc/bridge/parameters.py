"""Parameters of the bridge's node that are variables of the PLC.

One set of values is in progress at a time. The PLC shows the number of a set when all of its values are in
place. A set is refused when the PLC no longer shows signs of life.
"""

from __future__ import annotations

import logging
import secrets
import threading
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from rosplc.bridge.stream import OwnEnd, Stream
from rosplc.clock import Clock
from rosplc.config.parameters import TYPE, ParametersPlan
from rosplc.model import TypeStore
from rosplc.ros import fields
from rosplc.ros.parameters import Done, Parameter

_log = logging.getLogger("rosplc.bridge")
# For a set; a PLC is looked at each second, and seen to live when it has beaten between two looks.
_PATIENCE_NS = {True: 10_000_000_000, False: 2_500_000_000}
_NOT_RUNNING = "PLC is not running"
_NOT_TAKEN = "the PLC did not accept the value; check that its code was generated from this configuration"


@dataclass
class _Set:
    """Values that were requested; ``number`` is 0 until they have been sent to the PLC."""

    values: Mapping[str, Any]
    done: Done
    since_ns: int
    number: int = 0


class PlcParameters(OwnEnd):
    """The PLC's parameters; ``given`` overrides configured values, such as from ``--params-file``."""

    def __init__(
        self, plan: ParametersPlan, store: TypeStore, given: Mapping[str, Any], clock: Clock
    ) -> None:
        super().__init__()
        self.plan, self.store, self.clock = plan, store, clock
        self.values, self._given = {each.name: each.value for each in plan.declared} | dict(given), given
        self._sets: deque[_Set] = deque()
        self._number = 0  # of the last set that the PLC has taken; 0: none
        self._lock = threading.RLock()
        self._server: Any = None  # what shows them in ROS, with the methods of a ParameterServer
        self._streams: Sequence[Stream] = ()  # of both topics, once they are carried

    def serve(self, make: Callable[..., Any], own: list[Parameter]) -> Any:
        """Return the server that ``make`` creates from these and the node's own; raises as ``make``."""
        with self._lock:
            self._server = make([*own, *self.plan.declared], self.apply)
            self._server.values.update(self.values)
            return self._server

    def begin(self, streams: Sequence[Stream]) -> None:
        """Write the values of the configuration to a new object."""
        self._streams = streams
        if self.plan.initial == "file" and not self._streams[0].port.adopted:
            if self._server is not None:
                found = self._server.begin(self.values.keys() - self._given.keys())
                with self._lock:
                    self.values |= found
            self._restore()

    def apply(self, values: Mapping[str, Any], done: Done) -> None:
        """Set values in the PLC; see :data:`rosplc.ros.parameters.Apply`."""
        with self._lock:
            self._sets.append(_Set(values, done, self.clock.monotonic_ns()))
            self._next()

    @property
    def _alive(self) -> bool:
        now = self.clock.monotonic_ns()
        return bool(self._streams) and all(stream.port.status(now).peer_alive for stream in self._streams)

    def _next(self) -> None:
        """Send the next set to the PLC if the PLC is alive; the lock is held."""
        if self._sets and not self._sets[0].number and self._alive:
            due = self._sets[0]
            due.number = secrets.randbits(63) | 1  # no other set has it, of whatever bridge
            due.since_ns = self.clock.monotonic_ns()
            self._put(due.number, {**self.values, **due.values})

    def _put(self, number: int, values: Mapping[str, Any]) -> None:
        named = {field: values[name] for name, field in self.plan.fields.items()}
        self.give(fields.pack(self.store, TYPE, {"number": number, "values": named}), self.clock.time_ns())

    def _restore(self) -> None:
        """Send the known values to a PLC that starts without values."""
        with self._lock:
            self._put(secrets.randbits(63) | 1, self.values)

    def write(self, payload: bytes, stamp_ns: int) -> bool:
        """Accept the values that are in effect in the PLC."""
        found = fields.unpack(self.store, TYPE, payload)
        ended = None
        with self._lock:
            if not found["number"] and self.plan.initial == "file":
                self._restore()
                return True
            self._number = found["number"]
            values = {name: found["values"][field] for name, field in self.plan.fields.items()}
            changed, self.values = values != self.values, values
            if self._sets and self._sets[0].number == self._number:
                ended = self._sets.popleft()
            elif changed and not (self._sets and self._sets[0].number):
                # For a PLC that starts next: the number says that nothing is asked of this one.
                self._put(self._number, values)
            if self._server is not None:
                self._server.changed(values)
        if ended is not None:
            ended.done("")
        with self._lock:
            self._next()
        return True

    def check(self) -> None:
        """Refuse sets that the PLC does not accept; called once per second."""
        late, now_ns = [], self.clock.monotonic_ns()
        with self._lock:
            self._next()
            alive = self._alive
            while self._sets and now_ns - self._sets[0].since_ns > _PATIENCE_NS[alive]:
                late.append(self._sets.popleft())
            if any(each.number for each in late):
                self._put(self._number, self.values)  # a PLC that comes back finds nothing to take
        why = _NOT_TAKEN if alive else _NOT_RUNNING
        for each in late:
            _log.warning("%s: %s", ", ".join(each.values), why)
            each.done(why)
