"""The PLC half, written from a layout: constants, types and code that a technician imports."""

from __future__ import annotations

__all__: list[str] = []
