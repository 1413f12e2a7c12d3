"""The terminal view: every channel of the machine, and a message with live values.

Only this package imports textual; it is part of the extra ``views``.
"""

from rosplc.monitor.terminal.app import TopApp

__all__ = ["TopApp"]
