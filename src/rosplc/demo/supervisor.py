"""Run the demonstration: start three processes, let them talk, drain, compare, clean up."""

from __future__ import annotations

import json
import math
import os
import tempfile
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from rosplc.demo.plan import COMMAND, Plan
from rosplc.demo.processes import Child, remove_objects
from rosplc.errors import SetupError

_COUNTERS = ("sent", "received", "lost", "torn", "repeated")


@dataclass(frozen=True, slots=True)
class Flow:
    """One topic, from the process that sends to the one that receives; ``to`` is ``plc`` or ``ros``.

    Of the messages that the sender counts, ``received`` came whole with a new number, ``lost`` are the
    others, ``torn`` do not agree with their seal, ``repeated`` came twice or out of order. ``counted_lost``
    is the channel's own counter, None where none applies; ``gaps`` how often numbers were left out;
    ``last_arrived``: the last one came.
    """

    topic: str
    to: str
    sent: int
    received: int
    lost: int
    torn: int
    repeated: int
    counted_lost: int | None = None
    gaps: int = 0
    last_arrived: bool = True

    @property
    def complete(self) -> bool:
        """Whether everything that was sent arrived, whole and once."""
        return self.sent > 0 and self.lost == self.torn == self.repeated == 0 and not self.counted_lost

    @property
    def recovered(self) -> bool:
        """Whether all that is missing is one piece, with nothing torn, repeated or missing after it."""
        return self.received > 0 and self.torn == self.repeated == 0 and self.gaps <= 1 and self.last_arrived


@dataclass(frozen=True, slots=True)
class Outage:
    """The bridge was killed (SIGKILL) and started again; times in seconds since the first message.

    ``to_plc_at`` and ``to_ros_at``: when the first message after that was with the PLC, the first command
    with the robot; None if none was.
    """

    killed_at: float
    restarted_at: float
    to_plc_at: float | None = None
    to_ros_at: float | None = None


@dataclass(frozen=True, slots=True)
class Result:
    """The whole run: messages were sent for so many seconds.

    ``ages`` has per topic, and over all as ``""``, median and p99 age of a message, in ms, at the moment the
    PLC program had it in hand; ``metres`` is how far the robot went on the PLC's commands; ``drained``: the
    last messages had arrived at the end. ``program``, with ``--plc st``: mean and longest time that the
    Structured Text alone took of a scan, in µs.
    """

    seconds: float
    flows: tuple[Flow, ...]
    ages: dict[str, dict[str, float]]
    cycle: dict[str, float]
    metres: float
    drained: bool
    outage: Outage | None = None
    program: dict[str, float] | None = None

    @property
    def complete(self) -> bool:
        """Whether every topic is complete."""
        return all(flow.complete for flow in self.flows)

    @property
    def good(self) -> bool:
        """Whether the run shows what it should: complete, or recovered after ``--kill``."""
        if self.outage is None:
            return self.complete
        back = self.outage.to_plc_at is not None and self.outage.to_ros_at is not None
        return back and all(flow.recovered for flow in self.flows)

    def totals(self, *ways: str) -> dict[str, int]:
        """Return the sums of the counters over the topics of these directions."""
        flows = [flow for flow in self.flows if flow.to in ways]
        return {what: sum(getattr(flow, what) for flow in flows) for what in _COUNTERS}

    def summary(self) -> str:
        """Return the summary line."""
        age = self.ages.get("", {"median_ms": math.nan, "p99_ms": math.nan})
        plc, ros, both = self.totals("plc"), self.totals("ros"), self.totals("plc", "ros")
        return (
            f"ROS → PLC {plc['received']} of {plc['sent']} messages, "
            f"PLC → ROS {ros['received']} of {ros['sent']}, "
            f"lost {both['lost']}, torn {both['torn']}, repeated {both['repeated']}, "
            f"age at the PLC median {age['median_ms']:.2f} ms, p99 {age['p99_ms']:.2f} ms"
        )

    def to_dict(self) -> dict[str, Any]:
        """Return the result as plain data."""
        return {
            "good": self.good,
            "complete": self.complete,
            "outage": None if self.outage is None else asdict(self.outage),
            "drained": self.drained,
            "seconds": self.seconds,
            "topics": [
                {**asdict(flow), "complete": flow.complete, "rate_hz": flow.received / self.seconds}
                for flow in self.flows
            ],
            "to_plc": self.totals("plc"),
            "to_ros": self.totals("ros"),
            "age_at_plc": {topic or "all": values for topic, values in self.ages.items()},
            "cycle": self.cycle,
            "program": self.program,
            "metres": self.metres,
        }


