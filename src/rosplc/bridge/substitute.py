"""What ROS gets in a silent PLC's place, and how ROS can tell: ``on_stale`` towards ROS.

A ROS message has no room for a flag. So a topic of its own says whether substitutes are being published,
for whoever asks now or comes later, and each of them is counted apart from the PLC's messages.
"""

from __future__ import annotations

import logging
from contextlib import suppress

from rosplc.codec import Codec
from rosplc.config.quantities import format_duration
from rosplc.config.resolve import TopicPlan
from rosplc.config.stale_plan import flag_topic
from rosplc.errors import RosplcError
from rosplc.layout import compute_layout
from rosplc.ros import Backend, Publisher, Qos

__all__ = ["Substitute"]

log = logging.getLogger("rosplc.bridge")

_BOOL = "std_msgs/msg/Bool"
_QOS = Qos(reliability="reliable", durability="transient_local", depth=1)


class Substitute:
    """Decides when a topic's substitute is due; belongs to the thread that publishes the topic.

    Args:
        plan: The topic, with ``on_stale.action`` ``substitute``.
        codec: Its codec.
        now_ns: The monotonic time from which on the PLC is expected to speak.

    Attributes:
        payload: The message that takes the place of the PLC's.
        active: Whether the PLC is silent, and substitutes are published.
        count: How many were published since the PLC fell silent.
    """

    def __init__(self, plan: TopicPlan, codec: Codec, now_ns: int) -> None:
        self.payload = codec.encode(plan.on_stale.record)
        self.active = False
        self.count = 0
        self._topic = plan.topic
        self._silence_ns = plan.stale_after_ns
        self._period_ns = plan.on_stale.period_ns
        self._due_ns = now_ns + self._silence_ns
        self._flag: Publisher | None = None
        layout = compute_layout(plan.layout.store, _BOOL)
        flag = Codec(layout, codec.wire)
        self._words = {state: flag.encode(layout.pack({"data": state})) for state in (False, True)}

    @property
    def due_ns(self) -> int:
        """When the next substitute is due, if the PLC stays silent."""
        return self._due_ns

    def join(self, backend: Backend) -> None:
        """Advertise the flag. Raises as :meth:`Backend.advertise`."""
        self._flag = backend.advertise(flag_topic(self._topic), _BOOL, _QOS)
        self._say(False)

    def leave(self) -> None:
        """Withdraw the flag; harmless twice."""
        flag, self._flag = self._flag, None
        if flag is not None:
            flag.close()

    def heard(self, now_ns: int) -> None:
        """The PLC has sent a message: substitutes end before it is published."""
        self._due_ns = now_ns + self._silence_ns
        if self.active:
            self.active = False
            self._say(False)
            log.info("%s: the PLC's messages come again, after %d substitutes", self._topic, self.count)

    def take(self, now_ns: int) -> bytes | None:
        """Return the substitute if one is due, else None."""
        if now_ns < self._due_ns:
            return None
        if not self.active:
            self.active, self.count = True, 0
            every = format_duration(self._period_ns)
            log.warning("%s: the PLC is silent; a substitute is published every %s", self._topic, every)
            self._say(True)
        # A bridge that was stopped owes no substitutes.
        self._due_ns = max(self._due_ns + self._period_ns, now_ns)
        return self.payload

    def _say(self, state: bool) -> None:
        if self._flag is not None:
            with suppress(RosplcError):  # the topic's own messages meet the same trouble, and tell of it
                self._flag.write(self._words[state])
