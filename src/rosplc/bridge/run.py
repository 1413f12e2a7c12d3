"""A bridge as a program: runs until it is told to stop."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

from rosplc.bridge.engine import Bridge
from rosplc.bridge.topic import log

__all__ = ["run_until_signal", "stop_on_signals"]


@contextmanager
def stop_on_signals() -> Iterator[threading.Event]:
    """Give an event that SIGTERM and SIGINT set; for the main thread.

    A second signal of the same kind ends the process at once. SIGHUP is logged and otherwise
    ignored. A signal that the parent process ignores (nohup) stays ignored.
    """
    event = threading.Event()

    def leave(number: int, _frame: FrameType | None) -> None:
        signal.signal(number, signal.SIG_DFL)
        event.set()

    def ignore(_number: int, _frame: FrameType | None) -> None:
        log.warning("SIGHUP is ignored; restart the bridge to apply a changed configuration")

    wanted = {signal.SIGTERM: leave, signal.SIGINT: leave, signal.SIGHUP: ignore}
    before = {
        number: signal.signal(number, handler)
        for number, handler in wanted.items()
        if signal.getsignal(number) is not signal.SIG_IGN
    }
    try:
        yield event
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def run_until_signal(bridge: Bridge) -> None:
    """Run a bridge until a signal comes (:func:`stop_on_signals`).

    Raises:
        RosplcError: As :meth:`Bridge.start`.
    """
    with stop_on_signals() as stop:
        bridge.run(stop)
