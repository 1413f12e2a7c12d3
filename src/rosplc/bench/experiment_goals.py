"""What was aimed at, computed from what was measured and from nothing else."""

from __future__ import annotations

from dataclasses import dataclass

from rosplc.bench.arrangements import ONE_CORE, TWO_CORES
from rosplc.bench.found import Found
from rosplc.bench.markdown import cell_text
from rosplc.bench.results import Goal

__all__ = ["goals"]


@dataclass(frozen=True)
class _Aim:
    """One goal before it is measured.

    Attributes:
        what: Who is compared, and how both wait.
        arrangement: Where.
        above: The ratio's upper side; of several the one that makes the ratio smallest.
        below: Its lower side.
        limit: The ratio aimed at.
        key: What of each round is compared.
        at_least: Whether the limit is the least or the most.
        if_missed: What usually lies behind it.
    """

    what: str
    arrangement: str
    above: tuple[str, ...]
    below: str
    limit: float
    key: str = "run_us"
    at_least: bool = True
    if_missed: str = ""


_OWN_LOAD = 2.0
_TWO, _ONE = TWO_CORES.name, ONE_CORE.name
_PYTHON, _C = "rosplc-python", "rosplc-c"
_INTERPRETER = "most of a cycle in Python is the interpreter's on both sides, which no transport changes"
_KERNEL = "both sides mostly wait for the kernel to switch between two processes, which no transport changes"

_AIMS = (
    _Aim("two cores, C: libmodbus (blocks) ÷ rosplc (spins)", _TWO, ("libmodbus",), _C, 200.0),
    _Aim(
        "two cores, Python: pymodbus (blocks) ÷ rosplc (spins)",
        _TWO,
        ("pymodbus",),
        _PYTHON,
        250.0,
        if_missed=_INTERPRETER,
    ),
    _Aim(
        "two cores, Python: source's design (posix_ipc) ÷ rosplc, both spin",
        _TWO,
        ("semaphore-python",),
        _PYTHON,
        2.0,
        if_missed=_INTERPRETER,
    ),
    _Aim(
        "two cores, Python: the same, 99th percentiles",
        _TWO,
        ("semaphore-python",),
        _PYTHON,
        10.0,
        key="p99_us",
        if_missed="where other programs use the cores, the 99th percentile is theirs on both sides",
    ),
    _Aim(
        "two cores, Python: the faster of iceoryx2's two ÷ rosplc, both spin",
        _TWO,
        ("iceoryx2", "iceoryx2-blackboard"),
        _PYTHON,
        4.0,
        if_missed=_INTERPRETER,
    ),
    _Aim(
        "two cores, C: rosplc ÷ bare exchange of the same 200 bytes, both spin",
        _TWO,
        (_C,),
        "bare",
        1.6,
        at_least=False,
        if_missed="a slot's header is one more cache line to move; claim, sequence and head are looked at",
    ),
    _Aim(
        "one core, C: libmodbus ÷ rosplc, both block",
        _ONE,
        ("libmodbus",),
        _C,
        7.0,
        if_missed=_KERNEL,
    ),
    _Aim(
        "one core, Python: pymodbus ÷ rosplc, both block",
        _ONE,
        ("pymodbus",),
        _PYTHON,
        70.0,
        if_missed=_KERNEL,
    ),
    _Aim(
        "one core, Python: asyncua ÷ rosplc, both block",
        _ONE,
        ("asyncua",),
        _PYTHON,
        150.0,
        if_missed=_KERNEL,
    ),
)


def goals(found: Found, load: float = 0.0) -> tuple[Goal, ...]:
    """Return the goals with the median of the ratios of one run's rounds.

    Args:
        found: What was measured.
        load: The machine's load average during the run, which may be the reason of a miss.
    """
    return tuple(_goal(found, aim, load) for aim in _AIMS)


def _goal(found: Found, aim: _Aim, load: float) -> Goal:
    ratios = {
        name: ratio
        for name in aim.above
        if (ratio := found.ratio(aim.arrangement, name, aim.below, aim.key)) is not None
    }
    if not ratios:
        return Goal(aim.what, aim.limit, None, aim.at_least, "one of the two was not measured")
    name = min(ratios, key=lambda each: ratios[each])
    here = (found.median(aim.arrangement, each, aim.key) for each in (name, aim.below))
    values = " against ".join(f"{cell_text(value)} µs" for value in here)
    # The measurement itself makes up to two of it.
    busy = f"other programs ran, load average {load:.1f}" if load > _OWN_LOAD else ""
    reason = "; ".join(filter(None, (values, _floor(found, aim), aim.if_missed, busy)))
    return Goal(aim.what, aim.limit, ratios[name], aim.at_least, reason)


def _floor(found: Found, aim: _Aim) -> str:
    """Say what of a sleeping exchange in Python no transport can take away, as far as it was measured."""
    switches = found.median(_ONE, _C)
    if aim.arrangement != _ONE or aim.below != _PYTHON or switches is None:
        return ""
    return f"the same exchange takes {cell_text(switches)} µs in C, and the rest is the interpreter's"
