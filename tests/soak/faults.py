"""What is done to the cell: one class for each kind of fault.

``inflict`` does it and undoes it; when it returns, nothing stands in the way any more. What a fault
makes impossible to account for, it says: a message that was under way in a process that dies is counted
by nobody.
"""

from __future__ import annotations

import contextlib
import os
import random
import resource
import signal
import time
from collections.abc import Callable
from pathlib import Path

from rosplc import attach
from rosplc.shm.semaphore import Semaphore
from tests.soak.cell import SHM, Cell
from tests.soak.messages import CAPACITY, CLASSIC, IN, OUT, TOPICS

_FAKETIME = [Path(f"/usr/lib/{arch}-linux-gnu/faketime/libfaketimeMT.so.1") for arch in ("x86_64", "aarch64")]


_ENDING = ("bridge", "plc", "publisher", "subscriber", "hub")


class Fault:
    """One kind of fault.

    Attributes:
        name: What it is called.
        accounted: The topics on which every missing message must be counted by somebody, as far as those who
            count on its way live on.
        ends: The parts whose process it ends.
        may_end: The bridge may end of it, and is started again.
    """

    name = ""
    accounted: tuple[str, ...] = ()
    ends: frozenset[str] = frozenset()
    may_end = False

    def missing(self, cell: Cell) -> str:
        """Return why it cannot be tried here; empty if it can."""
        return ""

    def inflict(self, cell: Cell, dice: random.Random) -> None:
        """Do it, and undo it."""
        raise NotImplementedError


class Kill(Fault):
    """kill -9, and a new process at once, or after a while."""

    def __init__(self, part: str) -> None:
        self.part = part
        self.name = f"kill -9 {part}"
        self.ends = frozenset({part})
        self.accounted = TOPICS

    def inflict(self, cell: Cell, dice: random.Random) -> None:
        cell.parts[self.part].kill()
        time.sleep(dice.choice((0.0, 0.0, 0.4)))
        cell.parts[self.part].start()


class Restart(Fault):
    """SIGTERM, which everything of rosplc's ends by with status 0, and a new process."""

    def __init__(self, part: str) -> None:
        self.part = part
        self.name = f"restart {part}"
        self.ends = frozenset({part})
        self.accounted = TOPICS

    def inflict(self, cell: Cell, dice: random.Random) -> None:
        if not cell.parts[self.part].terminate():
            raise AssertionError(f"{self.part} did not end within a minute of SIGTERM")
        status = cell.parts[self.part].status
        if status and self.part != "hub":
            raise AssertionError(f"{self.part} ended with status {status} after SIGTERM")
        cell.parts[self.part].start()


class Stop(Fault):
    """SIGSTOP, a while, SIGCONT."""

    def __init__(self, part: str) -> None:
        self.part = part
        self.name = f"stop {part}"
        self.accounted = TOPICS

    def inflict(self, cell: Cell, dice: random.Random) -> None:
        cell.parts[self.part].send(signal.SIGSTOP)
        time.sleep(dice.uniform(0.05, 1.2))
        cell.parts[self.part].send(signal.SIGCONT)


class KillTwo(Fault):
    """Two of the parts die at the same moment."""

    name = "kill -9 two at once"
    ends = frozenset(_ENDING)

    def inflict(self, cell: Cell, dice: random.Random) -> None:
        names = dice.sample(sorted(cell.parts), 2)
        for name in names:
            cell.parts[name].send(signal.SIGKILL)
        for name in names:
            cell.parts[name].kill()
            cell.parts[name].start()


class KillBesideStopped(Fault):
    """One part dies and comes back while another stands still."""

    name = "kill -9 beside a stopped one"
    ends = frozenset(_ENDING)

    def inflict(self, cell: Cell, dice: random.Random) -> None:
        dead, still = dice.sample(sorted(cell.parts), 2)
        cell.parts[still].send(signal.SIGSTOP)
        time.sleep(dice.uniform(0.0, 0.3))
        cell.parts[dead].kill()
        cell.parts[dead].start()
        time.sleep(dice.uniform(0.0, 0.8))
        cell.parts[still].send(signal.SIGCONT)


class Flood(Fault):
    """Ten times the configured rate, in both directions."""

    name = "flood"
    accounted = TOPICS

    def inflict(self, cell: Cell, dice: random.Random) -> None:
        cell.counters.control["flood"] = 10
        time.sleep(dice.uniform(0.5, 1.5))
        cell.counters.control["flood"] = 1


class StopInFlood(Fault):
    """The bridge stands still while ten times as much comes from both sides."""

    name = "stop bridge in a flood"
    accounted = TOPICS

    def inflict(self, cell: Cell, dice: random.Random) -> None:
        cell.counters.control["flood"] = 10
        cell.parts["bridge"].send(signal.SIGSTOP)
        time.sleep(dice.uniform(0.5, 2.0))
        cell.parts["bridge"].send(signal.SIGCONT)
        cell.counters.control["flood"] = 1


