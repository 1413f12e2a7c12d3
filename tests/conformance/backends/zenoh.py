"""Zenoh through the eclipse-zenoh wheel: peers that find each other by a router, and its clients."""

from __future__ import annotations

import importlib.util
import time
from collections.abc import Callable
from typing import Any, ClassVar

from rosplc.model import TypeStore
from tests.conformance.backends.base import Abilities, Harness, Peer
from tests.interop.zenoh.processes import Router, free_port
from tests.lib.waiting import wait_for


class ZenohHarness(Harness):
    """Peers around a router, as ROS 2 nodes on rmw_zenoh are by default."""

    backend = "zenoh"
    title = "zenoh"
    mode: ClassVar[str] = "peer"
    abilities: ClassVar[Abilities] = Abilities(
        source_stamps=True,
        matches_qos=False,
        latched_depth=True,
        latched_by_publisher=False,
        tells_definitions=True,
        checks_outgoing=False,
        checks_incoming=False,
        counts_losses=True,
        drops_on_full_links=True,
        shows_qos=True,
        shows_hashes=True,
        many_nodes=True,
        sees_callers=True,
        refuses_with_words=False,
        remembers_callers=False,
        has_hub=True,
    )

    @classmethod
    def missing(cls) -> str | None:
        """Return what is not installed."""
        return None if importlib.util.find_spec("zenoh") else "no wheel of eclipse-zenoh for this machine"

    def start(self) -> None:
        """Start a router of the test's own; that makes the domain one's own, too."""
        self.domain = 7
        self.router = self.stack.enter_context(Router(self.stack.enter_context(free_port())))
        self.options = {"mode": self.mode, "connect": [self.router.endpoint]}

    def bother(self, service: str, type_name: str) -> int:
        """Query without a payload, without an attachment, with a wrong one, and without a header of CDR."""
        import zenoh

        from rosplc.ros.zenoh.backend import session_config
        from rosplc.ros.zenoh.keys import pack, topic_key

        type_hash = TypeStore.bundled(self.distros[0]).service_hash(type_name)
        key = topic_key(self.domain or 0, service, type_name, type_hash)
        good, attachment = self.string("good"), pack(1, 1, bytes(16))
        hostile = [
            (None, None),
            (good, None),
            (None, attachment),
            (good, attachment[:20]),
            (b"x", attachment),
        ]
        with zenoh.open(session_config(self.options, {}).config) as session:
            querier = session.declare_querier(key, target=zenoh.QueryTarget.ALL_COMPLETE)
            wait_for(lambda: querier.matching_status.matching)
            for payload, words in hostile:
                for _ in querier.get(payload=payload, attachment=words):
                    pass  # until the query has ended
        return len(hostile)

    def restart_hub(self, silent_s: float = 0.0) -> None:
        """Kill the router, wait, start another one at its port."""
        self.router.kill()
        time.sleep(silent_s)
        self.router.start()

    def foreign_peers(self) -> tuple[str, ...]:
        """Return the other project's implementation, if it is installed."""
        return ("sdk",) if importlib.util.find_spec("zenoh_ros2_sdk") else ()

    def foreign(self, which: str, name: str) -> Peer:
        """Start a process on zenoh-ros2-sdk."""
        from tests.interop.zenoh.sdk import SdkPeer

        assert self.domain is not None
        peer = SdkPeer(self.router.port, self.domain)
        self.stack.callback(peer.close)
        return peer

    def rogue(self, topic: str, type_name: str) -> Callable[[bytes], object]:
        """Put bytes on the topic's key with a proper attachment."""
        import zenoh

        from rosplc.model import TypeStore
        from rosplc.ros.zenoh.backend import session_config
        from rosplc.ros.zenoh.keys import pack, topic_key

        assert self.domain is not None
        store = TypeStore.bundled(self.distros[0])
        key = topic_key(self.domain, topic, type_name, store.type_hash(type_name))
        # A client: between peers the way changes from the router to a link of their own, and what is
        # under way just then is lost.
        session: Any = zenoh.open(session_config({**self.options, "mode": "client"}, {}).config)
        self.stack.callback(session.close)
        publisher = session.declare_publisher(key)
        wait_for(lambda: publisher.matching_status.matching)  # until then everything would be lost
        numbers = iter(range(1, 1 << 30))

        def send(data: bytes) -> None:
            publisher.put(data, attachment=pack(next(numbers), time.time_ns(), bytes(16)))

        return send


class ZenohClientHarness(ZenohHarness):
    """Clients of a router, through which every message goes."""

    title = "zenoh-client"
    repeats = True
    mode = "client"
