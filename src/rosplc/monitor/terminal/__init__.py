"""The terminal view: all channels of the machine, and messages with live values.

Only this package imports textual, which is part of the extra ``views``.
"""

from rosplc.monitor.terminal.app import TopApp

__all__ = ["TopApp"]
