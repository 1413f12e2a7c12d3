"""Running an examination so that nothing it meets can stop the doctor.

A file system or a network name may not answer at all. Each examination therefore runs in its own thread,
which is given up after its time; what it had found until then is kept.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

from rosplc.doctor.finding import Area, Finding, Level
from rosplc.doctor.kinds import found
from rosplc.errors import RosplcError


@dataclass(frozen=True)
class Probe:
    """One examination: what it looks at, as a person would say it, and how many seconds it may take.

    ``look`` returns, or yields, what it finds. If a ``vital`` one fails or hangs, that is an error.
    """

    what: str
    area: Area
    look: Callable[[], Iterable[Finding]]
    seconds: float = 5.0
    vital: bool = False


def run_probe(probe: Probe) -> list[Finding]:
    """Return what an examination finds; one that fails or hangs is a finding itself, never silence."""
    seen: list[Finding] = []
    failed: list[BaseException] = []

    def work() -> None:
        try:
            for finding in probe.look():
                seen.append(finding)
        except BaseException as error:
            failed.append(error)

    thread = threading.Thread(target=work, name=f"doctor: {probe.what}", daemon=True)
    thread.start()
    thread.join(probe.seconds)
    result = list(seen)
    level = Level.ERROR if probe.vital else None
    if thread.is_alive() or failed:
        late = thread.is_alive() or (isinstance(failed[0], TimeoutError) and not failed[0].strerror)
        why = f"no answer within {probe.seconds:g} s" if thread.is_alive() else _words(failed[0], late=late)
        code = "DOC002" if late else "DOC001"
        result.append(found(code, f"could not check {probe.what}: {why}", level=level))
    # What the doctor could not do is shown beside what it did: people read by area.
    return [replace(each, area=probe.area) if each.area is Area.DOCTOR else each for each in result]


def _words(error: BaseException, *, late: bool) -> str:
    if isinstance(error, RosplcError):
        return f"{error.what} [{error.code}]"
    if isinstance(error, OSError) and error.strerror:
        return f"{error.strerror}: {error.filename}" if error.filename else error.strerror
    return str(error) if late else f"{type(error).__name__}: {error}"
