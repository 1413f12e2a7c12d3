"""Real-time settings of a bridge: priority and processors of its threads, locked memory, garbage collection.

A thread inherits policy and processors from the thread that starts it. The thread that starts a bridge
therefore applies the settings to itself, starts the backend, the carriers and the heartbeat, and restores
its own settings before it starts the reporter. This also covers threads that a middleware starts itself.
"""

from __future__ import annotations

import ctypes
import errno
import gc
import os
import resource
from pathlib import Path

from rosplc.config.file import Config
from rosplc.errors import SetupError
from rosplc.proc import status_mask

LOWEST_TASK_PRIORITY, HIGHEST_TASK_PRIORITY = 52, 67
"""SCHED_FIFO priorities of CODESYS' IEC tasks on Linux: 15, the lowest, to 0, the highest."""

_MCL_CURRENT, _MCL_FUTURE, _MCL_ONFAULT = 1, 2, 4
_CAP_IPC_LOCK, _STATUS = 14, Path("/proc/thread-self/status")
_FULL_COLLECTION_S = 60


def contention(config: Config) -> list[str]:
    """Return a warning if the bridge's priority is within the range of the PLC's priorities, or above it."""
    wanted = config.settings.realtime
    if wanted.policy != "fifo" or wanted.priority < LOWEST_TASK_PRIORITY:
        return []
    reach = "above" if wanted.priority > HIGHEST_TASK_PRIORITY else "within"
    return [
        f"realtime.priority {wanted.priority} is {reach} the range of CODESYS tasks (SCHED_FIFO "
        f"{LOWEST_TASK_PRIORITY} to {HIGHEST_TASK_PRIORITY} for IEC priorities 15 to 0): the bridge may "
        f"delay the PLC's cycle; use a value below {LOWEST_TASK_PRIORITY}"
    ]


class Realtime:
    """The settings of one configuration, in effect inside the ``with`` block.

    Priority and processors apply to the entering thread until :meth:`rest`, the others to the process.
    """

    def __init__(self, config: Config) -> None:
        self._config = config
        self._wanted = config.settings.realtime
        self._before: tuple[int, os.sched_param, set[int]] | None = None
        self._locked = self._tidies = False
        self._since_full_s = 0

    def __enter__(self) -> Realtime:
        """Apply the settings. Raises SetupError SYS010 with a remedy if the kernel does not allow them."""
        try:
            if self._wanted.lock_memory:
                self._lock_memory()
            self._raise()
        except BaseException:
            self._undo()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self._undo()

    def rest(self) -> None:
        """Restore the calling thread's settings: threads that it starts from now on are ordinary threads."""
        before, self._before = self._before, None
        if before is not None:
            policy, parameters, processors = before
            if os.sched_getscheduler(0) != policy:
                os.sched_setscheduler(0, policy, parameters)
            os.sched_setaffinity(0, processors)

    def settled(self) -> None:
        """Configure the garbage collector after all long-lived objects have been created."""
        if self._wanted.gc == "auto":
            return
        gc.collect()
        gc.freeze()
        if self._wanted.gc == "off":
            gc.disable()
        self._tidies = self._wanted.gc == "off"

    def tidy(self) -> None:
        """Collect young garbage while the automatic collector is off; call this once per second."""
        # What was there at the start is frozen, so the full collection once a minute is short too.
        if not self._tidies:
            return
        self._since_full_s = (self._since_full_s + 1) % _FULL_COLLECTION_S
        gc.collect(0 if self._since_full_s else 2)

    def _undo(self) -> None:
        self.rest()
        if self._locked:
            self._locked = False
            ctypes.CDLL(None).munlockall()
        if self._wanted.gc != "auto":
            self._tidies = False
            gc.unfreeze()
            gc.enable()

    def _raise(self) -> None:
        wanted = self._wanted
        if wanted.policy is None and not wanted.affinity:
            return
        before = os.sched_getscheduler(0), os.sched_getparam(0), os.sched_getaffinity(0)
        self._before = before
        if wanted.affinity:
            self._pin(set(wanted.affinity), before[2])
        if wanted.policy is None:
            return
        try:
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(wanted.priority))
        except PermissionError:
            limit, _ = resource.getrlimit(resource.RLIMIT_RTPRIO)
            raise self._refused(
                "priority",
                f"SCHED_FIFO priority {wanted.priority} is not permitted (the limit is {limit})",
                f"Set LimitRTPRIO={wanted.priority} in the systemd unit (rosplc service install does so), "
                f"add `@plc - rtprio {wanted.priority}` to /etc/security/limits.d, or grant the capability "
                "CAP_SYS_NICE; in a container, use --ulimit rtprio=… or --cap-add SYS_NICE.",
            ) from None

    def _refused(self, key: str, what: str, remedy: str) -> SetupError:
        return SetupError("SYS010", what, where=self._config.source.place(("realtime", key)), remedy=remedy)

    def _pin(self, processors: set[int], here: set[int]) -> None:
        missing = sorted(processors - here)
        try:
            os.sched_setaffinity(0, processors)
            if os.sched_getaffinity(0) == processors:
                return
            what = f"this process is not allowed to use processors {', '.join(map(str, missing))}"
        except (OSError, ValueError, OverflowError) as error:
            what = f"processors {missing or sorted(processors)} cannot be used: {error}"
        remedy = f"Allowed processors: {', '.join(map(str, sorted(here)))}."
        raise self._refused("affinity", what, remedy)

    def _lock_memory(self) -> None:
        limit, _ = resource.getrlimit(resource.RLIMIT_MEMLOCK)
        number = 0
        # Under a limit it would succeed now, and the first thread or buffer beyond it would fail later.
        if limit == resource.RLIM_INFINITY or status_mask(_STATUS, "CapEff") >> _CAP_IPC_LOCK & 1:
            # On fault: each thread's stack is megabytes of which it touches a few pages.
            library = ctypes.CDLL(None, use_errno=True)
            if library.mlockall(_MCL_CURRENT | _MCL_FUTURE | _MCL_ONFAULT):
                number = ctypes.get_errno()
        else:
            number = errno.EPERM
        if number:
            raise self._refused(
                "lock_memory",
                f"memory cannot be locked: {os.strerror(number)} (the limit is {_in_words(limit)})",
                "Set LimitMEMLOCK=infinity in the systemd unit (rosplc service install does so), add "
                "`@plc - memlock unlimited` to /etc/security/limits.d, or grant the capability CAP_IPC_LOCK; "
                "in a container, use --ulimit memlock=-1.",
            )
        self._locked = True


def _in_words(limit: int) -> str:
    return "none" if limit == resource.RLIM_INFINITY else f"{limit // 1024} KiB"
