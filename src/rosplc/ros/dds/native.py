"""The few functions of Cyclone DDS's C library that the ``cyclonedds`` wheel does not provide.

Calls through here release the GIL; the wheel's own ``ddspy_*`` functions do not. Entities
are plain integers in this module. Nothing else in rosplc touches ctypes for DDS.
"""

from __future__ import annotations

import contextlib
import ctypes as ct
import os
import re
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterable
from typing import Any

from cyclonedds.core import DDSException, DDSStatus, Entity, InstanceState, SampleState, ViewState
from cyclonedds.internal import DDS, dds_c_t

from rosplc.errors import BackendError
from rosplc.ros.dds._batch import Inlet

ANY_STATE: int = int(SampleState.Any | ViewState.Any | InstanceState.Any)
RETCODE_TIMEOUT: int = DDSException.DDS_RETCODE_TIMEOUT

# A second handle to the library: argument types set here must not disturb the wheel's own.
library = ct.CDLL(DDS._dll_handle._name)


def function(name: str, *arguments: Any, result: Any = ct.c_int32) -> Any:
    """Return a function of the library."""
    found = getattr(library, name)
    found.restype, found.argtypes = result, list(arguments)
    return found


def _status(name: str, value: str = "total_count") -> Callable[[int], int]:
    """Return a function that reads one number of an endpoint's status; 0 if there is no such status."""
    kind = getattr(dds_c_t, f"{name}_status")
    get = function(f"dds_get_{name}_status", ct.c_int32, ct.POINTER(kind))

    def read(ref: int) -> int:
        status = kind()
        return int(getattr(status, value)) if get(ref, ct.byref(status)) == 0 else 0

    return read


sample_lost = _status("sample_lost")  # How many messages a reader knows to have missed.
sample_rejected = _status("sample_rejected")  # How many messages a reader had no room for.
# How often a reader's deadline passed without a message.
requested_deadline_missed = _status("requested_deadline_missed")
# How often a writer's deadline passed without a message.
offered_deadline_missed = _status("offered_deadline_missed")
# How many of a reader's matched writers have kept to their lease.
alive_count = _status("liveliness_changed", "alive_count")

# What the numbers above and the matched peers change with.
CHANGES = {
    "in": DDSStatus.SampleLost | DDSStatus.SampleRejected | DDSStatus.RequestedDeadlineMissed
    | DDSStatus.LivelinessChanged | DDSStatus.SubscriptionMatched,
    "out": DDSStatus.OfferedDeadlineMissed | DDSStatus.PublicationMatched,
}  # fmt: skip
_instance_handle = function("dds_get_instance_handle", ct.c_int32, ct.POINTER(ct.c_uint64))
_delete = function("dds_delete", ct.c_int32)
_create_waitset = function("dds_create_waitset", ct.c_int32)
_create_guard = function("dds_create_guardcondition", ct.c_int32)
_set_guard = function("dds_set_guardcondition", ct.c_int32, ct.c_bool)
_take_guard = function("dds_take_guardcondition", ct.c_int32, ct.POINTER(ct.c_bool))
_create_readcondition = function("dds_create_readcondition", ct.c_int32, ct.c_uint32)
_attach = function("dds_waitset_attach", ct.c_int32, ct.c_int32, ct.c_ssize_t)
_detach = function("dds_waitset_detach", ct.c_int32, ct.c_int32)
_wait = function("dds_waitset_wait", ct.c_int32, ct.POINTER(ct.c_ssize_t), ct.c_size_t, ct.c_int64)
_MATCHED = {
    way: function(f"dds_get_matched_{peers}", ct.c_int32, ct.POINTER(ct.c_uint64), ct.c_size_t)
    for way, peers in (("in", "publications"), ("out", "subscriptions"))
}


def refusal(doing: str, error: Exception | int, *, remedy: str = "") -> BackendError:
    """Return the ROS002 error for a refusal by the middleware."""
    text = DDSException(error).msg if isinstance(error, int) else getattr(error, "msg", None) or str(error)
    return BackendError("ROS002", f"{doing}: {text}", remedy=remedy)


def _checked(code: int, doing: str) -> int:
    if code < 0:
        raise refusal(doing, code)
    return code


def delete(entity: Any) -> None:
    """Delete one of the wheel's entities now, not when Python collects it."""
    Entity._entities.pop(entity._ref, None)  # so that its finalizer leaves the handle alone
    _delete(entity._ref)


def instance_handle(ref: int) -> int:
    """Return the handle by which this process lists one of its own endpoints."""
    handle = ct.c_uint64()
    _checked(_instance_handle(ref, ct.byref(handle)), "cannot inspect an endpoint")
    return int(handle.value)


def matched_handles(ref: int, direction: str) -> frozenset[int]:
    """Return the instance handles of the peers that an endpoint (``in`` or ``out``) has matched."""
    room = 16
    while True:
        handles = (ct.c_uint64 * room)()
        found = _MATCHED[direction](ref, handles, room)
        if found <= room:
            return frozenset(handles[: max(0, found)])
        room = found + 16


