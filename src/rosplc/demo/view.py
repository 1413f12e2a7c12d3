"""The demonstration as a live picture in the terminal."""

from __future__ import annotations

import time

from rich.box import SIMPLE_HEAD
from rich.console import Console, Group
from rich.live import Live
from rich.progress import Progress
from rich.table import Table
from rich.text import Text

from rosplc.demo.messages import COMMAND, robot_topics
from rosplc.demo.supervisor import Demo
from rosplc.monitor.tracked import Rate

__all__ = ["LiveView", "ProgressLine"]

# Columns of the terminal from which on the table has room for everything; a narrow one must still
# show topics and numbers whole, so it does without the types and what the counts tell anyway.
_WIDE = 104


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
        self._rates: dict[str, Rate] = {}
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
        wide = self._live.console.width >= _WIDE
        table = Table(box=SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False, show_edge=False)
        for name in ("topic", "type", "way") if wide else ("topic", "way"):
            table.add_column(name, no_wrap=True)
        counts = ("sent", "received", "per s", "under way", "lost", "torn", "age at PLC")
        for name in counts if wide else (name for name in counts if name != "under way"):
            table.add_column(name, justify="right", no_wrap=True)
        for topic, kind in robot_topics(demo.plan.topics).items():
            tally = plc.get("received", {}).get(topic, {})
            age = plc.get("age", {}).get(topic)
            names = (topic, kind.type_name, "→ PLC")
            table.add_row(*self._row(names, robot["sent"].get(topic, 0), tally, age, wide=wide))
        command, type_name = COMMAND
        sent, tally = plc.get("sent", {}).get(command, 0), robot.get("received", {}).get(command, {})
        table.add_row(*self._row((command, type_name, "→ ROS"), sent, tally, None, wide=wide))
        cycle = plc.get("cycle", {})
        task = (
            f"PLC task: {cycle.get('scans', 0)} scans of {demo.plan.interval * 1000:g} ms, "
            f"{cycle.get('missed', 0)} missed; a scan takes {cycle.get('cycle_mean_us', 0) / 1000:.2f} ms, "
            f"at most {cycle.get('cycle_max_us', 0) / 1000:.2f} ms"
        )
        drive = f"The robot went {robot.get('metres', 0.0):.2f} m on the PLC's commands."
        path = "robot (DDS) ⇄ bridge ⇄ shared memory ⇄ virtual PLC"
        return Group(
            Text(path, style="bold"),
            Text(),
            table,
            Text(),
            Text(task),
            Text(drive),
            Text(f"{demo.phase}; Ctrl-C ends it and sums up", style="dim"),
        )

    def _row(
        self,
        names: tuple[str, str, str],
        sent: int,
        tally: dict[str, int],
        age: float | None,
        *,
        wide: bool,
    ) -> list[str]:
        topic, type_name, way = names
        received, lost = tally.get("received", 0), tally.get("missing", 0)
        row = [topic, type_name.rpartition("/")[2], way] if wide else [topic, way]
        rate = self._rates.setdefault(topic, Rate()).of(received, time.monotonic_ns()) or 0.0
        # The two ends report at different moments; what has arrived has been sent.
        sent = max(sent, received + lost)
        row += [str(sent), str(received), f"{rate:.0f}"]
        if wide:
            row.append(str(sent - received - lost))
        return [*row, str(lost), str(tally.get("torn", 0)), "" if age is None else f"{age:.2f} ms"]
