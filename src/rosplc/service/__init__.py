"""A bridge as a service of systemd: its unit, its user, and what it tells the service manager.

``rosplc service`` is the command; nothing else imports this package.
"""

from __future__ import annotations

__all__: list[str] = []
