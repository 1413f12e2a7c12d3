"""What a run of the demonstration came to: numbers from the messages, compared with the counters."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any

from rosplc.demo.messages import COMMAND

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
