"""Optional Python packages: whether they are there is found out without importing them."""

from __future__ import annotations

import importlib.util

from rosplc.bench.missing import Missing

__all__ = ["need"]


def need(package: str) -> None:
    """Raise Missing if a package of ``rosplc[bench]`` is not installed."""
    if importlib.util.find_spec(package) is None:
        raise Missing(f"the Python package {package} is missing", "pip install 'rosplc[bench]'")
