"""``rosplc top``: every channel of every bridge on this machine, live in the terminal.

rosplc top  —  every channel on this machine; Enter shows the message with live values, ? shows help

rosplc top --config cell.yaml  —  apply the settings of a configuration, and include its classic topics

rosplc top --interval 2  —  update every two seconds, over a slow connection

It requires only read access (no configuration, no ROS), affects no other program, and works over ssh. It
needs 60 columns and 20 rows. To install: `pip install 'rosplc[views]'`. In scripts, use `rosplc status`.
"""

from __future__ import annotations

import os
import signal
import sys
from typing import Annotated

import typer

from rosplc.cli.options import Configs, Directory, Prefix, StaleAfter, need_extra, open_watch
from rosplc.cli.verb import Between, verb
from rosplc.errors import SetupError


@verb
def command(
    *,
    prefix: Prefix = None,
    config: Configs = None,
    stale_after: StaleAfter = "1s",
    interval: Annotated[float, Between(0.1, 60.0)] = 0.5,
    directory: Directory = "/dev/shm",
) -> None:
    """Watch all channels on this machine in the terminal: rates, ages, losses, values, connected programs.

    Options:
        interval SECONDS: Time between two updates.
    """
    need_extra("textual", "views", "top")
    _check_terminal()
    with open_watch(prefix, config, stale_after, directory) as watch:
        watch.look()  # what cannot be looked at is said before the terminal is taken
        from rosplc.monitor.terminal import TopApp

        app = TopApp(watch, interval)
        before = signal.signal(signal.SIGTERM, lambda *_: app.exit())
        try:
            app.run()
        finally:
            signal.signal(signal.SIGTERM, before)
        if app.return_code:
            raise typer.Exit(app.return_code)


def _check_terminal() -> None:
    # The picture is drawn on stderr, as textual does.
    for name in ("stdin", "stdout", "stderr"):
        if not getattr(sys, name).isatty():
            raise SetupError("SYS012", f"{name} is not a terminal")
    if os.environ.get("TERM", "") in ("", "dumb", "unknown"):
        what = f"the terminal cannot move the cursor (TERM={os.environ.get('TERM', '')})"
        raise SetupError("SYS012", what)
