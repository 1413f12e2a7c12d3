"""A bridge as a program: runs until it is told to stop."""

from __future__ import annotations

import signal
import threading
from types import FrameType

from rosplc.bridge.engine import Bridge
from rosplc.bridge.topic import log

__all__ = ["run_until_signal"]


def run_until_signal(bridge: Bridge, *, stop: threading.Event | None = None) -> None:
    """Run a bridge until SIGTERM or SIGINT arrives or ``stop`` is set; call it in the main thread.

    A second signal of the same kind ends the process at once. SIGHUP, which a closing
    terminal sends, is logged and otherwise ignored.

    Raises:
        RosplcError: As :meth:`Bridge.start`.
    """
    event = stop or threading.Event()

    def leave(number: int, _frame: FrameType | None) -> None:
        signal.signal(number, signal.SIG_DFL)
        event.set()

    def ignore(_number: int, _frame: FrameType | None) -> None:
        log.warning("SIGHUP is ignored; restart the bridge to apply a changed configuration")

    handlers = {signal.SIGTERM: leave, signal.SIGINT: leave, signal.SIGHUP: ignore}
    before = {number: signal.signal(number, handler) for number, handler in handlers.items()}
    try:
        bridge.run(event)
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