class Hang(Fault):
    """A subscriber that is stopped while ten times as much comes as it is used to."""

    name = "subscriber hangs in a flood"
    accounted = IN

    def inflict(self, cell: Cell, dice: random.Random) -> None:
        cell.parts["subscriber"].send(signal.SIGSTOP)
        cell.counters.control["flood"] = 10
        time.sleep(dice.uniform(1.0, 2.0))
        cell.counters.control["flood"] = 1
        # The PLC's way may not depend on a subscriber that hangs.
        cell.wait(_reaches_plc(cell), "the bridge carries to the PLC while a subscriber hangs")
        cell.parts["subscriber"].send(signal.SIGCONT)


def _reaches_plc(cell: Cell) -> Callable[[], bool]:
    marks = cell.marks()
    return lambda: not set(cell.flows(marks)) & set(IN)


class Remove(Fault):
    """Objects are unlinked: some, or all with their lock files."""

    def __init__(self, everything: bool) -> None:
        self._all = everything
        self.name = "all files removed" if everything else "objects removed"

    def inflict(self, cell: Cell, dice: random.Random) -> None:
        if self._all:
            cell.remove(path.name for path in SHM.glob(f"*{cell.prefix}*"))
        else:
            names = [name for name in sorted(cell.objects()) if not cell.is_classic(name)]
            cell.remove(dice.sample(names, dice.randint(1, len(names))))
        cell.wait(lambda: cell.expected_objects() <= cell.objects(), "the objects are made again")
        if self._all:
            cell.counters.control["reopen"] += 1  # classic objects cannot tell a PLC that they were replaced


class Full(Fault):
    """No room in shared memory while objects have to be made again."""

    def __init__(self, nearly: bool) -> None:
        self._nearly = nearly
        self.name = "shared memory nearly full" if nearly else "shared memory full"

    def missing(self, cell: Cell) -> str:
        return "" if cell.private else "needs a /dev/shm of its own: root, and mount namespaces"

    def inflict(self, cell: Cell, dice: random.Random) -> None:
        filler = SHM / "filler"
        try:
            # What was removed in the rounds before may still be mapped, and give its room back only now: the
            # objects are then made again without a word, and it has to be filled up and tried once more.
            cell.wait(lambda: self._filled_up(cell, filler), "the bridge says that there is no room")
        finally:
            filler.unlink(missing_ok=True)

    def _filled_up(self, cell: Cell, filler: Path) -> bool:
        leave = 16384 if self._nearly else 0
        before = cell.said("SHM117")
        with filler.open("ab") as file, contextlib.suppress(OSError):
            room = os.statvfs(SHM)
            free = room.f_bavail * room.f_frsize - leave
            if free > 0:
                os.posix_fallocate(file.fileno(), file.tell(), free)
        # What is removed stays mapped, and its memory in use: there is really no room.
        cell.remove([cell.namespace.object_name(topic) for topic in TOPICS])
        channels = {cell.namespace.object_name(topic) for topic in TOPICS}
        cell.wait(
            lambda: cell.said("SHM117") > before or channels <= cell.objects(),
            "the bridge sees what was removed",
        )
        return cell.said("SHM117") > before


class Limit(Fault):
    """The bridge may open no further file, or take no further memory, while its objects are removed."""

    def __init__(self, what: str) -> None:
        self._what = what
        self.name = f"no further {what}"
        self.may_end = True
        self.ends = frozenset({"bridge"})

    def missing(self, cell: Cell) -> str:
        if cell.backend == "zenoh" and self._what == "memory":
            return "the Zenoh library's receiving thread ends for good where memory cannot be had"
        return ""

    def inflict(self, cell: Cell, dice: random.Random) -> None:
        bridge = cell.parts["bridge"]
        kind = resource.RLIMIT_NOFILE if self._what == "descriptor" else resource.RLIMIT_AS
        before = resource.prlimit(bridge.pid, kind)
        resource.prlimit(bridge.pid, kind, (self._now(bridge.pid), before[1]))
        cell.remove([cell.namespace.object_name(topic) for topic in OUT])
        time.sleep(dice.uniform(1.2, 2.5))
        if bridge.alive:
            resource.prlimit(bridge.pid, kind, before)
        cell.ensure()

    def _now(self, pid: int) -> int:
        if self._what == "descriptor":
            return len(os.listdir(f"/proc/{pid}/fd"))
        lines = Path(f"/proc/{pid}/status").read_text().splitlines()
        return 1024 * next(int(line.split()[1]) for line in lines if line.startswith("VmSize:"))


