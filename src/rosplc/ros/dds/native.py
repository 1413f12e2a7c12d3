"""The few functions of Cyclone DDS's C library that the ``cyclonedds`` wheel does not offer as such.

Calls through here release the GIL; the wheel's own ``ddspy_*`` functions do not. Entities
are plain integers in this module. Nothing else in rosplc touches ctypes for DDS.
"""

from __future__ import annotations

import ctypes as ct
from typing import Any

from cyclonedds.core import DDSException, Entity, InstanceState, SampleState, ViewState
from cyclonedds.internal import DDS, dds_c_t

from rosplc.errors import BackendError

__all__ = [
    "ANY_STATE",
    "FOREVER",
    "RETCODE_TIMEOUT",
    "WaitSet",
    "alive_count",
    "deadlines_missed",
    "delete",
    "matched_count",
    "matched_handles",
    "refusal",
    "sample_lost",
    "sample_rejected",
]

ANY_STATE: int = int(SampleState.Any | ViewState.Any | InstanceState.Any)
FOREVER = 2**63 - 1  # DDS_INFINITY
RETCODE_TIMEOUT: int = DDSException.DDS_RETCODE_TIMEOUT

_library: Any = DDS._dll_handle


def _function(name: str, result: Any, *arguments: Any) -> Any:
    function = getattr(_library, name)
    function.restype = result
    function.argtypes = list(arguments)
    return function


# A second handle to the library: argtypes set here must not disturb the wheel's own.
_library = ct.CDLL(_library._name)
_delete = _function("dds_delete", ct.c_int32, ct.c_int32)
_create_waitset = _function("dds_create_waitset", ct.c_int32, ct.c_int32)
_create_guard = _function("dds_create_guardcondition", ct.c_int32, ct.c_int32)
_set_guard = _function("dds_set_guardcondition", ct.c_int32, ct.c_int32, ct.c_bool)
_take_guard = _function("dds_take_guardcondition", ct.c_int32, ct.c_int32, ct.POINTER(ct.c_bool))
_create_readcondition = _function("dds_create_readcondition", ct.c_int32, ct.c_int32, ct.c_uint32)
_attach = _function("dds_waitset_attach", ct.c_int32, ct.c_int32, ct.c_int32, ct.c_ssize_t)
_detach = _function("dds_waitset_detach", ct.c_int32, ct.c_int32, ct.c_int32)
_wait = _function(
    "dds_waitset_wait", ct.c_int32, ct.c_int32, ct.POINTER(ct.c_ssize_t), ct.c_size_t, ct.c_int64
)
_matched_pubs = _function(
    "dds_get_matched_publications", ct.c_int32, ct.c_int32, ct.POINTER(ct.c_uint64), ct.c_size_t
)
_matched_subs = _function(
    "dds_get_matched_subscriptions", ct.c_int32, ct.c_int32, ct.POINTER(ct.c_uint64), ct.c_size_t
)
_lost = _function(
    "dds_get_sample_lost_status", ct.c_int32, ct.c_int32, ct.POINTER(dds_c_t.sample_lost_status)
)
_late_in = _function(
    "dds_get_requested_deadline_missed_status",
    ct.c_int32,
    ct.c_int32,
    ct.POINTER(dds_c_t.requested_deadline_missed_status),
)
_late_out = _function(
    "dds_get_offered_deadline_missed_status",
    ct.c_int32,
    ct.c_int32,
    ct.POINTER(dds_c_t.offered_deadline_missed_status),
)
_alive = _function(
    "dds_get_liveliness_changed_status",
    ct.c_int32,
    ct.c_int32,
    ct.POINTER(dds_c_t.liveliness_changed_status),
)
_rejected = _function(
    "dds_get_sample_rejected_status", ct.c_int32, ct.c_int32, ct.POINTER(dds_c_t.sample_rejected_status)
)


def refusal(doing: str, error: Exception | int, *, remedy: str = "") -> BackendError:
    """Return the ROS002 error for something that the middleware refused."""
    text = DDSException(error).msg if isinstance(error, int) else getattr(error, "msg", None) or str(error)
    return BackendError("ROS002", f"{doing}: {text}", remedy=remedy)


