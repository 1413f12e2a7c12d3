"""Run sections one after the other: what they get to measure with, and a folder that is gone afterwards."""

from __future__ import annotations

import contextlib
import fcntl
import importlib.util
import os
import re
import shutil
import stat
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, field
from functools import partial
from pathlib import Path

from rosplc.errors import RosplcError, SetupError
from rosplc_bench import machine
from rosplc_bench.report import Failure, Measured, Report, Section, Skip


class Missing(Exception):
    """Something optional is missing on this machine: what needs it is skipped, with the reason.

    Args:
        reason: What, in a few words.
        remedy: The command that would install it, or what else would help.
    """

    def __init__(self, reason: str, remedy: str = "") -> None:
        super().__init__(reason)
        self.reason = reason
        self.remedy = remedy


REMEDY = "pip install rosplc-bench"


def need(package: str) -> None:
    """Raise Missing if a package is not installed, or lacks what this release uses of it."""
    if importlib.util.find_spec(package) is None:
        raise Missing(f"the Python package {package} is missing", REMEDY)
    if package == "pymodbus":
        try:
            from pymodbus.simulator import SimDevice

            SimDevice.__dataclass_fields__["action"]
        except (ImportError, AttributeError, KeyError):
            raise Missing("the Python package pymodbus is too old", f"{REMEDY} --upgrade") from None


@dataclass(frozen=True)
class Effort:
    """How much is measured.

    Attributes:
        name: "quick", "default" or "full".
        rounds: How often the contenders take turns.
        turn_seconds: About how long one turn of one contender may take.
        slow_rounds: The same in arrangements where a turn is mostly waiting.
        slow_turn_seconds: And about how long such a turn may take.
    """

    name: str
    rounds: int
    turn_seconds: float
    slow_rounds: int
    slow_turn_seconds: float


EFFORTS = {
    effort.name: effort
    for effort in (
        Effort("quick", 1, 0.5, 1, 0.15),
        Effort("default", 3, 3.5, 1, 0.6),
        Effort("full", 7, 6.0, 1, 11.0),
    )
}
"""By name. On a quiet machine with two cores quick takes half a minute, the default two, full twelve."""


@dataclass
class Context:
    """What one section measures with.

    Attributes:
        effort: How much to measure.
        scratch: A folder of this run in /dev/shm, for objects; it is gone at the end.
        cache: Where compiled programs are kept.
        cores: The processor cores that this process may use, two at most: for A and for B.
        only: Names of contenders; empty for all.
        notify: Called with steps done, steps in all, and what is being measured.
    """

    effort: Effort
    scratch: Path
    cache: Path
    cores: tuple[int, ...]
    only: tuple[str, ...] = ()
    notify: Callable[[int, int, str], None] = lambda done, total, what: None
    skips: list[Skip] = field(default_factory=list)
    failures: list[Failure] = field(default_factory=list)

    def wants(self, contender: str) -> bool:
        """Return whether a contender is to be measured."""
        return not self.only or contender in self.only

    def skip(self, what: str, reason: str, remedy: str = "") -> None:
        """Note what cannot be measured here; the same thing counts once."""
        found = Skip(what, reason, remedy)
        if found not in self.skips:
            self.skips.append(found)

    def fail(self, what: str, reason: str) -> None:
        """Note what went wrong; the run continues, and its report is not good."""
        self.failures.append(Failure(what, reason))

    @contextlib.contextmanager
    def leaving_out(self, what: str) -> Iterator[None]:
        """Note a :class:`Missing` in the block as skipped, a SetupError as failed; the rest is measured."""
        try:
            yield
        except Missing as missing:
            self.skip(what, missing.reason, missing.remedy)
        except SetupError as error:
            self.fail(what, error.what)


MEMORY = Path("/dev/shm")
PREFIX = "rosplc-bench-"
NAMES_FILE = "names"
"""A file in a contender's folder: how those files begin that it has to put directly into /dev/shm."""

_LOCK = "lock"
_NAME = r"\Arb[0-9a-f]{8}_\Z"
_YOUNG_SECONDS = 60.0


@contextlib.contextmanager
def scratch_folder(memory: Path = MEMORY) -> Iterator[Path]:
    """Give a folder for what this run shares, and remove it at the end; remove those of dead runs first.

    Raises:
        SetupError: SYS008, shared memory cannot be used.
    """
    sweep(memory)
    try:
        folder = Path(tempfile.mkdtemp(prefix=PREFIX, dir=memory))
    except OSError as error:
        raise SetupError("SYS008", f"{error.strerror}", where=str(memory)) from error
    try:
        # Held as long as this process lives, however it ends; no child inherits it.
        with (folder / _LOCK).open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            yield folder
    finally:
        _remove(folder)


def sweep(memory: Path = MEMORY) -> list[Path]:
    """Remove what runs have left that were killed; return their folders."""
    removed = []
    for folder in memory.glob(f"{PREFIX}*"):
        with contextlib.suppress(OSError):
            status = folder.lstat()
            if stat.S_ISDIR(status.st_mode) and status.st_uid == os.geteuid() and not _alive(folder):
                _remove(folder)
                removed.append(folder)
    return removed


def _alive(folder: Path) -> bool:
    try:
        descriptor = os.open(folder / _LOCK, os.O_RDWR | os.O_NOFOLLOW | os.O_CLOEXEC)
    except FileNotFoundError:
        # Between making a folder and locking it lies a moment.
        return time.time() - folder.stat().st_mtime < _YOUNG_SECONDS
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    finally:
        os.close(descriptor)
    return False


def _remove(folder: Path) -> None:
    beside = [f"sem.{folder.name}."]  # semaphores know no folders; neither do some contenders' files
    for file in folder.glob(f"*/{NAMES_FILE}"):
        with contextlib.suppress(OSError):
            beside += re.findall(_NAME, file.read_text())
    for prefix in beside:
        for path in folder.parent.iterdir():
            if path.name.startswith(prefix):
                with contextlib.suppress(OSError):
                    path.unlink()
    shutil.rmtree(folder, ignore_errors=True)


def run(
    sections: Sequence[Section],
    effort: Effort,
    *,
    only: Sequence[str] = (),
    notify: Callable[[Section, int, int, str], None] | None = None,
) -> Report:
    """Measure sections and return the report.

    Args:
        sections: What to measure, in order.
        effort: How much.
        only: Names of contenders; empty for all.
        notify: Called with the section, steps done, steps in all, and what is being measured.

    Raises:
        SetupError: SYS008, shared memory cannot be used.
    """
    facts = machine.describe()
    cores = tuple(sorted(os.sched_getaffinity(0))[:2])
    measured = []
    with scratch_folder() as folder:
        for section in sections:
            context = Context(effort, folder, cache_folder(), cores, tuple(only))
            if notify is not None:
                context.notify = partial(notify, section)
            began = time.monotonic()
            try:
                data = section.run(context)
            except RosplcError as error:  # what the other sections find is kept
                context.fail(section.name, str(error))
                data = {}
            seconds = round(time.monotonic() - began, 2)
            measured.append(
                Measured(section.name, seconds, data, tuple(context.skips), tuple(context.failures))
            )
    facts["load_after"] = machine.load_average()
    return Report(facts, {"effort": asdict(effort), "only": list(only)}, tuple(measured))


def cache_folder() -> Path:
    """Return where compiled programs are kept: ``$XDG_CACHE_HOME/rosplc/bench``."""
    base = os.environ.get("XDG_CACHE_HOME", "")
    return (Path(base) if base.startswith("/") else Path.home() / ".cache") / "rosplc" / "bench"
