"""What is done to the cell: a table of faults, and one function for each kind.

A function does it and undoes it; when it returns, nothing is in the way any more. What a fault makes
impossible to account for is in the table: nothing counts a message that was under way in a process that dies.
"""

from __future__ import annotations

import contextlib
import os
import random
import resource
import signal
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from rosplc import attach
from rosplc.shm.classic import Semaphore
from tests.soak.cell import SHM, Cell
from tests.soak.messages import CAPACITY, CLASSIC, IN, OUT, TOPICS
from tests.soak.processes import proc_status

_FAKETIME = [Path(f"/usr/lib/{arch}-linux-gnu/faketime/libfaketimeMT.so.1") for arch in ("x86_64", "aarch64")]


_PARTS = ("bridge", "plc", "publisher", "subscriber")


@dataclass(frozen=True)
class Fault:
    """One kind of fault.

    Attributes:
        name: What it is called.
        inflict: Does it, and undoes it.
        accounted: The topics on which every missing message must be counted, as far as the parts that count
            on its way live on.
        ends: The parts whose process it ends.
        may_end: The bridge may end of it, and is started again.
        missing: Returns why it cannot be tried in a cell; empty if it can.
    """

    name: str
    inflict: Callable[[Cell, random.Random], None]
    accounted: tuple[str, ...] = TOPICS
    ends: frozenset[str] = frozenset()
    may_end: bool = False
    missing: Callable[[Cell], str] = lambda _cell: ""


def _kill(name: str, cell: Cell, dice: random.Random) -> None:
    """Kill -9, and a new process at once, or after a while."""
    cell.parts[name].kill()
    time.sleep(dice.choice((0.0, 0.0, 0.4)))
    cell.parts[name].start()


def _restart(name: str, cell: Cell, dice: random.Random) -> None:
    """SIGTERM, which everything of rosplc's ends by with status 0, and a new process."""
    part = cell.parts[name]
    if not part.terminate():
        raise AssertionError(f"{name} did not end within a minute of SIGTERM")
    if part.status and name != "hub":
        raise AssertionError(f"{name} ended with status {part.status} after SIGTERM")
    part.start()


@contextlib.contextmanager
def _stopped(cell: Cell, name: str) -> Iterator[None]:
    cell.parts[name].send(signal.SIGSTOP)
    yield
    cell.parts[name].send(signal.SIGCONT)


@contextlib.contextmanager
def _flood(cell: Cell) -> Iterator[None]:
    """Ten times the configured rate, in both directions."""
    cell.counters.control["flood"] = 10
    yield
    cell.counters.control["flood"] = 1


def _stop(name: str, cell: Cell, dice: random.Random) -> None:
    with _stopped(cell, name):
        time.sleep(dice.uniform(0.05, 1.2))


def _kill_two(cell: Cell, dice: random.Random) -> None:
    """Two of the parts die at the same moment."""
    names = dice.sample(sorted(cell.parts), 2)
    for name in names:
        cell.parts[name].send(signal.SIGKILL)
    for name in names:
        cell.parts[name].replace()


def _kill_beside_stopped(cell: Cell, dice: random.Random) -> None:
    """One part dies and comes back while another is stopped."""
    dead, still = dice.sample(sorted(cell.parts), 2)
    with _stopped(cell, still):
        time.sleep(dice.uniform(0.0, 0.3))
        cell.parts[dead].replace()
        time.sleep(dice.uniform(0.0, 0.8))


def _flooded(cell: Cell, dice: random.Random) -> None:
    with _flood(cell):
        time.sleep(dice.uniform(0.5, 1.5))


def _stop_in_flood(cell: Cell, dice: random.Random) -> None:
    """The bridge is stopped while ten times as much comes from both sides."""
    with _flood(cell), _stopped(cell, "bridge"):
        time.sleep(dice.uniform(0.5, 2.0))


def _hang(cell: Cell, dice: random.Random) -> None:
    """A subscriber is stopped while ten times as much comes as it is used to."""
    with _stopped(cell, "subscriber"):
        with _flood(cell):
            time.sleep(dice.uniform(1.0, 2.0))
        # The PLC's way may not depend on a subscriber that hangs.
        marks = cell.marks()
        reached = "the bridge carries to the PLC while a subscriber hangs"
        cell.wait(lambda: not set(cell.flows(marks)) & set(IN), reached)


