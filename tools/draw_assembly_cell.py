"""Write docs/images/assembly-cell.svg and its narrow form; ``--web``: the page's picture of the cell as well.

    .venv/bin/python tools/draw_assembly_cell.py --web

The second one takes Debian's Chromium: it starts the example and ``rosplc web``, and looks at them.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from drawing import IMAGES, box, picture, stroke, text, write

ROOT = Path(__file__).resolve().parent.parent
WIDTH, BOTTOM = 960, 452
TITLE = "A robot and a PLC share the nest of a press; goals and states go through shared memory."
_ALL_WELL = """() => {
    const rows = [...document.querySelectorAll("tr.channel")];
    return rows.length > 2 && rows.every((row) => /^\\s*ok\\b/.test(row.innerText));
}"""


def channel(y: float, topic: str, what: str, *, to_plc: bool, both: bool = False) -> list[str]:
    """Return a topic's channel, or an action's, between bridge and PLC, with its arrows."""
    ends = [(506, 540, 12), (728, 766, 12)] if to_plc or both else []
    ends += [] if to_plc else [(540, 506, 32), (766, 728, 32)]
    return [
        box(542, y, 184, 44, "shm"),
        text(634, y + 18, topic, "mono"),
        text(634, y + 35, what, "small"),
        *(stroke(f"M{begin:g} {y + (at if both else 22):g}H{end:g}") for begin, end, at in ends),
    ]


def image() -> str:
    """Return the whole picture."""
    parts = [
        box(20, 40, 210, 196) + text(125, 66, "robot", "bold") + text(125, 86, "a ROS 2 node", "small"),
        box(38, 104, 174, 50, "good")
        + text(125, 125, "serves the action")
        + text(125, 143, "feedback, then a result", "small"),
        box(38, 168, 174, 50, "good")
        + text(125, 189, "knows what it has done")
        + text(125, 207, "by serial numbers", "small"),
        box(334, 40, 172, 196, "area")
        + text(420, 66, "bridge", "bold")
        + text(420, 86, "rosplc run", "small"),
        text(420, 140, "may be killed at any", "small") + text(420, 156, "time, and restarts", "small"),
        text(634, 66, "/dev/shm", "bold"),
        *channel(88, "/robot/state", "phase, placed …", to_plc=True),
        *channel(140, "/robot/hand_over", "goal, feedback, result", to_plc=False, both=True),
        *channel(192, "/press/state", "stage, occupied …", to_plc=False),
        box(768, 40, 172, 196) + text(854, 66, "PLC", "bold") + text(854, 86, "Structured Text", "small"),
        box(784, 104, 140, 50, "busy")
        + text(854, 125, "ActionClient")
        + text(854, 143, "sends each goal once", "small"),
        box(784, 168, 140, 50, "busy")
        + text(854, 189, "looks, then acts")
        + text(854, 207, "remembers nothing", "small"),
        stroke("M232 110H332") + stroke("M332 162H232") + text(282, 102, "DDS", "small"),
        # the machine
        box(20, 286, 920, 142, "area") + text(480, 310, "physical state: survives all restarts", "bold"),
        box(60, 332, 130, 68) + text(125, 360, "tray") + text(125, 380, "housings, springs", "small"),
        box(334, 332, 172, 68, "full")
        + text(420, 360, "the nest of the press", "on")
        + text(420, 380, "one handle", "small on"),
        box(614, 332, 140, 68) + text(684, 360, "press") + text(684, 380, "drives the pin in", "small"),
        box(800, 332, 110, 68) + text(855, 360, "box") + text(855, 380, "finished handles", "small"),
        stroke("M190 352H332") + text(262, 344, "1 place", "small"),
        stroke("M614 366H508") + text(560, 358, "2 press", "small"),
        stroke("M420 402V418H855V402") + text(640, 413, "3 remove", "small"),
        stroke("M125 238V330") + text(166, 262, "its arm", "small"),
        stroke("M854 238V262H684V330") + text(770, 256, "wires: sensors, cylinder", "small"),
    ]
    return picture(TITLE, 20, WIDTH, BOTTOM, parts)


def narrow() -> str:
    """Return the same from top to bottom, for telephones."""
    parts = [
        box(4, 4, 352, 100) + text(180, 24, "robot", "bold") + text(180, 42, "a ROS 2 node", "small"),
        box(4, 140, 352, 60, "area") + text(180, 161, "bridge: rosplc run", "bold"),
        text(180, 182, "may be killed at any time, and restarts", "small"),
        text(180, 236, "/dev/shm", "bold"),
        box(4, 432, 352, 100) + text(180, 452, "PLC", "bold") + text(180, 470, "Structured Text", "small"),
        box(4, 568, 352, 222, "area") + text(180, 590, "physical state: survives all restarts", "bold"),
        text(214, 127, "DDS", "small"),
    ]
    for y, kind, notes in (
        (
            50,
            "good",
            (("serves the action", "feedback, then a result"), ("knows what it did", "by serial numbers")),
        ),
        (478, "busy", (("ActionClient", "sends each goal once"), ("looks, then acts", "remembers nothing"))),
    ):
        for x, (name, what) in zip((12, 184), notes, strict=True):
            parts += [box(x, y, 164, 46, kind), text(x + 82, y + 20, name, "on")]
            parts.append(text(x + 82, y + 37, what, "small on"))
    for y, topic, what, to_plc, to_ros in (
        (248, "/robot/state", "phase, placed …", True, False),
        (300, "/robot/hand_over", "goal, feedback, result", True, True),
        (352, "/press/state", "stage, occupied …", False, True),
    ):
        parts += [
            box(50, y, 260, 44, "shm"),
            text(180, y + 18, topic, "mono"),
            text(180, y + 35, what, "small"),
        ]
        parts += [stroke(f"M26 {y}V{y + 44}")] if to_plc else []
        parts += [stroke(f"M334 {y + 44}V{y}")] if to_ros else []
    for x, down in ((170, True), (190, False)):
        for above, below in ((104, 140), (200, 220), (400, 432)):
            parts.append(stroke(f"M{x} {above}V{below - 2}" if down else f"M{x} {below}V{above + 2}"))
    for x, y, kind, name, what in (
        (12, 602, "box", "tray", "housings, springs"),
        (12, 702, "full", "the nest of the press", "one handle"),
        (236, 602, "box", "press", "drives the pin in"),
        (236, 702, "box", "box", "finished handles"),
    ):
        parts += [box(x, y, 160 if x == 12 else 114, 62, kind)]
        middle = x + (80 if x == 12 else 57)
        parts += [text(middle, y + 27, name, "on"), text(middle, y + 46, what, "small on")]
    parts += [
        text(180, 780, "the robot's arm does 1 and 3, the PLC 2", "small"),
        stroke("M287 532V566") + text(278, 556, "wires: sensors, cylinder", "small right"),
        stroke("M90 664V700") + text(122, 688, "1 place", "small"),
        stroke("M236 650L174 704") + text(240, 688, "2 press", "small"),
        stroke("M172 745H234") + text(204, 738, "3 remove", "small"),
    ]
    return picture(TITLE, 0, 360, 796, parts)


def shoot() -> None:
    """Write what ``rosplc web`` shows of the running cell to docs/images/web/assembly-cell.png."""
    from playwright.sync_api import sync_playwright

    options = ["--handles", "1000", "--web", "--seed", "39"]  # that storm begins with bridge and PLC
    command = [sys.executable, "-u", "-m", "examples.assembly_cell", *options]
    cell = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True)
    try:
        assert cell.stdout is not None
        url = next(line.split()[-1] for line in cell.stdout if line.startswith("in the browser: http"))
        with sync_playwright() as driver:
            browser = driver.chromium.launch(executable_path="/usr/bin/chromium", args=["--no-sandbox"])
            page = browser.new_page(viewport={"width": 1360, "height": 760})
            page.goto(url)
            page.wait_for_selector("tr.channel")
            for kind in ("bridge-back", "plc-back"):
                page.wait_for_selector(f'[data-kind="{kind}"]', state="attached", timeout=240_000)
            # Bridge and PLC fail again and again: what is shown is the work between.
            page.wait_for_function(_ALL_WELL, timeout=240_000)
            page.screenshot(path=IMAGES / "web/assembly-cell.png")
            browser.close()
    finally:
        cell.terminate()
        cell.wait()


DRAWINGS = {"assembly-cell.svg": image, "assembly-cell-narrow.svg": narrow}

if __name__ == "__main__":
    write(DRAWINGS)
    if "--web" in sys.argv:
        shoot()
