"""What all verbs share: options from a signature and its docstring, and how a verb ends.

A verb is a function: positional-only parameters are arguments of the command line, keyword-only ones are
options, and lines ``name METAVAR: help`` under ``Options:`` in the docstring describe both.
"""

from __future__ import annotations

import errno
import functools
import inspect
import json
import os
import re
import sys
from collections.abc import Callable
from typing import Annotated, Any, NamedTuple

import typer
from typer.models import ParameterInfo

from rosplc.cli.text import finite, warn
from rosplc.errors import ConfigError, RosplcError, SetupError
from rosplc.harmless import harmless

EXIT_FAILURE = 1
EXIT_CONFIG = 2
EXIT_ENDED = 3
"""The ROS side told the bridge to leave (`rosnode kill`, a name that was taken): start it again if wanted."""
EXIT_INTERRUPTED = 130
EXIT_PIPE = 141  # what a shell reports for a program that ended by SIGPIPE, as `rosplc … | head` does

_NO_OUTPUT = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO)
_SPELLED = {"as_json": "json", "everything": "all", "listing": "list"}
_LETTERS = {
    word: letter
    for letter, words in {
        "1": "once", "a": "all", "c": "count-topics", "f": "follow full-length", "n": "count",
        "o": "out output", "q": "quiet", "t": "show-types times topic trigger", "v": "verbose",
        "w": "wait-matching-subscriptions window", "x": "exclude", "y": "yes",
    }.items()
    for word in words.split()
}  # fmt: skip
_DESCRIBED = re.compile(r"^ {4}(\w+)(?: (\S+?))?: (.*(?:\n {5,}.*)*)", re.MULTILINE)


class Between(NamedTuple):
    """The least and the largest value of a number, in its annotation."""

    least: float
    most: float | None = None


def verb(function: Callable[..., None]) -> Callable[..., None]:
    """Make a function a verb for typer.

    Errors become messages on stderr (JSON with ``--json``) and exit statuses: 2 for a wrong configuration or
    command line, 3 for a node that was told to leave the ROS graph, 1 for every other failure, 130 for
    Ctrl-C, 141 for a reader of our output that went away.
    """
    about, _, listed = (inspect.getdoc(function) or "").partition("\n\nOptions:\n")
    described = {
        name: (metavar, " ".join(text.split())) for name, metavar, text in _DESCRIBED.findall(listed)
    }
    signature = inspect.signature(function, eval_str=True)
    parameters = [_parameter(each, described) for each in signature.parameters.values()]
    positional = [each.name for each in parameters if each.kind is each.POSITIONAL_ONLY]

    @functools.wraps(function)
    def run(**given: Any) -> None:
        as_json = bool(given.get("as_json", False))
        try:
            function(*[given.pop(name) for name in positional], **given)
            sys.stdout.flush()
        except KeyboardInterrupt:
            raise typer.Exit(EXIT_INTERRUPTED) from None
        except BrokenPipeError:
            _leave_stdout()
            raise typer.Exit(EXIT_PIPE) from None
        except (typer.Exit, typer.Abort, typer.BadParameter):
            raise
        except Exception as error:
            raise typer.Exit(_report(error, as_json=as_json)) from None

    run.__doc__ = about
    run.__signature__ = signature.replace(parameters=parameters)  # type: ignore[attr-defined]
    return run


def _parameter(parameter: inspect.Parameter, described: dict[str, tuple[str, str]]) -> inspect.Parameter:
    """Return a parameter of a verb with what typer has to know of it."""
    kind, ranges = parameter.annotation, {}
    if more := getattr(kind, "__metadata__", ()):
        if isinstance(more[0], ParameterInfo):
            return parameter
        kind, ranges = kind.__origin__, {"min": more[0].least, "max": more[0].most}
    if kind is typer.Context:
        return parameter
    metavar, text = described.get(parameter.name, ("", "Print JSON." if parameter.name == "as_json" else ""))
    facts: dict[str, Any] = {"metavar": metavar or None, "help": text or None, **ranges}
    if parameter.kind is parameter.POSITIONAL_ONLY:
        return parameter.replace(annotation=Annotated[kind, typer.Argument(**facts)])
    word = _SPELLED.get(parameter.name, parameter.name).replace("_", "-")
    names = [f"--{word}/--no-{word}" if parameter.default is True else f"--{word}"]
    names += [f"-{_LETTERS[word]}"] if word in _LETTERS else []
    return parameter.replace(annotation=Annotated[kind, typer.Option(*names, **facts)])


def is_out_of_memory(error: BaseException) -> bool:
    """Return whether an error means that memory is short: for data, a library or a thread's stack."""
    words = ("failed to map segment", "annot allocate memory", "can't start new thread")
    return isinstance(error, MemoryError) or any(each in str(error) for each in words)


def _leave_stdout() -> None:
    # The interpreter flushes stdout once more at exit; give it somewhere to go.
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _known(error: Exception) -> RosplcError | None:
    """Return an error as one of ours; None for a defect."""
    if isinstance(error, RosplcError):
        return error
    if is_out_of_memory(error):
        return SetupError("SYS014", "the system is out of memory")
    if isinstance(error, OSError) and error.errno in (errno.EMFILE, errno.ENFILE):
        return SetupError("SYS006", "too many files are open", where=str(error.filename or ""))
    if isinstance(error, OSError) and error.errno in _NO_OUTPUT and error.filename is None:
        _leave_stdout()
        return SetupError("SYS005", f"cannot write the output: {error.strerror}", where="stdout")
    return None


def _report(failure: Exception, *, as_json: bool) -> int:
    """Print an error; return the exit status."""
    error = _known(failure)
    if error is None:
        if os.environ.get("ROSPLC_DEBUG"):
            raise failure
        what = f"{type(failure).__name__}: {failure}"
        remedy = "This is a bug in rosplc. Set ROSPLC_DEBUG=1 to get a traceback, and report the bug."
        text = f"rosplc: unexpected error: {harmless(what)}\n  remedy: {remedy}\n"
        document = {"error": {"code": "", "what": what, "where": "", "remedy": ""}}
        sys.stderr.write(json.dumps(document) + "\n" if as_json else text)
        return EXIT_FAILURE
    # A configuration may have several mistakes; they are shown together.
    errors: tuple[RosplcError, ...] = getattr(error, "errors", (error,))
    for each in {error, *errors}:
        if "pip install" in each.remedy:
            from rosplc.doctor.machine import pip_here

            each.remedy = pip_here(each.remedy)
    if as_json:
        several = {"errors": [each.to_dict() for each in errors]} if len(errors) > 1 else {}
        sys.stderr.write(json.dumps(finite({"error": error.to_dict(), **several})) + "\n")
    else:
        warn("\n".join(map(_in_words, errors)))
    if error.code == "ROS015":
        return EXIT_ENDED
    return EXIT_CONFIG if isinstance(error, ConfigError) else EXIT_FAILURE


def _in_words(error: RosplcError) -> str:
    where = f"\n  where:  {error.where}" if error.where else ""
    return f"rosplc: error {error.code}: {error.what}{where}\n  remedy: {error.remedy}"
