"""Who is compared: each a real implementation, as its own users would use it."""

from __future__ import annotations

from rosplc.bench.contenders.base import Contender, Place
from rosplc.bench.contenders.registry import CONTENDERS

__all__ = ["CONTENDERS", "Contender", "Place"]
