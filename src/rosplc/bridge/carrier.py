"""The threads of a bridge: one per kind and direction of ports, and others for periodic duties."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Collection, Iterable
from concurrent.futures import Future, wait
from dataclasses import dataclass
from typing import Any, TypeAlias

from rosplc.bridge.called import Called, CalledGoals
from rosplc.bridge.channel import LAZY_TICK_NS, ChannelsToPlc, ChannelsToRos, Grouped
from rosplc.bridge.classic import ClassicPorts
from rosplc.bridge.port import Context, Ports, log
from rosplc.bridge.served import Served, ServedGoals
from rosplc.bridge.stream import Stream, ToPlc, ToRos
from rosplc.bridge.transforms import Transforms, TransformToPlc
from rosplc.bridge.use import IDLE_NS, Use
from rosplc.clock import Clock
from rosplc.config.plans import CallPlan
from rosplc.config.resolve import Plan
from rosplc.errors import ChannelError, RosplcError
from rosplc.shm import Direction

_USES: dict[tuple[str, str], Callable[..., Use]] = {
    ("service", "plc"): Served,
    ("service", "ros"): Called,
    ("action", "plc"): ServedGoals,
    ("action", "ros"): CalledGoals,
}


class CallPorts(Grouped[Any]):
    """The uses of all services and actions of a bridge.

    The carrier's thread owns the state of all calls: the threads of the ROS side give it events, the PLC's
    blocks write to shared memory (spec/shm-format.md, section 11). At most one call per use is open; further
    calls wait in the use's queue and can expire before the PLC has seen them.
    """

    def __init__(self, context: Context, tick_ns: int) -> None:
        super().__init__(context, tick_ns)
        self._heads: dict[int, int] = {}  # of what has been reported, and not taken
        self._told: deque[Use] = deque()

    def make(self, side: Any) -> Use:
        """Return the use of a plan; nothing is opened yet."""
        plan: CallPlan = side
        return _USES[plan.kind, plan.server](plan, self._context, self._tell)

    def add(self, port: Use) -> None:
        """Start to serve a use whose objects are open."""
        watched = port.watch(self._group)
        self._ports |= dict.fromkeys(watched, port)
        self._heads = {index: head for index, head in self._heads.items() if index not in watched}

    def _tell(self, use: Use) -> None:
        self._told.append(use)
        self._group.wake()

    def poll(self, due_ns: int | None) -> None:
        """Sleep until there is news."""
        lively = any(use.lively for use in self._ports.values())
        self._wait(self._tick_ns if lively else max(self._tick_ns, LAZY_TICK_NS), IDLE_NS, due_ns)

    def take(self, now_ns: int) -> tuple[int | None, list[Use]]:
        """Continue the calls of all uses that have new events or are due."""
        messages, faults = self._group.take()
        # A request that waits for a server is news once; the use looks at it again by itself.
        news = {self._ports[index] for index, _, head, *_ in messages if self._heads.get(index) != head}
        self._heads = {index: head for index, _, head, *_ in messages}
        for _ in range(len(self._told)):
            news.add(self._told.popleft())
        again: list[Use] = []
        for index, fault in faults:
            use = self._ports[index]
            use.fail(now_ns, fault)
            if use not in again:
                again.append(use)
        served = dict.fromkeys(self._ports.values())
        for use in (*served, *(use for use in news if use.problem and use not in served)):
            if use in again or (use not in news and now_ns < use.due_ns):
                continue
            try:
                use.turn(now_ns)
            except (ChannelError, ValueError) as error:  # an object failed, or was just closed
                use.fail(now_ns, error)
                again.append(use)
            except Exception as error:  # one use's trouble is no other's
                log.debug("%s: processing its calls failed", use.plan.name, exc_info=True)
                use.note(now_ns, f"processing calls failed: {type(error).__name__}: {error}")
                use.due_ns = now_ns + IDLE_NS
        return min((use.due_ns for use in self._ports.values()), default=None), again


_HANGS = "publishing to ROS is blocked; the bridge no longer waits for it to finish"
_PATIENCE_S = 5.0

Carried: TypeAlias = "Stream | Use"  # what a carrier's thread serves


class Carrier:
    """The thread for all streams over one kind of port in one direction; exists only with streams."""

    def __init__(self, name: str, ports: Ports[Any], clock: Clock) -> None:
        self.ports = ports
        self.busy_since_ns = 0  # when it began to pass on what it holds; 0 while it waits for news
        self.turned_ns = clock.monotonic_ns()  # when it last began a round
        self._name = name
        self._clock = clock
        self._streams: tuple[Carried, ...] = ()
        self._holding: tuple[Carried, ...] = ()  # those with stages that may hold something back
        self._due_ns: int | None = None  # of the ports
        self._jobs: deque[Callable[[], None]] = deque()
        self._reopening: set[Carried] = set()
        self._stopping = False
        self._thread: threading.Thread | None = None

    @property
    def running(self) -> bool:
        """Whether the thread exists."""
        return self._thread is not None

    def _start(self) -> None:
        self._thread = threading.Thread(target=self._run, name=self._name, daemon=True)
        self._thread.start()

    def stop(self) -> bool:
        """Stop, after passing on what is waiting; return whether the thread ended in time."""
        self._stopping = True
        self.ports.wake()
        if self._thread is not None:
            self._thread.join(_PATIENCE_S)
            if self._thread.is_alive():
                return False
        for stream in self._streams:
            stream.finish(self._clock.monotonic_ns())
        return True

    def reopen(self, stream: Carried) -> None:
        """Request that a stream's port be opened again; callable from any thread."""
        if stream not in self._reopening:
            self._reopening.add(stream)
            self._jobs.append(lambda: self._reopen(stream))
            self.ports.wake()

    def replace(self, leaving: Collection[Carried], coming: Collection[Carried]) -> bool:
        """Carry other streams from now on; return False, with nothing changed, if the ROS side hangs.

        Callable from any thread except the carrier's own. The leaving streams are polled a last time and may
        then be closed; the coming streams are already connected.
        """
        if self._thread is None:
            self._replace(leaving, coming)
            if self._streams:
                self._start()
            return True
        done: Future[None] = Future()

        def work() -> None:
            if not done.set_running_or_notify_cancel():
                return
            try:
                self._replace(leaving, coming)
                done.set_result(None)
            except Exception as error:  # it is the giver's, not this thread's
                done.set_exception(error)

        self._jobs.append(work)
        self.ports.wake()
        wait((done,), _PATIENCE_S)
        if not done.done() and done.cancel():
            return False
        done.result()  # begun, and it waits for nothing
        return True

    def _replace(self, leaving: Collection[Carried], coming: Collection[Carried]) -> None:
        for stream in leaving:
            self.ports.remove(stream.port)
        self._streams = (*(stream for stream in self._streams if stream not in leaving), *coming)
        for stream in coming:
            if not stream.problem:
                self.ports.add(stream.port)
        self._holding = tuple(stream for stream in self._streams if stream.hold.stages)
        self._due_ns = self._clock.monotonic_ns()

    def _reopen(self, stream: Carried) -> None:
        self._reopening.discard(stream)
        if stream not in self._streams:
            return  # it has left meanwhile, and its name with it
        self.ports.remove(stream.port)
        if stream.reopen(self._clock.monotonic_ns()):
            self.ports.add(stream.port)
            self._due_ns = self._clock.monotonic_ns()

    def _run(self) -> None:
        while not self._stopping:
            try:
                self._turn()
            except Exception:
                log.exception("carrying messages failed; the bridge continues")
                self._clock.sleep(100_000_000)

    def _turn(self) -> None:
        self.turned_ns = self._clock.monotonic_ns()
        self.ports.poll(self._due())
        if self._stopping:
            return
        now = self._clock.monotonic_ns()
        self.busy_since_ns = now
        self._due_ns, again = self.ports.take(now)
        if self._holding:
            self._flush()
        self.busy_since_ns = 0
        for port in again:
            self._reopen(port.side)
        # After a look at what is new, so that a stream that leaves leaves nothing behind.
        while self._jobs:
            self._jobs.popleft()()

    def _due(self) -> int | None:
        due = self._due_ns
        for stream in self._holding:
            wanted = stream.hold.due_ns
            if wanted is not None and (due is None or wanted < due):
                due = wanted
        return due

    def _flush(self) -> None:
        over = False
        for stream in self._holding:
            due, now = stream.hold.due_ns, self._clock.monotonic_ns()
            if due is not None and due <= now:
                stream.flush(now)
                over = over or not stream.hold.stages
        if over:
            self._holding = tuple(stream for stream in self._holding if stream.hold.stages)


