"""The rosplc command: one file per verb."""

from __future__ import annotations

import sys

__all__ = ["main"]


def main() -> None:
    """Run the ``rosplc`` command with the process's arguments; never returns."""
    # Imported here so that `import rosplc.cli` stays cheap for tools that only look at it.
    from rosplc.cli.streams import prepare_streams

    prepare_streams()
    try:
        from rosplc.cli.app import app

        app(prog_name="rosplc")
    except KeyboardInterrupt:  # before a verb has begun, which takes over (verb.py)
        raise SystemExit(130) from None
    except (MemoryError, ImportError, OSError) as error:  # a verb reports its own
        from rosplc.cli.verb import is_out_of_memory

        if not is_out_of_memory(error):
            raise
        sys.stderr.write("rosplc: error SYS014: the system gave no more memory\n")
        raise SystemExit(1) from None
    except RuntimeError as error:
        # Python before 3.12 wraps it so where it comes while a class is made, as imports do.
        if isinstance(error.__cause__, KeyboardInterrupt):
            raise SystemExit(130) from None
        raise
