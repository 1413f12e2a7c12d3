"""The web page of this machine's channels: live values, plots, events, and test messages if allowed.

One process serves it, using only the files of this package: no other address is contacted, and no build step
is needed. It reads channels as ``rosplc top`` does, without side effects.
"""

from rosplc.web.access import Settings, is_loopback, new_token, read_token
from rosplc.web.server import serve

__all__ = ["Settings", "is_loopback", "new_token", "read_token", "serve"]
