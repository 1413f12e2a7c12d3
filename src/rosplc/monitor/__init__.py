"""Read-only looks at running channels, for people and for tools."""

from __future__ import annotations

from rosplc.monitor.snapshot import ObjectState, find_objects

__all__ = ["ObjectState", "find_objects"]
