"""The bridge's ends of two services and two actions, and what crosses there."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rosplc.config.resolve import Project
from rosplc.described import description_of
from rosplc.shm import Namespace, OwnedChannel
from rosplc.shm import constants as spec
from tests.lib.waiting import wait_for

__all__ = ["CALLED", "CallEnds"]

CALLED = """services:
  /close: {type: std_srvs/srv/Trigger, server: ros, clients: [pick]}
  /start: {type: std_srvs/srv/SetBool, server: plc}
actions:
  /drive: {type: example_interfaces/action/Fibonacci, server: ros}
  /cycle: {type: example_interfaces/action/Fibonacci, server: plc}
"""


class CallEnds:
    """The ends of :data:`CALLED`.

    The PLC serves /start with the message that /close answered, and /cycle with what /drive does.

    Args:
        project: The configuration.
        namespace: Where the objects are.
        scan: Lets the PLC run, if it does not by itself.
    """

    def __init__(self, project: Project, namespace: Namespace, scan: Callable[[], object]) -> None:
        self._scan = scan
        self._ends: dict[str, Any] = {}
        self._layouts: dict[str, Any] = {}
        self._channels: list[OwnedChannel] = []
        for plan in project.calls:
            parts = [
                (
                    description_of(
                        layout,
                        plan.called,
                        part.direction(plan.server),
                        bridge="test",
                        part=part,
                        client=plan.client,
                    ),
                    layout.size,
                )
                for part, layout in zip(plan.parts, plan.layouts, strict=True)
            ]
            opened = OwnedChannel.open_together(namespace, parts)
            self._channels += opened
            for part, layout, channel in zip(plan.parts, plan.layouts, opened, strict=True):
                name = f"{plan.called} {part.word}"
                reads = part.asks == (plan.server == "ros")
                self._ends[name] = channel.reader() if reads else channel.writer()
                self._layouts[name] = layout
                if reads:
                    self._ends[name].set_sinks(1)

    def __enter__(self) -> CallEnds:
        return self

    def __exit__(self, *_: object) -> None:
        for channel in self._channels:
            channel.close()

    def _send(self, name: str, value: dict[str, Any], correlation: int, status: int) -> None:
        record = self._layouts[name].pack(value)
        self._ends[name].publish(record, correlation=correlation, status=status, client=bytes(16))

    def _taken(self, name: str, status: int) -> tuple[int, Any]:
        """Wait for a message with this status; return its correlation and value."""

        def look() -> Any:
            for end in self._ends.values():
                end.beat()
            self._scan()
            record = bytearray(self._layouts[name].size)
            info = self._ends[name].latest(record)
            return info and info.status == status and (info.correlation, self._layouts[name].view(record))

        return wait_for(look, f"{name} with {status}")

    def let_all_cross(self) -> None:
        """Answer each call of the PLC, and call it once; every field is compared."""
        call, _ = self._taken("/close request", spec.ASK_CALL)
        goal, asked = self._taken("/drive goal", spec.ASK_CALL)
        assert asked.order == 7
        self._send("/close response", {"success": True, "message": "shut"}, call, spec.ANSWER_DONE)
        self._send("/drive result", {}, goal, spec.ANSWER_ACCEPTED)
        started = self._ends["/start request"].epoch << 32 | 1
        self._send("/start request", {"data": True}, started, spec.ASK_CALL)
        number, reply = self._taken("/start response", spec.ANSWER_DONE)
        assert (number, reply.success, reply.message) == (started, True, "shut")
        served = self._ends["/cycle goal"].epoch << 32 | 1
        self._send("/cycle goal", {"order": 3}, served, spec.ASK_CALL)
        assert self._taken("/cycle result", spec.ANSWER_ACCEPTED)[0] == served
        self._send("/drive feedback", {"sequence": [0, 1]}, goal, spec.ANSWER_ACCEPTED)
        wait_for(
            lambda: list(self._taken("/cycle feedback", spec.ANSWER_ACCEPTED)[1].sequence) == [0, 1],
            "feedback",
        )
        self._send("/drive result", {"sequence": [0, 1, 1, 2]}, goal, spec.ANSWER_SUCCEEDED)
        number, result = self._taken("/cycle result", spec.ANSWER_SUCCEEDED)
        assert (number, list(result.sequence)) == (served, [0, 1, 1, 2])