class Carriers:
    """All carriers of a bridge, by stream; ``tick_ns`` is the tick to ROS."""

    def __init__(self, context: Context, tick_ns: int) -> None:
        self._context = context
        self._calls = CallPorts(context, tick_ns)
        self._transforms = Transforms(context)
        kinds: dict[tuple[str, Direction | None], tuple[str, Ports[Any]]] = {
            # Those that a ROS side may hang come first: nothing has changed then.
            ("channel", None): ("rosplc-calls", self._calls),
            ("classic", Direction.TO_ROS): ("rosplc-classic-to-ros", ClassicPorts(context, Direction.TO_ROS)),
            ("channel", Direction.TO_ROS): ("rosplc-to-ros", ChannelsToRos(context, tick_ns)),
            ("classic", Direction.TO_PLC): ("rosplc-classic-to-plc", ClassicPorts(context, Direction.TO_PLC)),
            ("channel", Direction.TO_PLC): ("rosplc-to-plc", ChannelsToPlc(context)),
        }
        self._carriers = {kind: Carrier(name, ports, context.clock) for kind, (name, ports) in kinds.items()}

    def of(self, plan: Plan) -> Carrier:
        """Return the carrier of a plan's streams."""
        return self._carriers[plan.port, None if isinstance(plan, CallPlan) else plan.direction]

    def make(self, plan: Plan) -> Carried:
        """Return the stream or use of a plan without opening anything."""
        if isinstance(plan, CallPlan):
            return self._calls.make(plan)
        carrier = self.of(plan)
        if plan.transform is not None:
            own = self._transforms, plan, self._context
            return TransformToPlc(*own, carrier.ports, carrier.ports.wake)
        if plan.direction is Direction.TO_PLC:
            return ToPlc(plan, self._context, carrier.ports, carrier.ports.wake)
        return ToRos(plan, self._context, carrier.ports)

    def _to_ros(self) -> Iterable[Carrier]:
        return (
            one for (_, way), one in self._carriers.items() if way is not Direction.TO_PLC and one.running
        )

    @property
    def busy_since_ns(self) -> int:
        """The time since which a thread has been publishing a message; 0 if none is publishing."""
        return min((since for one in self._to_ros() if (since := one.busy_since_ns)), default=0)

    @property
    def turned_ns(self) -> int:
        """The last time at which the thread of the channels to ROS, or of the calls, began a round."""
        carriers = (self._carriers["channel", way] for way in (Direction.TO_ROS, None))
        turned = (carrier.turned_ns for carrier in carriers if carrier.running)
        return min(turned, default=self._context.clock.monotonic_ns())

    def reopen(self, stream: Carried) -> None:
        """Request that the responsible thread open a stream's port again."""
        self.of(stream.plan).reopen(stream)

    def replace(self, leaving: Collection[Carried], coming: Collection[Carried]) -> bool:
        """Carry other, open streams and flush the leaving ones; return False, unchanged, if ROS hangs."""
        now = self._context.clock.monotonic_ns()
        for stream in coming:
            stream.begin(now)
        done: list[tuple[Carrier, list[Carried], list[Carried]]] = []
        for carrier in self._carriers.values():
            theirs = [stream for stream in leaving if self.of(stream.plan) is carrier]
            new = [stream for stream in coming if self.of(stream.plan) is carrier]
            if not theirs and not new:
                continue
            if not carrier.replace(theirs, new):
                for other, old, begun in done:
                    other.replace(begun, old)
                return False
            done.append((carrier, theirs, new))
        for stream in leaving:
            stream.finish(self._context.clock.monotonic_ns())
        return True

    def stop(self) -> None:
        """Stop all threads, after passing on messages that wait for a subscriber or for their time."""
        for carrier in self._carriers.values():
            if not carrier.stop():
                log.error(_HANGS)


