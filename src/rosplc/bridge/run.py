"""A bridge as a program: runs until it is told to stop."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

from rosplc.bridge.engine import Bridge
from rosplc.bridge.topic import log

__all__ = ["run_until_signal", "stop_on_signals"]

_SAME_SIGNAL_S = 0.2


@contextmanager
def stop_on_signals() -> Iterator[threading.Event]:
    """Give an event that SIGTERM and SIGINT set; for the main thread.

    A second one ends the process at once, unless it follows within a fifth of a second: timeout(1)
    and launch tools send each signal to the process and to its group. SIGHUP is logged and otherwise
    ignored. A signal that the parent process ignores (nohup) stays ignored.
    """
    event = threading.Event()

    def leave(_number: int, _frame: FrameType | None) -> None:
        if event.is_set():
            return
        event.set()
        time.sleep(_SAME_SIGNAL_S)  # the other threads carry on; a repetition comes in here
        for number in (signal.SIGTERM, signal.SIGINT):
            if number in before:
                signal.signal(number, signal.SIG_DFL)

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
