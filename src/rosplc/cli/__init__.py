"""The rosplc command: one file per verb."""

from __future__ import annotations

import io
import os
import sys
from pathlib import Path

__all__ = ["main"]


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


def main() -> None:
    """Run the ``rosplc`` command with the process's arguments; never returns."""
    prepare_streams()
    try:
        # Imported here so that `import rosplc.cli` stays cheap for tools that only look at it.
        from rosplc.cli.app import app

        app(prog_name="rosplc")
    except KeyboardInterrupt:  # before a verb has begun, which takes over (verb.py)
        raise SystemExit(130) from None
    except (MemoryError, ImportError, OSError) as error:  # a verb reports its own
        from rosplc.cli.verb import is_out_of_memory

        if not is_out_of_memory(error):
            raise
        sys.stderr.write("rosplc: error SYS014: the system is out of memory\n")
        raise SystemExit(1) from None
    except RuntimeError as error:
        # Python before 3.12 wraps it so where it comes while a class is made, as imports do.
        if isinstance(error.__cause__, KeyboardInterrupt):
            raise SystemExit(130) from None
        raise
    finally:
        # An interrupt in an exec, such as that of a dataclass, would have Python end by SIGINT anyway.
        exec("")
