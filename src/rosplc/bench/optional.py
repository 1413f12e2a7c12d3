"""Whether an optional Python package is here, and new enough."""

from __future__ import annotations

import importlib.util

from rosplc.bench.missing import Missing

__all__ = ["REMEDY", "need"]

REMEDY = "pip install 'rosplc[bench]'"


def need(package: str) -> None:
    """Raise Missing if a package is not there, or lacks what this release uses of it."""
    if importlib.util.find_spec(package) is None:
        raise Missing(f"the Python package {package} is missing", REMEDY)
    if package == "pymodbus":
        try:
            from pymodbus.simulator import SimDevice

            SimDevice.__dataclass_fields__["action"]
        except (ImportError, AttributeError, KeyError):
            raise Missing("the Python package pymodbus is too old", f"{REMEDY} --upgrade") from None
