"""The page of this machine's channels: live values, plots, events, and test messages where allowed.

One process serves it, with the files of this package alone: no other address is contacted, nothing has to be
built. It looks at channels as ``rosplc top`` does and disturbs none.
"""

from rosplc.web.access import Settings, is_loopback, new_token, read_token
from rosplc.web.server import serve

__all__ = ["Settings", "is_loopback", "new_token", "read_token", "serve"]
