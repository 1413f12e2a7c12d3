"""The running bridge: opens everything or nothing, carries messages, monitors itself, and stops cleanly.

Threads: the backend's threads call :class:`~rosplc.bridge.stream.ToPlc`; one carrier per kind of port and
direction serves the ports; the heartbeat thread also checks the objects; the reporter queries the ROS side
and publishes diagnostics. An error in one topic stops no other topic. A hanging ROS side stops no heartbeat.
"""

from __future__ import annotations

import secrets
import threading
from collections.abc import Callable
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Any

from rosplc.bridge.carrier import Carried, Carriers, Duty, Rounds
from rosplc.bridge.leftovers import Leaving, check_names, leaving, retire_leftovers
from rosplc.bridge.own import OwnTopics
from rosplc.bridge.port import STILL_TURNS, Context, log
from rosplc.bridge.realtime import Realtime, contention
from rosplc.bridge.reload import Changes, Exchange, compare
from rosplc.bridge.ros_side import LiveTypes, RosSide
from rosplc.bridge.status import ActionStatus, BridgeStatus, ServiceStatus, carried
from rosplc.bridge.stream import Stream
from rosplc.bridge.use import Use
from rosplc.clock import SYSTEM, Clock
from rosplc.config.file import Config
from rosplc.config.resolve import Project, load_project, open_doors, resolve, rights
from rosplc.config.transforms import TF_MESSAGE
from rosplc.errors import ChannelError, RosplcError
from rosplc.ros import Backend, Choice, RosArguments, ended_for_good

_ROS_TYPES = {"service": ("",), "action": ("_SendGoal", "_GetResult", "_FeedbackMessage")}
_CHECK_NS = 1_000_000_000
_STUCK_NS = 5_000_000_000
_JUST_NOW_NS = 100_000_000
_APPLY = "run `rosplc reload` or restart the bridge to apply it"
_FOREIGN = ("SHM103", "SHM104", "SHM119", "SHM121")
"""A foreign file has an object's name: the topic is not carried and is checked again later."""


