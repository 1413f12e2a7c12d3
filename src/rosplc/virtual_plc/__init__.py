"""A scan-cycle stand-in for a PLC, for laptops and CI where no PLC runs."""

from __future__ import annotations

__all__: list[str] = []
