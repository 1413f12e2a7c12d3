"""Durations, rates, sizes and file modes as people write them."""

from __future__ import annotations

import re
from collections.abc import Iterable
from fractions import Fraction
from typing import Any

_UNITS = {"ns": 1, "us": 10**3, "µs": 10**3, "ms": 10**6, "s": 10**9, "min": 60 * 10**9, "h": 3600 * 10**9}
_RATES = {"mHz": Fraction(1, 1000), "Hz": Fraction(1), "kHz": Fraction(1000)}
_SIZES = {"B": 1, "kB": 10**3, "KB": 10**3, "MB": 10**6, "GB": 10**9, "TB": 10**12}
_SIZES |= {"KiB": 2**10, "MiB": 2**20, "GiB": 2**30}
_QUANTITY = re.compile(r"([0-9]{1,14}(?:\.[0-9]{1,9})?)[ ]?([A-Za-zµ]+)\Z")
_LONGEST = 24 * 3600 * 10**9


def _split(value: Any, example: str, units: Iterable[str]) -> tuple[Fraction, str]:
    match = _QUANTITY.match(value) if isinstance(value, str) else None
    if not match:
        raise ValueError(f"{value!r} should be a number with a unit, such as {example}")
    if match[2] not in units:
        raise ValueError(f"{value!r} has an unknown unit, {match[2]!r}; use one of {', '.join(units)}")
    return Fraction(match[1]), match[2]


def parse_duration(value: Any) -> int:
    """Return the ns of "200ms", "1s", "10us"; up to a day. ValueErrors of this module tell what is right."""
    number, unit = _split(value, "10ms, 1s or 500us", _UNITS)
    ns = number * _UNITS[unit]
    if ns.denominator != 1 or not 0 < ns <= _LONGEST:
        raise ValueError(f"{value!r} is not between 1ns and 24h")
    return int(ns)


def parse_rate(value: Any) -> int:
    """Return the period in nanoseconds of ``"50Hz"`` or ``"0.5Hz"``, or of a duration ``"20ms"``."""
    number, unit = _split(value, "50Hz or 20ms", (*_RATES, *_UNITS))
    if unit in _UNITS:
        return parse_duration(value)
    hertz = number * _RATES[unit]
    if not 0 < hertz <= 10**6 or 10**9 / hertz > _LONGEST:
        raise ValueError(f"{value!r} is not between once a day and 1000kHz")
    return round(10**9 / hertz)


def parse_size(value: Any) -> int:
    """Return the bytes of ``"200MB"`` or ``"64MiB"``; up to 1000 TB."""
    number, unit = _split(value, "200MB or 1GB", _SIZES)
    size = number * _SIZES[unit]
    if not 1 <= size <= 10**15:
        raise ValueError(f"{value!r} is not between 1B and 1000TB")
    return int(size)


def parse_mode(value: Any) -> int:
    """Return the permission bits of ``"0660"``."""
    if not isinstance(value, str) or not re.fullmatch(r"(0o?)?[0-7]{3}", value):
        raise ValueError(f'{value!r} must be a quoted octal mode, such as "0660"')
    mode = int(value[-3:], 8)
    if mode & 0o600 != 0o600:
        raise ValueError(
            f'{value!r} denies the bridge read or write access to its objects; use a mode such as "0660"'
        )
    if mode & 0o111:
        raise ValueError(
            f'{value!r} has execute bits, which shared memory does not use; use a mode such as "0660"'
        )
    return mode


def parse_stale(value: Any) -> int:
    """Return the nanoseconds of a duration, or 0 for ``"never"``."""
    return 0 if value == "never" else parse_duration(value)


def format_duration(ns: int) -> str:
    """Return nanoseconds as a configuration writes them: 10000000 is ``"10ms"``."""
    for unit in ("h", "min", "s", "ms", "us"):
        if ns and ns % _UNITS[unit] == 0:
            return f"{ns // _UNITS[unit]}{unit}"
    return f"{ns}ns"