def collect(
    robot: dict[str, Any], plc: dict[str, Any], seconds: float, *, drained: bool, outage: Outage | None = None
) -> Result:
    """Compare the last reports of the two ends, which sent messages for so many seconds."""
    counters = plc.get("counters", {})
    flows = [
        _flow(topic, "plc", sent, plc["received"][topic], counters.get(topic, {}).get("lost"))
        for topic, sent in robot["sent"].items()
    ]
    command = COMMAND[0]
    flows.append(_flow(command, "ros", plc["sent"][command], robot["received"][command], None))
    ages, cycle, program = plc.get("ages", {}), plc.get("cycle", {}), plc.get("program")
    return Result(seconds, tuple(flows), ages, cycle, robot["metres"], drained, outage, program)


def _flow(topic: str, to: str, sent: int, tally: dict[str, int], counted: int | None) -> Flow:
    received, torn, repeated = tally["received"], tally["torn"], tally["repeated"]
    whole = tally["newest"] == sent
    return Flow(topic, to, sent, received, sent - received, torn, repeated, counted, tally["gaps"], whole)


_POLL = 0.05
_STARTUP, _QUIET = (60.0, 10.0)  # seconds to find each other, and in which nothing comes any more
_KILL_AFTER = 5.0
_DOWN_SECONDS = 0.5


