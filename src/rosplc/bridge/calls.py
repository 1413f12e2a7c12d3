"""Services and actions between ROS and the PLC: spec/shm-format.md, section 11.

One thread, that of a :class:`~rosplc.bridge.carrier.Carrier` over :class:`CallPorts`, owns all that is known
of calls: the ROS side's threads give it events, and the PLC's blocks write into shared memory. At most one
call is open per use; what else waits is queued by the use, and can expire without the PLC having seen it.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Any

from rosplc.bridge.called import Called
from rosplc.bridge.called_goals import CalledGoals
from rosplc.bridge.port import Context, Ports, log
from rosplc.bridge.served import Served
from rosplc.bridge.served_goals import ServedGoals
from rosplc.bridge.use import IDLE_NS, Use
from rosplc.config.plans import CallPlan
from rosplc.errors import ChannelError
from rosplc.shm import Group

_LAZY_TICK_NS = 10_000_000  # the tick while no PLC is there: the wake-ups are what an idle bridge costs


_USES: dict[tuple[str, str], Callable[..., Use]] = {
    ("service", "plc"): Served,
    ("service", "ros"): Called,
    ("action", "plc"): ServedGoals,
    ("action", "ros"): CalledGoals,
}


class CallPorts(Ports[Any]):
    """The uses of all services and actions of a bridge, with one native call per tick for their objects."""

    def __init__(self, context: Context, tick_ns: int) -> None:
        self._context = context
        self._now = context.clock.monotonic_ns
        self._tick_ns = tick_ns
        self._group = Group()
        self._uses: dict[int, Use] = {}
        self._heads: dict[int, int] = {}  # of what has been reported, and not taken
        self._told: deque[Use] = deque()

    def make(self, side: Any) -> Use:
        """Return the use of a plan; nothing is opened yet."""
        plan: CallPlan = side
        return _USES[plan.kind, plan.server](plan, self._context, self._tell)

    def add(self, port: Use) -> None:
        """Serve a use whose objects are open."""
        self._uses |= dict.fromkeys(port.watch(self._group), port)

    def remove(self, port: Use) -> None:
        """Serve it no more."""
        for index in [index for index, known in self._uses.items() if known is port]:
            self._group.remove(index)
            del self._uses[index]
            self._heads.pop(index, None)

    def _tell(self, use: Use) -> None:
        self._told.append(use)
        self._group.wake()

    def poll(self, due_ns: int | None) -> None:
        """Sleep until there is news."""
        wait = IDLE_NS if due_ns is None else max(0, min(IDLE_NS, due_ns - self._now()))
        lively = any(use.lively for use in self._uses.values())
        self._group.wait(self._tick_ns if lively else max(self._tick_ns, _LAZY_TICK_NS), wait)

    def wake(self) -> None:
        """End the sleep."""
        self._group.wake()

    def take(self, now_ns: int) -> tuple[int | None, list[Use]]:
        """Go on with the calls of all uses that have news or whose time has come."""
        messages, faults = self._group.take()
        # A request that waits for a server is news once; the use looks at it again by itself.
        news = {self._uses[index] for index, _, head, *_ in messages if self._heads.get(index) != head}
        self._heads = {index: head for index, _, head, *_ in messages}
        for _ in range(len(self._told)):
            news.add(self._told.popleft())
        again: list[Use] = []
        for index, fault in faults:
            use = self._uses[index]
            use.fail(now_ns, fault)
            if use not in again:
                again.append(use)
        served = dict.fromkeys(self._uses.values())
        for use in (*served, *(use for use in news if use.problem and use not in served)):
            if use in again or (use not in news and now_ns < use.due_ns):
                continue
            try:
                use.turn(now_ns)
            except (ChannelError, ValueError) as error:  # an object failed, or was just closed
                use.fail(now_ns, error)
                again.append(use)
            except Exception as error:  # one use's trouble is no other's
                log.debug("%s: its calls could not be looked after", use.plan.name, exc_info=True)
                use.note(now_ns, f"calls cannot be looked after: {type(error).__name__}: {error}")
                use.due_ns = now_ns + IDLE_NS
        return min((use.due_ns for use in self._uses.values()), default=None), again
