"""Orders and answers of the Python processes of a comparison: one JSON object per line each."""

from __future__ import annotations

import asyncio
import json
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Mapping
from typing import Any

from rosplc.bench.orphan import die_with_parent
from rosplc.bench.process import Side

__all__ = ["WATCHDOG_S", "ask", "in_background", "orders", "python", "say"]

WATCHDOG_S = 60.0


def say(**facts: Any) -> None:
    """Answer whoever started this process."""
    sys.stdout.write(json.dumps(facts) + "\n")
    sys.stdout.flush()


def orders() -> Iterator[dict[str, Any]]:
    """Yield the orders that come in, until there is nobody left to give any."""
    die_with_parent()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    for line in sys.stdin:
        yield json.loads(line)


def in_background(
    serve: Callable[[Callable[[], None]], Any], seconds: float = WATCHDOG_S
) -> threading.Thread:
    """Run an event loop in a thread of its own; return that when ``serve`` says that it is ready.

    Args:
        serve: Called with what it calls when it is ready.
        seconds: How long that may take.
    """
    ready = threading.Event()
    failed: list[BaseException] = []

    def run() -> None:
        try:
            asyncio.run(serve(ready.set))
        except BaseException as error:
            failed.append(error)
            ready.set()

    thread = threading.Thread(target=run, name="loop", daemon=True)
    thread.start()
    if not ready.wait(seconds):
        raise TimeoutError("the event loop does not become ready")
    if failed:
        raise failed[0]
    return thread


def ask(side: Side, **order: Any) -> Any:
    """Give an order and return the answer.

    Raises:
        SetupError: SYS002, the process has ended or does not answer.
    """
    side.order(json.dumps(order))
    return side.hear_json(WATCHDOG_S)


def python(module: str, *arguments: str, without: tuple[str, ...] = (), **variables: str) -> list[str]:
    """Return the command line of one of this package's modules, in an environment that differs so."""
    # No module of the folder in which the user happens to stand takes a library's place (from 3.11 on).
    changed: Mapping[str, str] = {"PYTHONSAFEPATH": "1", **variables}
    unset = [word for name in without for word in ("-u", name)]
    settings = [f"{name}={value}" for name, value in changed.items()]
    return ["env", *unset, *settings, sys.executable, "-m", f"rosplc.bench.{module}", *arguments]
