"""Standard streams that can be relied upon, however the command was started."""

from __future__ import annotations

import io
import os
import sys
from pathlib import Path


def prepare_streams() -> None:
    """Give closed standard streams a place to go, and make every character printable.

    A closed descriptor 2 would be given to the next file that is opened, and what the DDS library
    logs would land in it; with ``rosplc run … 2>&-`` that could be an object in shared memory.
    """
    for number in (0, 1, 2):
        try:
            os.fstat(number)
        except OSError:
            os.dup2(os.open(os.devnull, os.O_RDWR), number)
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:
            setattr(sys, name, Path(os.devnull).open("w", encoding="utf-8"))  # noqa: SIM115 - it stays open
        elif isinstance(stream, io.TextIOWrapper):
            # A terminal in Latin-1 or ASCII cannot show an arrow; that is no reason to show nothing.
            stream.reconfigure(errors="backslashreplace")
