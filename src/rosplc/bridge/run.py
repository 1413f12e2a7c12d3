"""Runs a bridge as a program, until it is asked to stop."""

from __future__ import annotations

import logging
import os
import resource
import select
import signal
import threading
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from functools import partial
from pathlib import Path
from types import FrameType

from rosplc.bridge.engine import Bridge
from rosplc.bridge.port import log
from rosplc.bridge.status import BridgeStatus, Level
from rosplc.clock import SYSTEM, Clock
from rosplc.config.apart import apart
from rosplc.config.resolve import Project, load_project
from rosplc.config.yaml_source import may_pass
from rosplc.errors import BackendError, ConfigError, RosplcError, SetupError
from rosplc.harmless import log_to_stderr
from rosplc.ros import RosArguments

_log = logging.getLogger("rosplc.run")
_FILES = 65536
_SUMMED = ("received", "published", "lost", "refused")
_SAME_SIGNAL_S = 0.2
_RECENT_NS = 1_000_000_000  # how old a topic's state in a status line may be
_LOOK_AGAIN_S = 0.1  # a signal's handler does not end a select early


@contextmanager
def stop_on_signals(tell: Callable[[int], None] | None = None) -> Iterator[threading.Event]:
    """Provide an event that SIGTERM, SIGINT and a closed terminal (SIGHUP) set; for the main thread.

    A second signal ends the process at once, unless it follows within 0.2 s: timeout(1) and launch tools send
    each signal to the process and its group. SIGHUP stays ignored if the parent process ignores it (nohup).
    ``tell`` is called in the handler with each signal's number. It is also called for SIGUSR1, and for SIGHUP
    without a terminal, which do not set the event; without ``tell``, these two are only logged.
    """
    event = threading.Event()

    def leave(number: int, _frame: FrameType | None) -> None:
        if event.is_set():
            return
        event.set()
        if tell is not None:
            tell(number)
        # The other threads carry on; a repetition comes in here. Not time.sleep(), which sleeps until a time
        # of day under libfaketime and fails if that lies in the past.
        select.select([], [], [], _SAME_SIGNAL_S)
        for number in (signal.SIGTERM, signal.SIGINT):
            if number in before:
                signal.signal(number, signal.SIG_DFL)

    def hang_up(number: int, _frame: FrameType | None) -> None:
        if tell is not None:
            tell(number)
        else:
            log.warning("the reload signal is ignored; restart the bridge to apply a changed configuration")

    wanted = {
        signal.SIGTERM: leave,
        # A shell without job control ignores SIGINT for what it starts with &, and `kill -INT` should work.
        signal.SIGINT: leave,
        signal.SIGHUP: leave if on_terminal() else hang_up,
        signal.SIGUSR1: hang_up,
    }
    if signal.getsignal(signal.SIGHUP) is signal.SIG_IGN:
        del wanted[signal.SIGHUP]
    before = {number: signal.signal(number, handler) for number, handler in wanted.items()}
    try:
        yield event
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def on_terminal() -> bool:
    """Return whether this process has a controlling terminal, which sends SIGHUP when it is closed."""
    try:
        os.close(os.open("/dev/tty", os.O_RDONLY | os.O_NOCTTY | os.O_CLOEXEC))
    except OSError:
        return False
    return True


def pause(stop: threading.Event, seconds: float, clock: Clock = SYSTEM) -> bool:
    """Wait at most ``seconds`` until ``stop`` is set; return whether it is set. For the main thread."""
    # A signal's handler sets the event there: in ``Event.wait`` it could interrupt the moment in which that
    # holds the event's lock, and wait for the lock in ``Event.set`` for ever.
    end = clock.monotonic_ns() + round(seconds * 1e9)
    while not stop.is_set() and (rest := (end - clock.monotonic_ns()) / 1e9) > 0:
        select.select([], [], [], min(rest, _LOOK_AGAIN_S))
    return stop.is_set()


def run_until_signal(
    bridge: Bridge, report: Callable[[BridgeStatus], None] | None = None, seconds: float | None = None
) -> None:
    """Run a bridge until SIGTERM or SIGINT arrives (:func:`stop_on_signals`); SIGUSR1 reloads its file.

    Without a terminal, SIGHUP also reloads the file, as service managers expect; with a terminal, it ends the
    bridge. ``report`` gets the bridge's status every ``seconds``. Raises as :meth:`Bridge.start`, and
    BackendError ROS015 if the ROS side has ended permanently; the program may be started again.
    """
    with News() as news:
        bridge.on_ended = news.put
        with stop_on_signals(news.put) as stop, bridge:
            while not stop.is_set():
                items = news.wait(seconds if report is not None else None)
                if not items and report is not None:
                    report(bridge.status(_RECENT_NS))
                for item in items:
                    if isinstance(item, str):
                        raise BackendError("ROS015", item)
                    if item in (signal.SIGHUP, signal.SIGUSR1) and not stop.is_set():
                        _reload(bridge)