class Clock(Fault):
    """The wall clock of a process jumps, by an hour, a year, back; the machine's own never does."""

    def __init__(self, part: str) -> None:
        self.part = part
        self.name = f"clock steps, {part}"
        self.ends = frozenset({part})

    def missing(self, cell: Cell) -> str:
        return "" if any(path.exists() for path in _FAKETIME) else "Debian package faketime is missing"

    def inflict(self, cell: Cell, dice: random.Random) -> None:
        part = cell.parts[self.part]
        clock = cell.folder / f"clock-{self.part}"
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
                cell.wait(_shifted(cell, self.part, step), f"the {self.part}'s clock is {step:+d} s off")
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


class Reload(Fault):
    """The configuration is changed while running: topics added, removed, changed."""

    name = "configuration reloaded"
    accounted = ("/soak/in", "/soak/out")

    def inflict(self, cell: Cell, dice: random.Random) -> None:
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


class Refused(Fault):
    """A file that is wrong, or changes what cannot change, is refused; nothing happens."""

    name = "wrong configuration refused"
    accounted = TOPICS

    def inflict(self, cell: Cell, dice: random.Random) -> None:
        cell.write_config(dice.choice(("tick: 3ms", "tick: nonsense", "nonsense: 1", "topics: [")))
        cell.hang_up("the new configuration is refused")
        cell.write_config()
        cell.hang_up("has reloaded its configuration")


class Quiet(Fault):
    """Nothing happens: what is missing then is missing for no reason."""

    name = "nothing"
    accounted = TOPICS

    def inflict(self, cell: Cell, dice: random.Random) -> None:
        time.sleep(dice.uniform(0.2, 1.0))


_PARTS = ("bridge", "plc", "publisher", "subscriber")
FAULTS: tuple[Fault, ...] = (
    *(Kill(part) for part in _PARTS),
    *(Restart(part) for part in _PARTS),
    *(Stop(part) for part in _PARTS),
    KillTwo(),
    KillBesideStopped(),
    Flood(),
    StopInFlood(),
    Hang(),
    Remove(everything=False),
    Remove(everything=True),
    Full(nearly=False),
    Full(nearly=True),
    Limit("descriptor"),
    Limit("memory"),
    Clock("bridge"),
    Clock("publisher"),
    Reload(),
    Refused(),
    Quiet(),
)
HUB_FAULTS: tuple[Fault, ...] = (Kill("hub"), Restart("hub"), Stop("hub"))
"""What happens to a router or a master, where there is one."""


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


class KillInside(Fault):
    """kill -9 of the PLC inside a lock."""

    name = "kill -9 plc inside a lock"
    ends = frozenset({"plc"})
    accounted = TOPICS

    def inflict(self, cell: Cell, dice: random.Random) -> None:
        _stand_still_inside(cell)
        cell.parts["plc"].kill()
        cell.parts["plc"].start()


class KillBridgeInside(Fault):
    """kill -9 of the bridge while a lock is taken and never given back: the semaphore knows no difference."""

    name = "kill -9 bridge, a lock taken"
    ends = frozenset({"bridge"})

    def inflict(self, cell: Cell, dice: random.Random) -> None:
        lock = _held(cell, dice.choice(CLASSIC))
        cell.parts["bridge"].kill()
        cell.parts["bridge"].start()
        lock.close()


class StrangerDies(Fault):
    """A third program takes a lock and is gone."""

    name = "a third program dies inside a lock"
    accounted = TOPICS

    def inflict(self, cell: Cell, dice: random.Random) -> None:
        _held(cell, dice.choice(CLASSIC)).close()


class StopInside(Fault):
    """SIGSTOP of the PLC inside a lock, for less than after what it counts as dead."""

    name = "stop plc inside a lock"
    accounted = TOPICS

    def inflict(self, cell: Cell, dice: random.Random) -> None:
        _stand_still_inside(cell)
        time.sleep(dice.uniform(0.05, 0.8))
        cell.parts["plc"].send(signal.SIGCONT)


class OnlineChange(Fault):
    """An online change moves every instance of the PLC's program."""

    name = "online change"
    accounted = TOPICS

    def inflict(self, cell: Cell, dice: random.Random) -> None:
        for _ in range(dice.randint(1, 3)):
            cell.counters.control["online_change"] += 1
            before = int(cell.counters.control["plc_scans"])
            cell.wait(lambda: cell.counters.control["plc_scans"] > before + 2, "the PLC goes on")  # noqa: B023


PLC_FAULTS: tuple[Fault, ...] = (
    KillInside(), KillBridgeInside(), StrangerDies(), StopInside(), OnlineChange(),
)  # fmt: skip


def faults_for(cell: Cell) -> tuple[Fault, ...]:
    """Return the faults that there are with a cell's backend and PLC."""
    return (
        *FAULTS,
        *(HUB_FAULTS if "hub" in cell.parts else ()),
        *(PLC_FAULTS if cell.plc == "st" else ()),
    )
