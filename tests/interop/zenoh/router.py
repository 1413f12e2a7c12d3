"""A Zenoh router out of the wheel, in a process of its own: ``python router.py PORT [CONNECT …]``.

No file of the project is imported, so that any version of the wheel can run it. ROS's own router,
``rmw_zenohd``, is the same code with the settings below.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence

import zenoh

SETTINGS = {
    "mode": "router",
    "scouting/multicast/enabled": False,
    # Nothing is scouted for, and half a second per test is much.
    "scouting/delay": 0,
    "scouting/gossip/enabled": True,
    "routing/router/peers_failover_brokering": True,
    "timestamping/enabled": {"router": True, "peer": True, "client": True},
    # A router that is killed, as tests do, leaves its segment in /dev/shm.
    "transport/shared_memory/enabled": False,
    # A burst of small messages is more than the two batches that rmw_zenohd keeps for a link, and what
    # is more it drops: the tests' machine is busy, and they want to see the backend's losses alone.
    "transport/link/tx/queue/size/data": 16,
    "connect/retry": {"period_init_ms": 200, "period_max_ms": 200, "period_increase_factor": 1},
}


def main(arguments: Sequence[str]) -> None:
    """Listen until standard input ends, so that no router outlives its test; ``ready`` says when."""
    listen, *connect = arguments
    config = zenoh.Config()
    endpoints = {"listen/endpoints": [listen], "connect/endpoints": list(connect)}
    for key, value in (SETTINGS | endpoints).items():
        config.insert_json5(key, json.dumps(value))
    with zenoh.open(config):
        print("ready", flush=True)
        sys.stdin.read()


if __name__ == "__main__":
    main(sys.argv[1:])
