"""A Zenoh router as a process of its own."""

from __future__ import annotations

import sys
import threading

import zenoh

if __name__ == "__main__":
    config = zenoh.Config()
    config.insert_json5("mode", '"router"')
    config.insert_json5("listen/endpoints", f'["{sys.argv[1]}"]')
    config.insert_json5("scouting/multicast/enabled", "false")
    # A router that is killed would leave its segment in /dev/shm.
    config.insert_json5("transport/shared_memory/enabled", "false")
    session = zenoh.open(config)
    threading.Event().wait()
