"""``rosplc top``: every channel of every bridge on this machine, live in the terminal.

rosplc top  —  every channel of this machine; Enter shows the message with live values, ? explains

rosplc top --config cell.yaml  —  judged by the configuration, with its classic topics

rosplc top --interval 2  —  update every two seconds, over a slow connection

It needs no configuration and no ROS, only read access, and affects no other program. It works over ssh.
It needs 60 columns and 20 rows, and `pip install 'rosplc[views]'`. For scripts, use `rosplc status`.
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
    """Watch every channel of this machine in the terminal: rates, ages, losses, live peers, values.

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
        what = f"the terminal can only print lines (TERM={os.environ.get('TERM', '')})"
        raise SetupError("SYS012", what)
