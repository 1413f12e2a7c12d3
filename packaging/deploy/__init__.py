"""What brings rosplc onto machines: wheels, Debian packages, and emulated boards to try them on.

Part of the checkout, not of the installed package.
"""

from __future__ import annotations

__all__: list[str] = []