def matched_count(ref: int, direction: str) -> int:
    """Return the number of peers that an endpoint has matched."""
    return max(0, int(_MATCHED[direction](ref, None, 0)))


class WaitSet:
    """Lets a thread wait for many readers, and shows *which* of them have data.

    The wheel's own class shows only how many. A read condition is used instead of the reader's
    status: any take clears the status, so a take with a limit would leave messages unread.
    """

    def __init__(self, participant: int, inlet: Inlet | None = None) -> None:
        self._inlet = inlet
        self.ref = _checked(_create_waitset(participant), "cannot create a waitset")
        self._guard = _checked(_create_guard(participant), "cannot create a guard condition")
        _checked(_attach(self.ref, self._guard, -1), "cannot attach a guard condition")
        self._room = 64
        self._keys = (ct.c_ssize_t * self._room)()
        self._attached = 1

    def attach(self, reader: int, key: int) -> int:
        """Watch a reader under a key (0 or more); return the condition, for :meth:`detach`."""
        condition = _checked(_create_readcondition(reader, ANY_STATE), "cannot create a read condition")
        _checked(_attach(self.ref, condition, key), "cannot attach a reader")
        self._attached += 1
        return condition

    def detach(self, condition: int) -> None:
        """Stop watching and delete the condition."""
        _detach(self.ref, condition)
        _delete(condition)
        self._attached -= 1

    def wake(self) -> None:
        """Make the current or next :meth:`wait` return immediately."""
        _set_guard(self._guard, True)

    def wait(self, timeout_ns: int) -> tuple[list[int], Iterable[tuple[int, bytes, int]]]:
        """Sleep until a reader has data, :meth:`wake` is called, or the time is over.

        Return the keys of the ready readers, and the messages that no sink took: key, payload, stamp.
        """
        keys: list[int] = []
        left: Iterable[tuple[int, bytes, int]] = ()
        if self._inlet is not None:
            keys, left = self._inlet.wait(self.ref, self._attached, timeout_ns)
        else:
            if self._attached > self._room:
                self._room = 2 * self._attached
                self._keys = (ct.c_ssize_t * self._room)()
            if (count := _wait(self.ref, self._keys, self._room, timeout_ns)) > 0:
                keys = self._keys[: min(count, self._room)]
        if -1 in keys:
            _take_guard(self._guard, ct.byref(ct.c_bool()))
            keys.remove(-1)
        return keys, left

    def close(self) -> None:
        """Delete the waitset; no thread may be waiting."""
        _delete(self.ref)
        _delete(self._guard)


_DROPPED = re.compile(rb"deserialization (\S+)/\S+ failed")
_PUNCH_HOLE = 0x02 | 0x01  # FALLOC_FL_PUNCH_HOLE | FALLOC_FL_KEEP_SIZE
_PAGE = 4096


class LibraryLog:
    """Reads the library's trace output, which the library writes to ``path``.

    A message whose bytes do not fit its type is dropped inside the C library; the only trace is a warning.
    Writing to a file in memory is cheap; unlike a callback, it cannot block the library and does not need the
    GIL. The same warnings appear on stderr, as in every program on Cyclone DDS.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._file = os.memfd_create("rosplc-dds-log", os.MFD_CLOEXEC)
        self.path = f"/proc/self/fd/{self._file}"
        self._read = 0
        self._freed = self._drained_ns = 0
        self._rest = b""
        self._dropped: Counter[str] = Counter()
        self._fallocate = ct.CDLL(None).fallocate
        self._fallocate.argtypes = [ct.c_int, ct.c_int, ct.c_int64, ct.c_int64]

    def drain(self, within_ns: int = 0) -> None:
        """Read new output and free its memory, unless this was done within ``within_ns``."""
        if (now := time.monotonic_ns()) - self._drained_ns < within_ns:
            return
        with self._lock:
            self._drained_ns = now
            while chunk := os.pread(self._file, 1 << 16, self._read):
                self._read += len(chunk)
                *lines, self._rest = (self._rest + chunk).split(b"\n")
                for line in lines:
                    if found := _DROPPED.search(line):
                        self._dropped[found.group(1).decode(errors="replace")] += 1
            if (whole := self._read & -_PAGE) > self._freed:
                # A hole and not a truncation: the library may be appending at this moment.
                with contextlib.suppress(OSError):
                    self._fallocate(self._file, _PUNCH_HOLE, self._freed, whole - self._freed)
                self._freed = whole

    def dropped(self, topic: str) -> int:
        """Return the number of messages on a DDS topic that did not fit their type, up to the last drain."""
        return self._dropped[topic]


library_log = LibraryLog()  # the one of the process


# The part of the library's configuration that leads its warnings to a path.
TRACING = (
    "<Tracing><Verbosity>warning</Verbosity><AppendToFile>true</AppendToFile>"
    "<OutputFile>{}</OutputFile></Tracing>"
)
