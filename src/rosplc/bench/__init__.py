"""Measurements that users can repeat on their own machine."""

from __future__ import annotations

__all__: list[str] = []
