"""The demonstration as a live picture in the terminal."""

from __future__ import annotations

import time
from collections import deque

from rich.console import Console, Group
from rich.live import Live
from rich.progress import Progress
from rich.table import Table
from rich.text import Text

from rosplc.demo.messages import COMMAND, robot_topics
from rosplc.demo.supervisor import Demo

__all__ = ["LiveView", "ProgressLine"]

_RATE_SECONDS = 2.0


class _Rate:
    """Messages per second over the last two seconds, from a counter."""

    def __init__(self) -> None:
        self._seen: deque[tuple[float, int]] = deque()

    def of(self, count: int) -> float:
        now = time.monotonic()
        self._seen.append((now, count))
        while len(self._seen) > 2 and now - self._seen[0][0] > _RATE_SECONDS:
            self._seen.popleft()
        (then, before), (_, after) = self._seen[0], self._seen[-1]
        return (after - before) / (now - then) if now > then else 0.0


class ProgressLine:
    """One line on stderr for a run whose result goes elsewhere; a context manager.

    Args:
        console: The terminal.
        seconds: How long the run sends.
    """

    def __init__(self, console: Console, seconds: float | None) -> None:
        self._progress = Progress(console=console, transient=True)
        self._task = self._progress.add_task("starting", total=seconds)

    def __enter__(self) -> ProgressLine:
        self._progress.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._progress.stop()

    def draw(self, demo: Demo) -> None:
        """Show the present phase and time."""
        self._progress.update(self._task, description=demo.phase, completed=demo.elapsed)


class LiveView:
    """Draws a :class:`Demo`; a context manager that owns the terminal meanwhile."""

    def __init__(self, console: Console) -> None:
        self._live = Live(console=console, auto_refresh=False, transient=True)
        self._rates: dict[str, _Rate] = {}
        self._drawn = 0.0

    def __enter__(self) -> LiveView:
        self._live.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._live.stop()

    def draw(self, demo: Demo) -> None:
        """Draw the present state, at most ten times per second."""
        now = time.monotonic()
        if now - self._drawn >= 0.1:
            self._drawn = now
            self._live.update(self._picture(demo), refresh=True)

    def _picture(self, demo: Demo) -> Group:
        if demo.phase == "starting":
            return Group(
                Text("Starting robot, bridge and virtual PLC: three processes that find each other …")
            )
        robot, plc = demo.robot, demo.plc
        table = Table(title="ROS ⇄ shared memory ⇄ virtual PLC", title_justify="left")
        for name in ("topic", "type", "way"):
            table.add_column(name)
        for name in ("sent", "received", "per s", "under way", "missing", "torn", "age at PLC"):
            table.add_column(name, justify="right")
        for topic, kind in robot_topics(demo.plan.topics).items():
            tally = plc.get("received", {}).get(topic, {})
            age = plc.get("age", {}).get(topic)
            shown = "" if age is None else f"{age:.2f} ms"
            table.add_row(
                *self._row(
                    topic, kind.type_name.rpartition("/")[2], "→ PLC", robot["sent"].get(topic, 0), tally
                ),
                shown,
            )
        command, type_name = COMMAND
        sent = plc.get("sent", {}).get(command, 0)
        table.add_row(
            *self._row(
                command,
                type_name.rpartition("/")[2],
                "→ ROS",
                sent,
                robot.get("received", {}).get(command, {}),
            ),
            "",
        )
        cycle = plc.get("cycle", {})
        task = (
            f"PLC task: {cycle.get('scans', 0)} scans of {demo.plan.interval * 1000:g} ms, "
            f"{cycle.get('missed', 0)} missed, mean {cycle.get('cycle_mean_us', 0) / 1000:.2f} ms, "
            f"longest {cycle.get('cycle_max_us', 0) / 1000:.2f} ms, latest start "
            f"{cycle.get('jitter_max_us', 0) / 1000:.2f} ms late"
        )
        metres = robot.get("metres", 0.0)
        drive = f"The robot went {metres:.2f} m on the PLC's commands.   {demo.phase}; Ctrl-C ends it."
        return Group(table, Text(task), Text(drive))

    def _row(self, topic: str, type_name: str, way: str, sent: int, tally: dict[str, int]) -> list[str]:
        received = tally.get("received", 0)
        rate = self._rates.setdefault(topic, _Rate()).of(received)
        missing, torn = tally.get("missing", 0), tally.get("torn", 0)
        # The two ends report at different moments, so the difference swings around zero.
        under_way = max(0, sent - received - missing)
        numbers = [str(sent), str(received), f"{rate:.0f}", str(under_way), str(missing), str(torn)]
        return [topic, type_name, way, *numbers]
