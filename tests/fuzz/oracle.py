"""What may come out of a Python entry point for hostile input: a result, or one of rosplc's errors."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager

from rosplc.errors import CODES, LONGEST_TEXT, RosplcError

__all__ = ["LONGEST_ERROR", "check_error", "refusals"]

LONGEST_ERROR = 3 * LONGEST_TEXT
"""Characters that one error may have: it names what was wrong, and does not repeat it."""
_MOST_ERRORS = 60


@contextmanager
def refusals(*kinds: type[RosplcError]) -> Iterator[None]:
    """Let errors of rosplc's pass, of these kinds if some are given; everything else is a finding."""
    try:
        yield
    except RosplcError as error:
        check_error(error)
        if kinds and not isinstance(error, kinds):
            raise


def check_error(error: RosplcError) -> None:
    """Look at an error as those do who show it.

    Raises:
        AssertionError: It is not fit to be shown.
    """
    errors: tuple[RosplcError, ...] = getattr(error, "errors", (error,))
    assert len(errors) <= _MOST_ERRORS, f"{len(errors)} errors at once"
    for one in errors:
        assert one.code in CODES
        assert len(str(one)) <= LONGEST_ERROR, f"an error of {len(str(one))} characters"
        json.dumps(one.to_dict())
