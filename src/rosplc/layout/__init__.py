"""Where each part of a message lies in its record, and typed access to records."""

from rosplc.layout.layout import Layout, compute_layout
from rosplc.layout.nodes import Limits
from rosplc.layout.view import RecordView

__all__ = ["Layout", "Limits", "RecordView", "compute_layout"]
