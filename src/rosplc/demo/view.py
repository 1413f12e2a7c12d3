"""The demonstration as a live picture in the terminal."""

from __future__ import annotations

import time

from rich.box import SIMPLE_HEAD
from rich.console import Console, Group
from rich.live import Live
from rich.table import Table
from rich.text import Text

from rosplc.demo.plan import COMMAND, robot_topics
from rosplc.demo.supervisor import Demo
from rosplc.monitor.tracked import Rate

# Columns of the terminal from which on the table has room for everything; a narrow one must still
# show topics and numbers whole, so it does without the types and what the counts tell anyway.
_WIDE = 104

_COLUMNS = ("topic", "type", "way", "sent", "received", "per s", "in flight", "lost", "torn", "age at PLC")


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
            text = "Starting the robot, the bridge and the virtual PLC, and waiting for discovery …"
            return Group(Text(text))
        robot, plc = demo.robot, demo.plc
        wide = self._live.console.width >= _WIDE
        table = Table(box=SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False, show_edge=False)
        shown = [number for number, name in enumerate(_COLUMNS) if wide or name not in ("type", "in flight")]
        for number in shown:
            table.add_column(_COLUMNS[number], no_wrap=True, justify="right" if number > 2 else "left")
        command, type_name = COMMAND
        rows = [(topic, kind.type_name, "→ PLC") for topic, kind in robot_topics(demo.plan.topics).items()]
        for topic, type_, way in (*rows, (command, type_name, "→ ROS")):
            sender, receiver = (plc, robot) if topic == command else (robot, plc)
            tally = receiver.get("received", {}).get(topic, {})
            received, lost = tally.get("received", 0), tally.get("missing", 0)
            # The two ends report at different moments; what has arrived has been sent.
            sent = max(sender.get("sent", {}).get(topic, 0), received + lost)
            rate = self._rates.setdefault(topic, Rate()).of(received, time.monotonic_ns()) or 0.0
            age = None if topic == command else plc.get("age", {}).get(topic)
            cells = [topic, type_.rpartition("/")[2], way, str(sent), str(received), f"{rate:.0f}"]
            cells += [str(sent - received - lost), str(lost), str(tally.get("torn", 0))]
            cells.append("" if age is None else f"{age:.2f} ms")
            table.add_row(*(cells[number] for number in shown))
        cycle = plc.get("cycle", {})
        task = (
            f"PLC task: {cycle.get('scans', 0)} scans, one every {demo.plan.interval * 1000:g} ms, "
            f"{cycle.get('missed', 0)} missed; mean {cycle.get('cycle_mean_us', 0) / 1000:.2f} ms, "
            f"longest {cycle.get('cycle_max_us', 0) / 1000:.2f} ms"
        )
        drive = f"The robot has moved {robot.get('metres', 0.0):.2f} m, following the PLC's commands."
        path = Text("robot (DDS) ⇄ bridge ⇄ shared memory ⇄ virtual PLC", style="bold")
        end = Text(f"{demo.phase}; press Ctrl-C to stop and print a summary", style="dim")
        return Group(path, Text(), table, Text(), Text(task), Text(drive), end)
