"""Cyclone DDS's own warnings, and what they tell about bad bytes.

A message whose bytes do not fit its type is dropped inside the C library; the only trace is a warning. The
library's trace goes into a file in memory, which costs no more than a write and can neither block it nor need
the GIL, as a callback would. The same warnings are on stderr, as with every program on Cyclone DDS.
"""

from __future__ import annotations

import contextlib
import ctypes as ct
import os
import re
import threading
from collections import Counter

_DROPPED = re.compile(rb"deserialization (\S+)/\S+ failed")
_PUNCH_HOLE = 0x02 | 0x01  # FALLOC_FL_PUNCH_HOLE | FALLOC_FL_KEEP_SIZE
_PAGE = 4096


class LibraryLog:
    """The reading side of the library's trace output, which it writes to ``path``; one per process."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._file = os.memfd_create("rosplc-dds-log", os.MFD_CLOEXEC)
        self.path = f"/proc/self/fd/{self._file}"
        self._read = 0
        self._freed = 0
        self._rest = b""
        self._dropped: Counter[str] = Counter()
        self._fallocate = ct.CDLL(None).fallocate
        self._fallocate.argtypes = [ct.c_int, ct.c_int, ct.c_int64, ct.c_int64]

    def drain(self) -> None:
        """Read what was written since, and give its memory back."""
        with self._lock:
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
        """Return how many messages on a DDS topic did not fit their type, up to the last drain."""
        with self._lock:
            return self._dropped[topic]


_instance: LibraryLog | None = None
_instance_lock = threading.Lock()


def library_log() -> LibraryLog:
    """Return the process's one :class:`LibraryLog`."""
    global _instance
    with _instance_lock:
        if _instance is None:
            _instance = LibraryLog()
        return _instance


# The part of the library's configuration that leads its warnings to a path.
TRACING = (
    "<Tracing><Verbosity>warning</Verbosity><AppendToFile>true</AppendToFile>"
    "<OutputFile>{}</OutputFile></Tracing>"
)
