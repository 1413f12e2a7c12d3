"""``python -m rosplc`` is the ``rosplc`` command."""

from __future__ import annotations

from rosplc.cli import main

main()