@dataclass
class Duty:
    """A periodic job; a failure is logged, and the job is repeated in the next period."""

    what: str
    period_ns: int  # time between two times
    work: Callable[[], None]
    due_ns: int = 0  # when it is due first, after the start; later the monotonic time


class Rounds:
    """A thread that runs its duties; it last began a round at ``turned_ns``."""

    def __init__(self, name: str, clock: Clock, *duties: Duty) -> None:
        self._clock = clock
        self._duties = duties
        self.turned_ns = clock.monotonic_ns()
        self._wake = threading.Event()
        self._stopping = False
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def stop(self) -> None:
        """Stop the thread; a thread that hangs in the ROS side is abandoned after five seconds."""
        self._stopping = True
        self._wake.set()
        self._thread.join(_PATIENCE_S)
        if self._thread.is_alive():
            log.error("thread %s is not stopping; the bridge no longer waits for it", self._thread.name)

    def _run(self) -> None:
        for duty in self._duties:
            duty.due_ns += self._clock.monotonic_ns()
        while not self._stopping:
            self.turned_ns = now = self._clock.monotonic_ns()
            for duty in self._duties:
                if now >= duty.due_ns:
                    self._do(duty)
                    # A machine that was suspended owes nothing.
                    duty.due_ns = max(duty.due_ns + duty.period_ns, now)
            due = min(duty.due_ns for duty in self._duties)
            self._clock.wait(self._wake, due - self._clock.monotonic_ns())

    def _do(self, duty: Duty) -> None:
        try:
            duty.work()
        except RosplcError as error:
            log.warning("%s failed: %s", duty.what, error)
        except Exception:
            log.exception("%s failed", duty.what)
