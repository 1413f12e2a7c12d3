"""The bridge's process: what ``rosplc run`` does, ended by the demonstration's pipe.

The configuration comes as a file, so that the demonstration runs the very path that a user
runs.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
from pathlib import Path

from rosplc.bridge.run import run_bridge
from rosplc.demo.processes import remove_objects, report
from rosplc.errors import RosplcError


def _end_with_parent() -> None:
    for line in sys.stdin:
        if line.strip() == "stop":
            break
    os.kill(os.getpid(), signal.SIGTERM)


def main() -> None:
    """Run the bridge for the configuration and prefix given as arguments."""
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})  # Ctrl-C is the parent's
    threading.Thread(target=_end_with_parent, daemon=True).start()
    configuration, prefix = sys.argv[1:3]
    try:
        run_bridge(Path(configuration), status_seconds=None)
    except RosplcError as error:
        report("error", **error.to_dict())
        sys.exit(1)
    finally:
        remove_objects(prefix)


if __name__ == "__main__":
    main()
