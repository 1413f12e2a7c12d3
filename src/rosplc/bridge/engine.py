"""The running bridge: opens everything or nothing, carries, looks after itself, leaves cleanly.

Threads: the backend's own call :class:`ToPlc`; the pump carries towards ROS; the keeper beats and
looks after the objects; the observer asks the ROS side and reports. Classic topics have a thread for each
direction. An error in one topic stops no other, and a ROS side that hangs stops no beat.
"""

from __future__ import annotations

import secrets
import threading
import time
from contextlib import ExitStack

from rosplc.bridge.classic import ClassicCarrier
from rosplc.bridge.classic_to_plc import ClassicToPlc
from rosplc.bridge.classic_to_ros import ClassicToRos
from rosplc.bridge.config import Config
from rosplc.bridge.diagnostics import Diagnostics
from rosplc.bridge.keeper import Keeper, Observer
from rosplc.bridge.leftovers import retire_leftovers
from rosplc.bridge.owner import group_id, user_id
from rosplc.bridge.resolve import Project, TopicPlan, resolve
from rosplc.bridge.ros_side import RosSide
from rosplc.bridge.status import BridgeStatus
from rosplc.bridge.to_plc import ToPlc
from rosplc.bridge.to_ros import Pump, ToRos
from rosplc.bridge.topic import Surroundings, Topic, log
from rosplc.errors import RosplcError
from rosplc.ros import Backend, Choice, RosArguments
from rosplc.shm import Direction

__all__ = ["Bridge"]

_STUCK_NS = 5_000_000_000


