"""Read-only looks at running channels, for people and for tools."""

from __future__ import annotations

__all__: list[str] = []
