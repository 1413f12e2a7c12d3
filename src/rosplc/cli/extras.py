"""Verbs that stand on packages which not every installation has."""

from __future__ import annotations

import importlib.util

from rosplc.errors import SetupError

__all__ = ["need_extra"]


def need_extra(package: str, extra: str, verb: str) -> None:
    """Check that an optional package is installed.

    Args:
        package: What is imported.
        extra: The extra of this distribution that brings it.
        verb: Who needs it.

    Raises:
        SetupError: SYS001, naming the pip command.
    """
    if importlib.util.find_spec(package) is None:
        what = f"rosplc {verb} needs the Python package {package}, which is not installed"
        raise SetupError("SYS001", what, remedy=f"pip install 'rosplc[{extra}]'")