class Bridge:
    """A bridge between ROS and the objects of one prefix; a context manager that starts and stops it.

    ``backend`` is the ROS side. By default, the configured backend is opened, with the command line's
    ``arguments``, and closed at the end. Raises ConfigErrors if the configuration is invalid.
    """

    def __init__(
        self,
        config: Config | Project,
        backend: Backend | None = None,
        *,
        arguments: RosArguments | None = None,
        clock: Clock = SYSTEM,
    ) -> None:
        self._clock = clock
        self.project = config if isinstance(config, Project) else resolve(config)
        self.config = self.project.config
        self.settings = self.config.settings
        self.backend = backend
        self._owns_backend = backend is None
        self._ros = RosSide(self.config, arguments or RosArguments())
        self._choice: Choice | None = None
        self._types = LiveTypes(self.project.store)
        self._streams: tuple[Carried, ...] = ()
        self._leaving: tuple[Leaving, ...] = ()
        self._own: OwnTopics | None = None
        self._carriers: Carriers | None = None
        # called once, with the reason, if the ROS side ends for good; the bridge itself only says so,
        # since it may be part of a larger program
        self.on_ended: Callable[[str], None] | None = None
        self._ended = ""
        self.read: Callable[[Path], Project] = load_project  # the file of a reload
        self._changing = threading.Lock()  # reload and check exclude each other
        self._refused = ""
        self._open = ExitStack()
        self._realtime = Realtime(self.config)
        self._heartbeat: Rounds | None = None
        self._warnings: tuple[str, ...] = ()
        self._started_ns = self._asked = 0
        self._file_seen = self._file_state()
        self._config_changed = False

    def start(self) -> None:
        """Lock the names, open the objects and ROS, and start to carry messages.

        Raises RosplcError if this is not possible (SHM116: another bridge holds a name; SHM117: no room;
        ROS001 …). Then everything is closed again; if a name was taken, nothing has been replaced.
        """
        if self._started_ns:
            raise RuntimeError("this bridge has already been started")
        with ExitStack() as stack:
            self._realtime = stack.enter_context(Realtime(self.config))
            self._start(stack)
            self._open = stack.pop_all()
        self._realtime.settled()
        self._started_ns = self._clock.monotonic_ns()
        adopted = sum(stream.plan.port == "channel" and stream.port.adopted for stream in self._streams)
        assert self.backend is not None
        text = "bridge %s carries %s over %s (prefix %s, %d objects adopted)"
        own, made = self.settings, self.project
        what = carried(len(made.topics), len(made.services), len(made.actions))
        log.info(text, own.bridge, what, self.backend.name, own.prefix, adopted)

    def _start(self, stack: ExitStack) -> None:
        settings = self.settings
        self._warnings = (*open_doors(self.config), *contention(self.config))
        for text in self._warnings:
            log.warning("%s", text)
        context = Context(
            namespace=self.project.namespace,
            bridge=settings.bridge,
            bridge_id=secrets.token_bytes(16),
            distro=settings.ros.distro,
            rights=rights(self.config),
            beat_ns=settings.beat_ns,
            debounce_ns=settings.diagnostics.debounce_ns,
            clock=self._clock,
        )
        beats = [
            Duty("sending heartbeats", settings.beat_ns, context.beat),
            Duty("checking the objects", _CHECK_NS, lambda: self.check(self._clock.monotonic_ns())),
        ]
        check_names(self.project)
        if self.backend is None:
            self.backend, self._choice = self._ros.open(self._types)
            stack.callback(self._close_backend)
        self._warnings += getattr(self.backend, "warnings", ())
        self._check_types(self.backend)
        duties = [Duty("checking ROS", _CHECK_NS, lambda: self.ask(self._clock.monotonic_ns()))]
        seen = partial(self.status, _JUST_NOW_NS)
        own = self._own = OwnTopics(
            self.project, self._ros, self.backend, seen, self._clock, stack, owned=self._owns_backend
        )
        self._warnings += own.warnings
        # Until here nothing in shared memory has been touched.
        self._leaving = tuple(leaving(self.project, context))
        for use in self._leaving:
            stack.callback(use.disconnect)
            use.connect(self.backend)
        retire_leftovers(self.project)
        carriers = self._carriers = Carriers(context, settings.tick_ns)
        self._streams = tuple(carriers.make(plan) for plan in self.project.plans)
        stack.callback(self._close_ports)
        for stream in self._streams:
            self._open_port(stream)
        self._types.use(self.project.plans)
        stack.callback(self._disconnect)
        for stream in self._streams:
            self._connect(stream)
        stack.callback(carriers.stop)
        carriers.replace((), self._streams)
        own.begin(self._streams)
        heartbeat = self._heartbeat = Rounds("rosplc-heartbeat", self._clock, *beats, *own.beats)
        heartbeat.start()
        stack.callback(heartbeat.stop)
        self._realtime.rest()
        reporter = Rounds("rosplc-reporter", self._clock, *duties, *own.duties)
        reporter.start()
        stack.callback(reporter.stop)

    def _check_types(self, backend: Backend) -> None:
        """Check that the backend can carry all types, if it has such a check. Raises as the backend does."""
        if (check := getattr(backend, "check", None)) is None:
            return
        topics = [plan for plan in self.project.topics if plan.own in ("", "pose")]
        names = {TF_MESSAGE if plan.own else plan.type_name for plan in topics}
        for plan in self.project.calls:
            names |= {f"{plan.type_name}{suffix}" for suffix in _ROS_TYPES[plan.kind]}
        for name in sorted(names):
            check(name)

    def _connect(self, stream: Carried) -> None:
        assert self.backend is not None and self._own is not None
        end: Any = self._own.ends.get(stream.plan.name, self.backend)
        stream.connect(end)

    def _close_backend(self) -> None:
        if self._owns_backend and self.backend is not None:
            self.backend.close()
            self.backend = None

    def _open_port(self, stream: Carried) -> None:
        try:
            stream.port.open()
        except ChannelError as error:
            if error.code not in _FOREIGN:
                raise
            stream.fail(self._clock.monotonic_ns(), error)

    def _close_ports(self) -> None:
        for stream in reversed(self._streams):
            stream.port.close()

    def _disconnect(self) -> None:
        for stream in reversed(self._streams):
            stream.disconnect()

    def stop(self) -> None:
        """Stop carrying messages; the objects keep their last state for the PLC and the next bridge."""
        was_running, self._started_ns = bool(self._started_ns), 0
        self._open.close()
        self._open = ExitStack()
        self._carriers = None
        if was_running:
            log.info("bridge %s stopped", self.settings.bridge)

    def reload(self, config: Config | Project | None = None) -> Changes:
        """Apply another configuration (None: the file, read again), completely or not at all.

        Topics that are the same in both are not disturbed. Objects are kept where possible. If a layout
        changed, a new object replaces the old one, which is retired, as is the object of a removed topic. The
        counters of a changed topic restart. Raises ConfigErrors if the configuration is wrong or changes keys
        that cannot change at run time (CFG012), RosplcError if it cannot be applied (SHM116, SHM117, ROS002
        …), and RuntimeError if the bridge has not been started or there is no file to read.
        """
        if not self._started_ns or self.backend is None or self._carriers is None:
            raise RuntimeError("this bridge has not been started")
        path = self.config.path
        if config is None and path is None:
            raise RuntimeError("this configuration was not read from a file")
        with self._changing:
            if config is None:
                self._file_seen, self._config_changed = self._file_state(), False
            try:
                if config is None:
                    assert path is not None
                    config = self.read(path)
                project = config if isinstance(config, Project) else resolve(config)
                changes = compare(self.project, project, self._types.used)
                self._exchange(project, changes)
            except Exception as error:
                self._refused = _first_line(error)
                log.error("the new configuration was refused; the previous one stays in use")
                for problem in str(error).splitlines():  # a record of the log is one line
                    log.error("%s", problem)
                raise
            self._refused = ""
        log.info("bridge %s has reloaded its configuration: %s", self.settings.bridge, changes)
        return changes

    def _exchange(self, project: Project, changes: Changes) -> None:
        assert self._carriers is not None
        before, self._types.store = self._types.store, project.store
        space = project.namespace
        exchange = Exchange(changes, self._streams, self._carriers, self._connect, space, self._clock)
        try:
            streams = exchange.run()
        except BaseException:
            self._types.store, self._streams = before, exchange.running
            raise
        order = [plan.name for plan in project.plans]
        self._streams = tuple(sorted(streams, key=lambda stream: order.index(stream.plan.name)))
        self._types.use(project.plans)
        self.project, self.config, self.settings = project, project.config, project.config.settings

    def run(self, stop: threading.Event) -> None:
        """Start, carry messages until ``stop`` is set, and stop. Raises RosplcError as :meth:`start`."""
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

    def status(self, within_ns: int = 0) -> BridgeStatus:
        """Return the state of the bridge and its topics; the topics' states may be ``within_ns`` old."""
        now = self._clock.monotonic_ns()
        notes = list(self._warnings)
        if self._config_changed:
            notes.append(f"configuration changed on disk; {_APPLY}")
        if self._ended:
            notes.append(self._ended)
        if self._refused:
            notes.append(f"the new configuration was refused; the previous one stays in use: {self._refused}")
        carriers, uses = self._carriers, [use.status(now) for use in self._streams if isinstance(use, Use)]
        busy = (carriers.busy_since_ns if carriers is not None else 0) or now
        if now - busy > _STUCK_NS:
            notes.append(f"publishing to ROS has been blocked for {(now - busy) / 1e9:.0f} s")
        return BridgeStatus(
            bridge=self.settings.bridge,
            backend=self.backend.name if self.backend is not None else "",
            backend_why=str(self._choice) if self._choice is not None else "",
            running=bool(self._started_ns),
            uptime_ns=now - self._started_ns if self._started_ns else 0,
            topics=tuple(
                stream.status(now, within_ns) for stream in self._streams if isinstance(stream, Stream)
            ),
            services=tuple(use for use in uses if isinstance(use, ServiceStatus)),
            actions=tuple(use for use in uses if isinstance(use, ActionStatus)),
            config_changed=self._config_changed,
            notes=tuple(notes),
        )

    def stuck(self, longest_ns: int) -> str:
        """Return which thread for messages or heartbeats has hung for ``longest_ns``, seconds; or empty."""
        carriers, heartbeat, now = self._carriers, self._heartbeat, self._clock.monotonic_ns()
        if not self._started_ns or carriers is None or heartbeat is None:
            return "the bridge has not been started"
        if now - heartbeat.turned_ns > longest_ns:
            return f"the heartbeat thread has been stuck for {(now - heartbeat.turned_ns) / 1e9:.0f} s"
        since = min(carriers.turned_ns, carriers.busy_since_ns or now)
        if now - since > longest_ns:
            return f"the thread that sends to ROS has been stuck for {(now - since) / 1e9:.0f} s"
        return ""

    # -- the work of heartbeat and reporter, on their threads

    def check(self, now_ns: int) -> None:
        """Check the objects, the PLC and the configuration file."""
        self._realtime.tidy()
        if self._changing.acquire(blocking=False):  # a reload may wait for ROS, and beats must not
            try:
                self._check(now_ns)
            finally:
                self._changing.release()

    def _check(self, now_ns: int) -> None:
        carriers = self._carriers
        if carriers is None:
            return
        for stream in self._streams:
            try:
                if stream.check(now_ns):
                    carriers.reopen(stream)
            except Exception as error:  # one topic's trouble is no other's
                log.exception("%s: the check failed", stream.plan.name)
                stream.fail(now_ns, error)
        if not self._config_changed and self._file_state() != self._file_seen:
            log.warning("%s: configuration changed on disk; %s", self.config.path, _APPLY)
            self._config_changed = True

    def ask(self, now_ns: int) -> None:
        """Query the ROS side for the state of each topic; this hangs if the ROS side hangs."""
        news = getattr(self.backend, "changed", lambda: None)()
        self._asked += 1
        for place, stream in enumerate((*self._streams, *self._leaving), self._asked):
            if place % STILL_TURNS and stream.still and news is not None and not stream.concerns(news):
                continue
            try:
                stream.ask(now_ns)
            except (RosplcError, ValueError) as error:  # an object or endpoint just closed
                log.debug("%s: %s", stream.plan.name, error)
        ended = ended_for_good(self.backend)
        if ended and not self._ended:
            self._ended = ended
            log.error("%s; the bridge no longer carries messages [ROS015]", ended)
            if self.on_ended is not None:
                self.on_ended(ended)

    def _file_state(self) -> tuple[int, int, int] | None:
        path = self.config.path
        if path is None:
            return None
        try:
            found = path.stat()
        except OSError:
            return (0, 0, 0)
        return found.st_ino, found.st_size, found.st_mtime_ns


def _first_line(error: Exception) -> str:
    lines = str(error).splitlines() or [type(error).__name__]
    return lines[0] + (f" (and {len(lines) - 1} more lines)" if len(lines) > 1 else "")
