"""Calls in a process of their own: what they alone need, above all pydantic, is gone when they return."""

from __future__ import annotations

import base64
import logging
import os
import pickle
import sys
import threading
from collections.abc import Callable
from typing import Any, NoReturn, TypeVar

from rosplc.errors import RosplcError
from rosplc.harmless import log_to_stderr

_PROGRAM = "from rosplc.config.apart import main; main()"
_T = TypeVar("_T")


def apart(function: Callable[..., _T], *arguments: object) -> _T:
    """Return what a function returns, or raise the error that it raises; RuntimeError if it did neither.

    Function, arguments, result and errors have to be picklable.
    """
    reading, writing = os.pipe()
    if threading.active_count() > 1:  # a fork would copy locks that the other threads hold
        os.set_inheritable(writing, True)
        asked = pickle.dumps((writing, logging.getLogger().getEffectiveLevel(), function, arguments))
        command = [sys.executable, "-c", _PROGRAM, base64.b64encode(asked).decode()]
        pid = os.posix_spawn(sys.executable, command, os.environ)
    elif (pid := os.fork()) == 0:
        _answer(writing, function, arguments)
    os.close(writing)
    with os.fdopen(reading, "rb") as answer:
        data = answer.read()
    _, status = os.waitpid(pid, 0)
    if not data:
        code = os.waitstatus_to_exitcode(status)
        raise RuntimeError(f"the process running {function.__name__} ended with status {code}")
    result, error = pickle.loads(data)
    if error is not None:
        raise error
    return result  # type: ignore[no-any-return]


def _answer(writing: int, function: Callable[..., Any], arguments: tuple[object, ...]) -> NoReturn:
    """Carry out a call, write how it went, and end."""
    status = 1
    found: tuple[Any, Exception | None]
    try:
        try:
            found = function(*arguments), None
        except (RosplcError, MemoryError, OSError, ImportError) as error:
            found = None, error
        data = pickle.dumps(found)
        with os.fdopen(writing, "wb") as answer:
            answer.write(data)
        status = 0
    except Exception:
        logging.getLogger("rosplc.config").exception("%s", function.__name__)
    finally:
        os._exit(status)  # neither what the caller has to do at its end, nor threads of a middleware


def main() -> None:
    """Carry out the call of the command line."""
    writing, level, function, arguments = pickle.loads(base64.b64decode(sys.argv[1]))
    log_to_stderr(level)
    _answer(writing, function, arguments)
