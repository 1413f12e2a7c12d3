"""``python -m tests.soak.stepped MODULE ARGUMENTS``: run a module under libfaketime.

Python's ``time.sleep`` waits until an absolute time of the monotonic clock. libfaketime moves that time even
where it is told to leave that clock alone, and the call fails with EINVAL, or sleeps for a year.
"""

from __future__ import annotations

import runpy
import select
import sys
import time
from typing import SupportsIndex


def _sleep(seconds: float | SupportsIndex) -> None:
    select.select([], [], [], max(0.0, float(seconds)))


if __name__ == "__main__":
    time.sleep = _sleep
    del sys.argv[0]
    runpy.run_module(sys.argv[0], run_name="__main__", alter_sys=True)