class Bridge:
    """A bridge between ROS and the objects of one prefix; a context manager that starts and stops it.

    Args:
        config: A configuration, or one that is resolved already.
        backend: The ROS side; by default the configuration's is opened, and closed again at the end.
        arguments: ROS arguments of the command line, for a backend that is opened.

    Raises:
        ConfigErrors: The configuration is wrong.
    """

    def __init__(
        self,
        config: Config | Project,
        backend: Backend | None = None,
        *,
        arguments: RosArguments | None = None,
    ) -> None:
        self.project = config if isinstance(config, Project) else resolve(config)
        self.config = self.project.config
        self.settings = self.config.settings
        self.backend = backend
        self._owns_backend = backend is None
        self._ros = RosSide(self.config, arguments or RosArguments())
        self._choice: Choice | None = None
        self._topics: tuple[Topic, ...] = ()
        self._pump: Pump | None = None
        self._classic_to_ros = ClassicCarrier("rosplc-classic-to-ros")
        self._open = ExitStack()
        self._started_ns = 0
        self._file_seen = self._file_state()
        self._config_changed = False

    def start(self) -> None:
        """Take the names, open objects and ROS, and begin to carry.

        Raises:
            RosplcError: Something is in the way (SHM116: another bridge holds a name; SHM117: no
                room; ROS001 …); everything that was opened is closed again, and nothing was replaced
                if a name was taken.
        """
        if self._started_ns:
            raise RuntimeError("this bridge is started already")
        with ExitStack() as stack:
            self._start(stack)
            self._open = stack.pop_all()
        self._started_ns = time.monotonic_ns()
        adopted = sum(topic.channel is not None and topic.channel.adopted for topic in self._topics)
        assert self.backend is not None
        log.info(
            "bridge %s carries %d topics over %s (prefix %s, %d objects adopted)",
            self.settings.bridge,
            len(self._topics),
            self.backend.name,
            self.settings.prefix,
            adopted,
        )

    def _start(self, stack: ExitStack) -> None:
        settings = self.settings
        around = Surroundings(
            namespace=self.project.namespace,
            bridge=settings.bridge,
            bridge_id=secrets.token_bytes(16),
            distro=settings.ros.distro,
            mode=settings.shm.mode,
            uid=user_id(self.config),
            gid=group_id(self.config),
            beat_ns=settings.beat_ns,
        )
        keeper = Keeper(settings.beat_ns, self.beat, self.check, self.flush)
        plans = self.project.topics
        retire_leftovers(self.project)
        self._classic_to_ros = ClassicCarrier("rosplc-classic-to-ros")
        classic_to_plc = ClassicCarrier("rosplc-classic-to-plc")
        self._topics = tuple(_topic(plan, around, keeper, classic_to_plc) for plan in plans)
        for topic in self._topics:
            topic.open()
            stack.callback(topic.close)
        if self.backend is None:
            self.backend, self._choice = self._ros.open(self.project.store)
            stack.callback(self._close_backend)
        for topic in self._topics:
            topic.join(self.backend)
            stack.callback(topic.leave)
        publish = None
        if settings.diagnostics.enabled:
            diagnostics = Diagnostics(self.project.store, self.backend)
            stack.callback(diagnostics.close)
            publish = diagnostics.publish
        channels = tuple(t for t in self._topics if isinstance(t, ToRos) and not isinstance(t, ClassicToRos))
        self._pump = Pump(channels, settings.tick_ns)
        stack.callback(self._stop_pump)
        self._pump.start()
        classic_to_plc.start(tuple(t for t in self._topics if isinstance(t, ClassicToPlc)))
        stack.callback(classic_to_plc.stop)
        classic_to_ros = tuple(t for t in self._topics if isinstance(t, ClassicToRos))
        for topic in classic_to_ros:
            topic.await_subscriber(time.monotonic_ns())
        self._classic_to_ros.start(classic_to_ros)
        stack.callback(self._stop_classic)
        keeper.start()
        stack.callback(keeper.stop)
        observer = Observer(settings.diagnostics.period_ns, self.ask, self.status, publish)
        observer.start()
        stack.callback(observer.stop)

    def _close_backend(self) -> None:
        if self._owns_backend and self.backend is not None:
            self.backend.close()
            self.backend = None

    def _stop_pump(self) -> None:
        if self._pump is not None and not self._pump.stop():
            log.error("the ROS side does not return from publishing; the bridge leaves it behind")

    def _stop_classic(self) -> None:
        if not self._classic_to_ros.stop():
            log.error("the ROS side does not return from publishing; the bridge leaves it behind")
            return
        for topic in self._topics:
            if isinstance(topic, ClassicToRos):
                topic.finish(time.monotonic_ns())

    def stop(self) -> None:
        """Stop carrying; objects stay, with their last state, for the PLC and the next bridge."""
        was_running, self._started_ns = bool(self._started_ns), 0
        self._open.close()
        self._open = ExitStack()
        self._pump = None
        if was_running:
            log.info("bridge %s stopped", self.settings.bridge)

    def run(self, stop: threading.Event) -> None:
        """Start, carry until ``stop`` is set, and stop.

        Raises:
            RosplcError: As :meth:`start`.
        """
        self.start()
        try:
            stop.wait()
        finally:
            self.stop()

    def __enter__(self) -> Bridge:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def status(self) -> BridgeStatus:
        """Return how bridge and topics stand."""
        now = time.monotonic_ns()
        notes = []
        if self._config_changed:
            notes.append("configuration changed on disk; restart the bridge to apply it")
        pump_busy = self._pump.busy_since_ns if self._pump is not None else 0
        busy = min((t for t in (pump_busy, self._classic_to_ros.busy_since_ns) if t), default=now)
        if now - busy > _STUCK_NS:
            notes.append(f"the ROS side has not returned from publishing for {(now - busy) / 1e9:.0f} s")
        return BridgeStatus(
            bridge=self.settings.bridge,
            backend=self.backend.name if self.backend is not None else "",
            backend_why=str(self._choice) if self._choice is not None else "",
            running=bool(self._started_ns),
            uptime_ns=now - self._started_ns if self._started_ns else 0,
            topics=tuple(topic.status(now) for topic in self._topics),
            config_changed=self._config_changed,
            notes=tuple(notes),
        )

    # -- the work of keeper and observer, on their threads

    def beat(self) -> None:
        """Beat on all lines."""
        for topic in self._topics:
            topic.beat()

    def check(self, now_ns: int) -> None:
        """Look after objects, peers and the configuration's file."""
        for topic in self._topics:
            try:
                if topic.check(now_ns):
                    if isinstance(topic, ToRos):
                        assert self._pump is not None
                        self._pump.reopen(topic)
                    else:
                        topic.reopen(now_ns)
            except Exception as error:  # one topic's trouble is no other's
                log.exception("%s: the check failed", topic.plan.topic)
                topic.fail(now_ns, error)
        if not self._config_changed and self._file_state() != self._file_seen:
            log.warning("%s: configuration changed on disk; restart the bridge to apply it", self.config.path)
            self._config_changed = True

    def ask(self, now_ns: int) -> None:
        """Ask the ROS side how each topic stands; this may hang when it does."""
        for topic in self._topics:
            try:
                topic.ask(now_ns)
            except (RosplcError, ValueError) as error:  # an object or endpoint just closed
                log.debug("%s: %s", topic.plan.topic, error)

    def flush(self, now_ns: int) -> int | None:
        """Send what waited for its time; return when the next is due."""
        next_ns: int | None = None
        for topic in self._topics:
            if isinstance(topic, ToPlc) and topic.due_ns is not None:
                topic.flush(now_ns)
                due = topic.due_ns
                if due is not None:
                    next_ns = due if next_ns is None else min(next_ns, due)
        return next_ns

    def _file_state(self) -> tuple[int, int, int] | None:
        path = self.config.path
        if path is None:
            return None
        try:
            found = path.stat()
        except OSError:
            return (0, 0, 0)
        return found.st_ino, found.st_size, found.st_mtime_ns


def _topic(plan: TopicPlan, around: Surroundings, keeper: Keeper, classic_to_plc: ClassicCarrier) -> Topic:
    to_plc = plan.direction is Direction.TO_PLC
    if plan.classic is not None:
        return ClassicToPlc(plan, around, classic_to_plc.wake) if to_plc else ClassicToRos(plan, around)
    return ToPlc(plan, around, keeper.due) if to_plc else ToRos(plan, around)