class News:
    """A queue of items and signals for the main thread; a context manager.

    A signal may arrive just before a thread starts to wait for a lock or a queue: its handler would then run
    only after the wait, which may never end. The interpreter writes to this pipe when a signal arrives.
    """

    def __init__(self, clock: Clock = SYSTEM) -> None:
        self._clock = clock
        self._items: deque[int | str] = deque()
        self._read, self._write = os.pipe2(os.O_NONBLOCK | os.O_CLOEXEC)
        self._before = -1

    def __enter__(self) -> News:
        self._before = signal.set_wakeup_fd(self._write, warn_on_full_buffer=False)
        return self

    def __exit__(self, *_: object) -> None:
        signal.set_wakeup_fd(self._before)
        # The descriptors stay until nobody refers to this: another thread may be about to put something.

    def __del__(self) -> None:
        os.close(self._read)
        os.close(self._write)

    def put(self, item: int | str) -> None:
        """Add an item; callable from any thread and from signal handlers."""
        self._items.append(item)
        with suppress(BlockingIOError):  # full: the reader wakes up anyway
            os.write(self._write, b"+")

    def wait(self, seconds: float | None) -> list[int | str]:
        """Return the items that have arrived; an empty list if none has within the time."""
        now = self._clock.monotonic_ns
        end = None if seconds is None else now() + round(seconds * 1e9)
        while not self._items:
            rest = None if end is None else (end - now()) / 1e9
            if rest is not None and rest <= 0:
                return []
            if select.select([self._read], [], [], rest)[0]:
                with suppress(BlockingIOError):
                    os.read(self._read, 4096)
        return [self._items.popleft() for _ in range(len(self._items))]


def _reload(bridge: Bridge) -> None:
    if bridge.config.path is None:
        log.warning("nothing to reload: this configuration was not read from a file")
        return
    try:
        bridge.reload()
    except RosplcError:
        pass  # it is logged, and part of the status
    except Exception:
        log.exception("the configuration could not be reloaded")


def _load(path: Path, _: RosArguments | None) -> Project:
    return load_project(path)


def run_bridge(
    config: Path,
    *,
    status_seconds: float | None,
    level: int = logging.INFO,
    arguments: RosArguments | None = None,
    supervised: Callable[[Bridge], AbstractContextManager[object]] = nullcontext,
    load: Callable[[Path, RosArguments | None], Project] = _load,
) -> None:
    """Run a bridge until SIGINT or SIGTERM; a second one ends the process at once; SIGUSR1 reloads the file.

    A status line is logged every ``status_seconds`` (None: never). ``supervised`` is a context around the
    running bridge, such as a service manager's watchdog; ``load``, a module-level function, reads the
    configuration in a separate process. Raises RosplcError if the configuration is invalid, the bridge cannot
    start, or the ROS side has ended permanently (ROS015). Under a service manager, raises SetupError SYS015
    if something is missing that may appear later.
    """
    log_to_stderr(level)
    _allow_many_files()
    try:
        bridge = Bridge(apart(load, config, arguments), arguments=arguments)
        bridge.read = partial(apart, load_project)
        with supervised(bridge):
            run_until_signal(bridge, None if status_seconds is None else _Reporter().report, status_seconds)
    except ConfigError as error:
        # A service is not tried again where its configuration is wrong, but a disk may be mounted later.
        if "NOTIFY_SOCKET" not in os.environ or not may_pass(error):
            raise
        raise SetupError("SYS015", error.what, where=error.where) from None


def _allow_many_files() -> None:
    """Raise the limit of open files to the user's maximum: each topic uses one, and 1024 is a usual limit."""
    _, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = _FILES if most == resource.RLIM_INFINITY else min(most, _FILES)
    with suppress(OSError, ValueError):
        resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, most))


class _Reporter:
    """Logs the status line, and each topic, service and action whose state has changed."""

    def __init__(self) -> None:
        self._before: dict[str, str] = {}

    def report(self, status: BridgeStatus) -> None:
        topics = status.topics
        fine = sum(topic.judgement[0] == 0 for topic in topics)
        sums = [sum(getattr(topic, name) for topic in topics) for name in _SUMMED]
        uses = (*status.services, *status.actions)
        well = sum(use.judgement[0] == 0 for use in uses)
        calls = f"; {well} of {len(uses)} services and actions fine" if uses else ""
        text = "status: %d of %d topics fine; in %d, out %d, lost %d, refused %d%s"
        _log.info(text, fine, len(topics), *sums, calls)
        judged = {topic.topic: topic.judgement for topic in topics} | {
            use.name: use.judgement for use in uses
        }
        for name, (level, message) in judged.items():
            # Rates and ages differ each time and are no news; a change of level is, and so is its reason.
            same = level.name if level in (Level.OK, Level.STALE) else f"{level.name}: {message}"
            if self._before.get(name, "OK") != same:
                text = level.name if level == Level.OK else f"{level.name}: {message}"
                _log.log(logging.INFO if level == Level.OK else logging.WARNING, "%s: %s", name, text)
            self._before[name] = same
