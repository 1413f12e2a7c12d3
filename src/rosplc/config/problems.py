"""Everything that is wrong with a configuration, reported together, so that it is corrected in one go."""

from __future__ import annotations

from collections.abc import Iterable

from rosplc.errors import ConfigError, RosplcError
from rosplc.harmless import nearest

__all__ = ["MOST_ERRORS", "Absent", "ConfigErrors", "Problems", "did_you_mean", "may_pass", "relocated"]

MOST_ERRORS = 50  # more errors than this are one mistake, repeated


class Absent(ConfigError):
    """Something that a configuration refers to is not there; it may come, as a disk does that is mounted."""


class ConfigErrors(ConfigError):
    """One or more errors of one configuration, in the order of their lines.

    It is caught as a :class:`~rosplc.errors.ConfigError`; ``code``, ``what``, ``where`` and
    ``remedy`` are those of the first error, the text shows all of them, one a line.

    Args:
        errors: At least one error; some may be of the families TYP, LAY or SHM.

    Attributes:
        errors: All of them.
    """

    family = ""

    def __init__(self, errors: Iterable[RosplcError]) -> None:
        self.errors = tuple(errors)
        first = self.errors[0]
        super().__init__(first.code, first.what, where=first.where, remedy=first.remedy)

    def __str__(self) -> str:
        return "\n".join(str(error) for error in self.errors)

    def __reduce__(self) -> tuple[object, ...]:
        return (ConfigErrors, (self.errors,))


def may_pass(error: ConfigError) -> bool:
    """Return whether all that is wrong may pass without the configuration being changed."""
    errors = error.errors if isinstance(error, ConfigErrors) else (error,)
    return all(isinstance(one, Absent) for one in errors)


class Problems:
    """Collects errors until :meth:`check` raises them."""

    def __init__(self) -> None:
        self._errors: list[tuple[int, RosplcError]] = []

    def __len__(self) -> int:
        return len(self._errors)

    def add(self, error: RosplcError, line: int = 0) -> None:
        """Take an error; ``line`` sorts it among the others."""
        if len(self._errors) < MOST_ERRORS:
            self._errors.append((line, error))

    def check(self) -> None:
        """Raise what was collected. Raises ConfigErrors: Unless nothing was."""
        if self._errors:
            self._errors.sort(key=lambda item: item[0])
            raise ConfigErrors(error for _, error in self._errors)


def relocated(error: RosplcError, place: str) -> RosplcError:
    """Return the error as one at ``place``; the place it had itself moves into its text."""
    inner = f"{error.where}: " if error.where else ""
    return type(error)(error.code, inner + error.what, where=place, remedy=error.remedy)


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """Return ``"; did you mean 'x'?"`` for the nearest known word, or the known ones if few."""
    names = sorted(known)
    if near := nearest(word, names):
        return f"; did you mean {near!r}?"
    return f"; there are: {', '.join(names)}" if 0 < len(names) <= 20 else ""