def _remove(everything: bool, cell: Cell, dice: random.Random) -> None:
    """Objects are unlinked: some, or all with their lock files."""
    if everything:
        cell.remove(path.name for path in SHM.glob(f"*{cell.prefix}*"))
    else:
        names = [name for name in sorted(cell.objects()) if not cell.is_classic(name)]
        cell.remove(dice.sample(names, dice.randint(1, len(names))))
    cell.wait(lambda: cell.expected_objects() <= cell.objects(), "the objects are made again")
    if everything:
        cell.counters.control["reopen"] += 1  # classic objects cannot tell a PLC that they were replaced


def _shared(cell: Cell) -> str:
    return "" if cell.private else "needs a /dev/shm of its own: root, and mount namespaces"


def _full(leave: int, cell: Cell, dice: random.Random) -> None:
    """No room in shared memory, but for some bytes, while objects have to be made again."""
    filler = SHM / "filler"
    channels = {cell.namespace.object_name(topic) for topic in TOPICS}

    def filled_up() -> bool:
        before = cell.said("SHM117")
        with filler.open("ab") as file, contextlib.suppress(OSError):
            room = os.statvfs(SHM)
            free = room.f_bavail * room.f_frsize - leave
            if free > 0:
                os.posix_fallocate(file.fileno(), file.tell(), free)
        # What is removed stays mapped, and its memory in use: there is really no room.
        cell.remove(channels)
        seen = "the bridge sees what was removed"
        cell.wait(lambda: cell.said("SHM117") > before or channels <= cell.objects(), seen)
        return cell.said("SHM117") > before

    try:
        # What was removed in the rounds before may still be mapped, and give its room back only now: the
        # objects are then made again without a message, and it has to be filled up and tried once more.
        cell.wait(filled_up, "the bridge reports that there is no room")
    finally:
        filler.unlink(missing_ok=True)


def _limit(what: str, cell: Cell, dice: random.Random) -> None:
    """The bridge may open no further file, or take no further memory, while its objects are removed."""
    bridge = cell.parts["bridge"]
    if what == "descriptor":
        kind, now = resource.RLIMIT_NOFILE, len(os.listdir(f"/proc/{bridge.pid}/fd"))
    else:
        kind, now = resource.RLIMIT_AS, 1024 * int(proc_status(bridge.pid)["VmSize"].split()[0])
    before = resource.prlimit(bridge.pid, kind)
    resource.prlimit(bridge.pid, kind, (now, before[1]))
    cell.remove([cell.namespace.object_name(topic) for topic in OUT])
    time.sleep(dice.uniform(1.2, 2.5))
    if bridge.alive:
        resource.prlimit(bridge.pid, kind, before)
    cell.ensure()


def _zenoh_receives(cell: Cell) -> str:
    lost = "the Zenoh library's receiving thread ends for good where memory cannot be had"
    return lost if cell.backend == "zenoh" else ""


def _faketime(_cell: Cell) -> str:
    return "" if any(path.exists() for path in _FAKETIME) else "Debian package faketime is missing"


def _clock(name: str, cell: Cell, dice: random.Random) -> None:
    """The wall clock of a process jumps, by an hour, a year, back; the machine's own never does."""
    part = cell.parts[name]
    clock = cell.folder / f"clock-{name}"
    clock.write_text("+0")
    honest = dict(part.environment)
    part.environment |= {
        "LD_PRELOAD": str(next(path for path in _FAKETIME if path.exists())),
        "FAKETIME_TIMESTAMP_FILE": str(clock),
        "FAKETIME_CACHE_DURATION": "1",
        "DONT_FAKE_MONOTONIC": "1",
        "FAKETIME_DONT_FAKE_MONOTONIC": "1",
    }
    part.through = "tests.soak.stepped"
    try:
        part.terminate()
        part.start()
        cell.await_flow(cell.marks())
        for step in dice.sample((3600, -3600, 365 * 86400, -30), 2):
            clock.write_text(f"{step:+d}")
            cell.wait(_shifted(cell, name, step), f"the {name}'s clock is {step:+d} s off")
            cell.await_flow(cell.marks())
    finally:
        part.environment, part.through = honest, ""
        part.terminate()
        part.start()
        for path in SHM.glob("*faketime_s*") if cell.private else ():
            path.unlink()  # libfaketime's own, which it leaves if its process ends by a signal


