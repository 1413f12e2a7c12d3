"""How every verb ends: one clear message instead of a traceback, and an exit status."""

from __future__ import annotations

import errno
import functools
import json
import os
import sys
from collections.abc import Callable
from typing import Any, NoReturn, ParamSpec

import typer

from rosplc.cli.text import warn
from rosplc.errors import ConfigError, RosplcError, SetupError
from rosplc.harmless import harmless

__all__ = [
    "EXIT_CONFIG",
    "EXIT_ENDED",
    "EXIT_FAILURE",
    "EXIT_INTERRUPTED",
    "EXIT_PIPE",
    "finite",
    "guarded",
    "is_out_of_memory",
    "print_json",
]

EXIT_FAILURE = 1
EXIT_CONFIG = 2
EXIT_ENDED = 3
"""The ROS side told the bridge to leave (`rosnode kill`, a name that was taken): start it again if wanted."""
EXIT_INTERRUPTED = 130
EXIT_PIPE = 141
"""What a shell reports for a program that ended by SIGPIPE, as `rosplc … | head` does."""

_NO_OUTPUT = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO)

P = ParamSpec("P")


def guarded(verb: Callable[P, None]) -> Callable[P, None]:
    """Wrap a verb: errors become messages on stderr (JSON with ``--json``) and statuses.

    Status 2 stands for a configuration or a command line that is wrong, 3 for a node that was told to
    leave the ROS graph, 1 for every other failure, 130 for Ctrl-C, 141 for a reader of our output that
    went away.
    """

    @functools.wraps(verb)
    def run(*args: P.args, **kwargs: P.kwargs) -> None:
        as_json = bool(kwargs.get("as_json", False))
        try:
            verb(*args, **kwargs)
            sys.stdout.flush()
        except RosplcError as error:
            _report(error, as_json=as_json)
        except KeyboardInterrupt:
            raise typer.Exit(EXIT_INTERRUPTED) from None
        except BrokenPipeError:
            _leave_stdout()
            raise typer.Exit(EXIT_PIPE) from None
        except (typer.Exit, typer.Abort, typer.BadParameter):
            raise
        except OSError as error:
            if is_out_of_memory(error):
                _report(SetupError("SYS014", "the system gave no more memory"), as_json=as_json)
            if error.errno in (errno.EMFILE, errno.ENFILE):
                _report(SetupError("SYS006", "too many files are open", where=_name(error)), as_json=as_json)
            if error.errno not in _NO_OUTPUT or error.filename is not None:
                _unexpected(error, as_json=as_json)
            _leave_stdout()
            what = f"cannot write the output: {error.strerror}"
            _report(SetupError("SYS005", what, where="stdout"), as_json=as_json)
        except Exception as error:
            if is_out_of_memory(error):
                _report(SetupError("SYS014", "the system gave no more memory"), as_json=as_json)
            _unexpected(error, as_json=as_json)

    return run


def is_out_of_memory(error: BaseException) -> bool:
    """Return whether an error means that memory is short: for data, a library or a thread's stack."""
    text = str(error)
    return isinstance(error, MemoryError) or any(
        words in text
        for words in ("failed to map segment", "annot allocate memory", "can't start new thread")
    )


def _name(error: OSError) -> str:
    return "" if error.filename is None else str(error.filename)


def _leave_stdout() -> None:
    # The interpreter flushes stdout once more at exit; give it somewhere to go.
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def print_json(value: Any) -> None:
    """Print ``value`` as one JSON document on stdout; NaN and infinity become strings.

    It is ASCII: text out of shared memory may hold what a terminal would act upon, or bytes
    that are no UTF-8.
    """
    sys.stdout.write(json.dumps(finite(value), indent=2) + "\n")


def finite(value: Any) -> Any:
    """Return ``value`` as JSON can hold it: JSON has no NaN, and jq would refuse the document."""
    if isinstance(value, float) and (value != value or value in (float("inf"), float("-inf"))):
        return str(value)
    if isinstance(value, dict):
        return {key: finite(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [finite(item) for item in value]
    if isinstance(value, (bytes, bytearray)):
        return list(value)
    return value


def _report(error: RosplcError, *, as_json: bool) -> NoReturn:
    # A configuration may have several mistakes; they are shown together.
    errors: tuple[RosplcError, ...] = getattr(error, "errors", (error,))
    if as_json:
        document: dict[str, Any] = {"error": error.to_dict()}
        if len(errors) > 1:
            document["errors"] = [each.to_dict() for each in errors]
        sys.stderr.write(json.dumps(document) + "\n")
    else:
        warn("\n".join(_in_words(each) for each in errors))
    status = EXIT_CONFIG if isinstance(error, ConfigError) else EXIT_FAILURE
    raise typer.Exit(EXIT_ENDED if error.code == "ROS015" else status) from None


def _in_words(error: RosplcError) -> str:
    from rosplc.doctor.packages import pip_here

    lines = [f"rosplc: error {error.code}: {error.what}"]
    if error.where:
        lines.append(f"  where:  {error.where}")
    remedy = pip_here(error.remedy) if "pip install" in error.remedy else error.remedy
    lines.append(f"  remedy: {remedy}")
    return "\n".join(lines)


def _unexpected(error: Exception, *, as_json: bool) -> NoReturn:
    if os.environ.get("ROSPLC_DEBUG"):
        raise error
    what = f"{type(error).__name__}: {error}"
    if as_json:
        sys.stderr.write(json.dumps({"error": {"code": "", "what": what, "where": "", "remedy": ""}}) + "\n")
    else:
        sys.stderr.write(
            f"rosplc: unexpected error: {harmless(what)}\n"
            "  remedy: This is a defect of rosplc. Set ROSPLC_DEBUG=1 for the traceback and report it.\n"
        )
    raise typer.Exit(EXIT_FAILURE) from None
