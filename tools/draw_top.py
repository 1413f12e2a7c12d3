"""Write docs/images/top.svg and top-message.svg: `rosplc top` over bridges that really run.

A demonstration, and a bridge that is killed on the way. What else runs on this machine is left out.
"""

from __future__ import annotations

import asyncio
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from calling_cell import calling_cell
from drawing import IMAGES
from rosplc.monitor import Picture, State, Watch
from rosplc.monitor.terminal import TopApp

SECONDS = 90.0
PREFIX, CALLS = "press", "cell1"
CONFIG = f"""\
bridge: press
prefix: {PREFIX}
ros: {{distro: jazzy}}
topics:
  /press/force: {{type: std_msgs/msg/Float64, to: plc}}
  /press/state: {{type: std_msgs/msg/String, to: ros}}
"""


class Only(Watch):
    """Looks at the bridges that this script started."""

    def look(self) -> Picture:
        """Return the look without everybody else's channels."""
        picture = super().look()
        ours = {PREFIX, CALLS, *(view.prefix for view in picture.channels if view.bridge == "demo")}
        return replace(
            picture,
            channels=tuple(view for view in picture.channels if view.prefix in ours),
            bridges=tuple(bridge for bridge in picture.bridges if bridge.prefix in ours),
            events=tuple(event for event in picture.events if event.prefix in ours),
        )


def start(*arguments: str) -> subprocess.Popen[bytes]:
    """Start the command without its output."""
    return subprocess.Popen(
        [sys.executable, "-m", "rosplc", *arguments], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )


def until(watch: Watch, condition: Callable[[Picture], bool]) -> None:
    """Look until a picture is as wanted."""
    end = time.monotonic() + SECONDS
    while not condition(watch.look()):
        if time.monotonic() > end:
            raise SystemExit("draw_top: the expected screen did not appear within a minute")
        time.sleep(0.2)


def save(app: TopApp, name: str) -> None:
    """Write what the screen shows; fonts are the reader's own."""
    image = app.export_screenshot(title="rosplc top")
    image = re.sub(r"<!--.*?-->", "<!-- Made by tools/draw_top.py -->", image, count=1)
    image = re.sub(r"@font-face \{[^}]*\}\s*", "", image)
    (IMAGES / name).write_text(re.sub(r"[ \t]+$", "", image, flags=re.M) + "\n", encoding="utf-8")


async def draw(watch: Watch, bridge: subprocess.Popen[bytes]) -> None:
    """Open the view, kill the bridge, and save the two screens."""
    app = TopApp(watch)
    async with app.run_test(size=(80, 24)) as pilot:
        await pilot.pause(4)
        bridge.send_signal(signal.SIGKILL)
        await pilot.pause(6)
        save(app, "top.svg")
        await pilot.press("slash", *"turtle/pose", "enter", "enter")
        await pilot.pause(2)
        await pilot.press(*["down"] * 8)
        await pilot.pause(30)
        save(app, "top-message.svg")


def main() -> None:
    """Start everything, draw, end everything."""
    with tempfile.TemporaryDirectory() as folder, calling_cell(CALLS), Only(calls=True) as watch:
        config = Path(folder) / "rosplc.yaml"
        config.write_text(CONFIG, encoding="utf-8")
        demo, bridge = start("demo", "--duration", "120s"), start("run", str(config))
        try:
            until(watch, lambda picture: sum(view.state is State.OK for view in picture.channels) >= 9)
            until(watch, lambda picture: any(view.prefix == PREFIX for view in picture.channels))
            asyncio.run(draw(watch, bridge))
        finally:
            for child in (bridge, demo):
                child.send_signal(signal.SIGINT)
                child.wait()
            for path in Path("/dev/shm").glob(f"{PREFIX}.*"):
                path.unlink()


if __name__ == "__main__":
    main()
