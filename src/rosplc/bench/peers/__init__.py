"""The contenders in Python: each module is one, as a process of its own.

``python -m rosplc.bench.peers MODULE SIDE ARGUMENTS`` runs side A or B. Orders and answers are
those of ``c/exchange.h``. Each third-party library is imported in its own module only.
"""

from __future__ import annotations

__all__: list[str] = []