def _shifted(cell: Cell, part: str, step: int) -> Callable[[], bool]:
    clock = "stamp_ns" if part == "bridge" else "publisher_clock_ns"

    def is_shifted() -> bool:
        off = int(cell.counters.control[clock]) / 1e9 - time.time()
        return abs(off - step) < 10

    return is_shifted


def _reload(cell: Cell, dice: random.Random) -> None:
    """The configuration is changed while running: topics added, removed, changed."""
    extra = cell.extra
    for topic in dice.sample(sorted(extra), dice.randint(0, len(extra))):
        del extra[topic]
    for topic in sorted(extra):
        extra[topic] = _entry(dice)
    for number in dice.sample(range(8), dice.randint(0, 3)):
        extra[f"/soak/extra{number}"] = _entry(dice)
    # The two topics that are not accounted for change, too: in manner, or in their layout.
    manner = dice.choice((", qos: {depth: 30000}", ", rate_limit: 1ms", ", stale_after: 3s", ""))
    layout = f", limits: {{data: {CAPACITY + dice.randint(0, 8)}}}"
    cell.options["/soak/in_newest"] = manner
    # Structured Text is compiled for one layout: there the manner changes alone.
    cell.options["/soak/out_newest"] = layout if cell.plc == "python" else manner.replace("30000", "5000")
    cell.write_config()
    cell.hang_up("has reloaded its configuration")
    cell.wait(lambda: cell.objects() == cell.expected_objects(), "objects are those of the new file")
    for topic in (name for name, entry in extra.items() if "to: ros" in entry):
        _is_carried(cell, topic)


def _is_carried(cell: Cell, topic: str) -> None:
    with attach(topic, prefix=cell.prefix, write=True) as channel:
        number = channel.write({})
        cell.wait(lambda: channel.snapshot().readers[0].taken == number, f"the bridge takes from {topic}")


def _entry(dice: random.Random) -> str:
    kind = dice.choice(("std_msgs/msg/String", "geometry_msgs/msg/Twist", "sensor_msgs/msg/JointState"))
    limits = f", limits: {{string: {dice.randint(8, 200)}}}" if "Twist" not in kind else ""
    return f"{{type: {kind}, to: {dice.choice(('plc', 'ros'))}{limits}}}"


def _refused(cell: Cell, dice: random.Random) -> None:
    """A file that is wrong, or changes what cannot change, is refused; nothing happens."""
    cell.write_config(dice.choice(("tick: 3ms", "tick: nonsense", "nonsense: 1", "topics: [")))
    cell.hang_up("the new configuration was refused")
    cell.write_config()
    cell.hang_up("has reloaded its configuration")


def _nothing(cell: Cell, dice: random.Random) -> None:
    """Nothing happens: what is missing then is missing for no reason."""
    time.sleep(dice.uniform(0.2, 1.0))


def _stand_still_inside(cell: Cell) -> None:
    """Have the PLC stop (SIGSTOP) inside the next lock that it gets."""
    cell.counters.control["stop_inside"] = 1
    stat = Path(f"/proc/{cell.parts['plc'].pid}/stat")
    cell.wait(
        lambda: stat.read_text().rpartition(")")[2].split()[0] == "T", "the PLC stands still inside a lock"
    )


def _held(cell: Cell, topic: str) -> Semaphore:
    """Take a classic topic's lock, as a third program that shares the memory does."""
    lock = Semaphore(cell.classic_name(topic))
    cell.wait(lock.enter, "a third program gets the lock")
    return lock


def _kill_inside(cell: Cell, dice: random.Random) -> None:
    """Kill -9 of the PLC inside a lock."""
    _stand_still_inside(cell)
    cell.parts["plc"].replace()