def _checked(code: int, doing: str) -> int:
    if code < 0:
        raise refusal(doing, code)
    return code


def delete(entity: Any) -> None:
    """Delete one of the wheel's entities now, rather than when Python collects it."""
    Entity._entities.pop(entity._ref, None)  # so that its finalizer leaves the handle alone
    _delete(entity._ref)


def matched_handles(ref: int, *, of_reader: bool) -> frozenset[int]:
    """Return the instance handles of the peers that an endpoint has matched."""
    call = _matched_pubs if of_reader else _matched_subs
    room = 16
    while True:
        handles = (ct.c_uint64 * room)()
        found = call(ref, handles, room)
        if found <= 0:
            return frozenset()
        if found <= room:
            return frozenset(handles[:found])
        room = found + 16


def matched_count(ref: int, *, of_reader: bool) -> int:
    """Return how many peers an endpoint has matched."""
    return max(0, int((_matched_pubs if of_reader else _matched_subs)(ref, None, 0)))


def sample_lost(ref: int) -> int:
    """Return how many messages the reader knows to have missed."""
    status = dds_c_t.sample_lost_status()
    return int(status.total_count) if _lost(ref, ct.byref(status)) == 0 else 0


def deadlines_missed(ref: int, *, of_reader: bool) -> int:
    """Return how often an endpoint's deadline passed without a message."""
    if of_reader:
        status = dds_c_t.requested_deadline_missed_status()
        return int(status.total_count) if _late_in(ref, ct.byref(status)) == 0 else 0
    offered = dds_c_t.offered_deadline_missed_status()
    return int(offered.total_count) if _late_out(ref, ct.byref(offered)) == 0 else 0


def alive_count(ref: int) -> int:
    """Return how many of a reader's matched writers have kept to their lease."""
    status = dds_c_t.liveliness_changed_status()
    return int(status.alive_count) if _alive(ref, ct.byref(status)) == 0 else 0


def sample_rejected(ref: int) -> int:
    """Return how many messages the reader had no room for."""
    status = dds_c_t.sample_rejected_status()
    return int(status.total_count) if _rejected(ref, ct.byref(status)) == 0 else 0


class WaitSet:
    """A thread's sleeping place over many readers, which tells *which* of them have data.

    The wheel's own class tells only how many. A read condition is used and not the reader's
    status: a status is cleared by any take, so a take with a limit would leave messages lying.
    """

    def __init__(self, participant: int) -> None:
        self._ref = _checked(_create_waitset(participant), "cannot create a waitset")
        self._guard = _checked(_create_guard(participant), "cannot create a guard condition")
        _checked(_attach(self._ref, self._guard, -1), "cannot attach a guard condition")
        self._room = 64
        self._keys = (ct.c_ssize_t * self._room)()
        self._attached = 1

    def attach(self, reader: int, key: int) -> int:
        """Watch a reader under a key (0 or more); return the condition, for :meth:`detach`."""
        condition = _checked(_create_readcondition(reader, ANY_STATE), "cannot create a read condition")
        _checked(_attach(self._ref, condition, key), "cannot attach a reader")
        self._attached += 1
        return condition

    def detach(self, condition: int) -> None:
        """Stop watching and delete the condition."""
        _detach(self._ref, condition)
        _delete(condition)
        self._attached -= 1

    def wake(self) -> None:
        """Make the present or the next :meth:`wait` return at once."""
        _set_guard(self._guard, True)

    def wait(self, timeout_ns: int) -> list[int]:
        """Sleep until a reader has data, :meth:`wake` is called, or the time is over; return the keys."""
        if self._attached > self._room:
            self._room = 2 * self._attached
            self._keys = (ct.c_ssize_t * self._room)()
        count = _wait(self._ref, self._keys, self._room, timeout_ns)
        if count <= 0:
            return []
        keys: list[int] = self._keys[: min(count, self._room)]
        if -1 in keys:
            _take_guard(self._guard, ct.byref(ct.c_bool()))
            keys.remove(-1)
        return keys

    def close(self) -> None:
        """Delete the waitset; nothing may be waiting any more."""
        _delete(self._ref)
        _delete(self._guard)