class Demo:
    """Three processes and what they report; a context manager that leaves nothing behind.

    ``on_tick`` is called some twenty times per second with this object, to draw a view; ``plc`` is
    the module of the PLC's process, and ``folder`` what it runs, None for the Python program.
    """

    def __init__(
        self,
        plan: Plan,
        *,
        on_tick: Callable[[Demo], None] | None = None,
        plc: str = "rosplc.demo.plc",
        folder: Path | None = None,
    ) -> None:
        self.plan = plan
        self.phase = "starting"
        self.children: list[Child] = []
        self.outage: Outage | None = None
        self._on_tick = on_tick or (lambda _: None)
        self._plc = plc, folder
        self._before = (0, 0)
        self._began: float | None = None
        self._start_bridge: Callable[[], Child]
        self._folder = tempfile.TemporaryDirectory(prefix="rosplc-demo-")

    @property
    def robot(self) -> dict[str, Any]:
        """The robot's last report."""
        return self.children[0].status

    @property
    def plc(self) -> dict[str, Any]:
        """The PLC's last report."""
        return self.children[2].status

    @property
    def elapsed(self) -> float:
        """Seconds since the first message; 0 before."""
        return 0.0 if self._began is None else time.monotonic() - self._began

    def run(self, duration: float | None, *, kill: bool = False) -> Result:
        """Run for ``duration`` seconds (None: until KeyboardInterrupt), drain, and compare.

        It takes longer until a bridge that was killed on the way (``kill``) carries again. Raises SetupError
        SYS002 if a process failed, SYS004 if they did not find each other.
        """
        self._start()
        self._wait_until_ready()
        self.phase = "running"
        began = self._began = time.monotonic()
        for child in self.children:
            child.order("go")
        kill_at = None if not kill else _KILL_AFTER if duration is None else duration / 3
        try:
            grace = 0.0  # a bridge that starts again is waited for
            while duration is None or time.monotonic() - began < duration + grace:
                self._tick()
                if kill_at is not None and time.monotonic() - began >= kill_at:
                    kill_at = None
                    self._kill_bridge(began)
                self._note_recovery(began)
                outage = self.outage
                grace = _STARTUP if outage and None in (outage.to_plc_at, outage.to_ros_at) else 0.0
        except KeyboardInterrupt:
            if duration is not None:
                raise
        seconds = time.monotonic() - began
        self.phase = "draining"
        drained = self._drain()
        self.phase = "finished"
        robot, _, plc = self.children
        for child in (plc, robot):  # each sends one last, complete report when it is told to stop
            child.finish()
        return collect(robot.status, plc.status, seconds, drained=drained, outage=self.outage)

    def _start(self) -> None:
        configuration = Path(self._folder.name) / "rosplc.yaml"
        # JSON is YAML; no second writer of YAML is needed for a file that nobody edits.
        configuration.write_text(json.dumps(self.plan.configuration(), indent=2), encoding="utf-8")
        foreign = ("CYCLONEDDS_URI", "ROS_STATIC_PEERS")
        environment = {key: value for key, value in os.environ.items() if key not in foreign}
        # Loopback alone, whatever this machine's ROS is set to; and no module of the folder in
        # which the user happens to be in, in place of a library's (from Python 3.11 on).
        environment.update(
            PYTHONSAFEPATH="1",
            ROS_LOCALHOST_ONLY="1",
            ROS_AUTOMATIC_DISCOVERY_RANGE="LOCALHOST",
            ROS_DOMAIN_ID=str(self.plan.domain),
        )
        plan = self.plan.to_json()
        self.children.append(Child("robot", "rosplc.demo.robot", [plan], environment))
        given = [str(configuration), self.plan.prefix]
        self._start_bridge = lambda: Child("bridge", "rosplc.demo.bridge", given, environment)
        self.children.append(self._start_bridge())
        module, folder = self._plc
        more = [] if folder is None else [str(folder)]
        self.children.append(Child("PLC", module, [plan, *more], environment))

    def _kill_bridge(self, began: float) -> None:
        bridge = self.children[1]
        bridge.kill()
        killed_at = time.monotonic() - began
        self.phase = "the bridge was killed"
        end = time.monotonic() + _DOWN_SECONDS
        while time.monotonic() < end:
            self._on_tick(self)
            time.sleep(_POLL)
        bridge.close()
        self._before = (_total(self.plc), _total(self.robot))
        self.outage = Outage(killed_at, time.monotonic() - began)
        self.children[1] = self._start_bridge()
        self.phase = "the bridge is restarting"

    def _note_recovery(self, began: float) -> None:
        outage, now = self.outage, time.monotonic() - began
        if outage is None:
            return
        if outage.to_plc_at is None and _total(self.plc) > self._before[0]:
            outage = replace(outage, to_plc_at=now)
        if outage.to_ros_at is None and _total(self.robot) > self._before[1]:
            outage = replace(outage, to_ros_at=now)
        if outage.to_plc_at is not None and outage.to_ros_at is not None:
            self.phase = "running again"
        self.outage = outage

    def _wait_until_ready(self) -> None:
        deadline = time.monotonic() + _STARTUP
        while not (self.plc.get("ready") and self.robot and not self.robot["unmatched"]):
            self._tick()
            if time.monotonic() > deadline:
                raise SetupError("SYS004", f"not ready after {_STARTUP:g} s: {self._who_waits()}")

    def _who_waits(self) -> str:
        reasons = [f"robot {topic}: {why}" for topic, why in self.robot.get("unmatched", {}).items()]
        reasons += [f"PLC {topic}: {why}" for topic, why in self.plc.get("waiting", {}).items()]
        if not self.robot:
            reasons.append("the robot sent no status")
        if not self.plc:
            reasons.append("the PLC sent no status")
        return "; ".join(reasons) or "the PLC is not ready"

    def _drain(self) -> bool:
        """Stop both senders, the robot first, and wait until nothing is under way any more."""
        robot, plc = self.children[0], self.children[2]
        robot.order("drain")
        self._settle(lambda: self.robot.get("drained"), lambda: _newest(self.plc) == self.robot["sent"])
        plc.order("drain")
        return (
            self._settle(lambda: self.plc.get("drained"), lambda: _newest(self.robot) == self.plc["sent"])
            and _newest(self.plc) == self.robot["sent"]
        )

    def _settle(self, stopped: Callable[[], Any], arrived: Callable[[], bool]) -> bool:
        last, since = None, time.monotonic()
        while not (stopped() and arrived()):
            self._tick()
            now = (_newest(self.plc), _newest(self.robot), stopped())
            if now != last:
                last, since = now, time.monotonic()
            if time.monotonic() - since > _QUIET:
                return False
        return True

    def _tick(self) -> None:
        for child in self.children:
            child.check()
        self._on_tick(self)
        time.sleep(_POLL)

    def close(self) -> None:
        """End every process and remove what they left; harmless twice."""
        for child in reversed(self.children):
            child.finish()
        for child in self.children:
            child.close()
        self.children.clear()
        remove_objects(self.plan.prefix)
        self._folder.cleanup()

    def __enter__(self) -> Demo:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _newest(status: dict[str, Any]) -> dict[str, int]:
    # A receiver that has the newest number has everything that will ever come: order is kept.
    return {topic: tally["newest"] for topic, tally in status.get("received", {}).items()}


def _total(status: dict[str, Any]) -> int:
    return sum(_newest(status).values())