def _kill_bridge_inside(cell: Cell, dice: random.Random) -> None:
    """Kill -9 of the bridge while a lock is taken and never given back: the semaphore knows no difference."""
    lock = _held(cell, dice.choice(CLASSIC))
    cell.parts["bridge"].replace()
    lock.close()


def _stranger_dies(cell: Cell, dice: random.Random) -> None:
    """A third program takes a lock and is gone."""
    _held(cell, dice.choice(CLASSIC)).close()


def _stop_inside(cell: Cell, dice: random.Random) -> None:
    """SIGSTOP of the PLC inside a lock, for less than after what it counts as dead."""
    _stand_still_inside(cell)
    time.sleep(dice.uniform(0.05, 0.8))
    cell.parts["plc"].send(signal.SIGCONT)


def _online_change(cell: Cell, dice: random.Random) -> None:
    """An online change moves every instance of the PLC's program."""
    for _ in range(dice.randint(1, 3)):
        cell.counters.control["online_change"] += 1
        before = int(cell.counters.control["plc_scans"])
        cell.wait(lambda: cell.counters.control["plc_scans"] > before + 2, "the PLC goes on")  # noqa: B023


_NONE: tuple[str, ...] = ()
_ALL_PARTS = frozenset({*_PARTS, "hub"})


def _of_parts(parts: tuple[str, ...]) -> tuple[Fault, ...]:
    """Return kill, restart and stop of each."""
    return (
        *(Fault(f"kill -9 {part}", partial(_kill, part), ends=frozenset({part})) for part in parts),
        *(Fault(f"restart {part}", partial(_restart, part), ends=frozenset({part})) for part in parts),
        *(Fault(f"stop {part}", partial(_stop, part)) for part in parts),
    )


def _of_limit(what: str, missing: Callable[[Cell], str]) -> Fault:
    ends = frozenset({"bridge"})
    return Fault(f"no further {what}", partial(_limit, what), _NONE, ends, may_end=True, missing=missing)


FAULTS: tuple[Fault, ...] = (
    *_of_parts(_PARTS),
    Fault("kill -9 two at once", _kill_two, _NONE, _ALL_PARTS),
    Fault("kill -9 beside a stopped one", _kill_beside_stopped, _NONE, _ALL_PARTS),
    Fault("flood", _flooded),
    Fault("stop bridge in a flood", _stop_in_flood),
    Fault("subscriber hangs in a flood", _hang, IN),
    Fault("objects removed", partial(_remove, False), _NONE),
    Fault("all files removed", partial(_remove, True), _NONE),
    Fault("shared memory full", partial(_full, 0), _NONE, missing=_shared),
    Fault("shared memory nearly full", partial(_full, 16384), _NONE, missing=_shared),
    _of_limit("descriptor", lambda _cell: ""),
    _of_limit("memory", _zenoh_receives),
    *(
        Fault(f"clock steps, {part}", partial(_clock, part), _NONE, frozenset({part}), missing=_faketime)
        for part in ("bridge", "publisher")
    ),
    Fault("configuration reloaded", _reload, ("/soak/in", "/soak/out")),
    Fault("wrong configuration refused", _refused),
    Fault("nothing", _nothing),
)
HUB_FAULTS = _of_parts(("hub",))
"""What happens to a router or a master, where there is one."""
PLC_FAULTS: tuple[Fault, ...] = (
    Fault("kill -9 plc inside a lock", _kill_inside, ends=frozenset({"plc"})),
    Fault("kill -9 bridge, a lock taken", _kill_bridge_inside, _NONE, frozenset({"bridge"})),
    Fault("a third program dies inside a lock", _stranger_dies),
    Fault("stop plc inside a lock", _stop_inside),
    Fault("online change", _online_change),
)
"""What happens to a PLC that executes Structured Text."""


def faults_for(cell: Cell) -> tuple[Fault, ...]:
    """Return the faults that there are with a cell's backend and PLC."""
    return (*FAULTS, *(HUB_FAULTS if "hub" in cell.parts else ()), *(PLC_FAULTS if cell.plc == "st" else ()))
