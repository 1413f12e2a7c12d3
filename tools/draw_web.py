"""Write docs/images/web/*.png: `rosplc web` as Debian's Chromium shows it, looking at live channels.

    .venv/bin/python tools/draw_web.py

The server is the one that users start. The channels are those of benchmarks/web_machine.py: a process in
the bridge's place and one in the PLC's, which is stopped and started once so that something has happened. A
bridge with a service and an action runs beside them.
"""

from __future__ import annotations

import json
import sys
import time
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from calling_cell import calling_cell
from rosplc.demo.processes import remove_objects
from rosplc_bench.process import Side

ROOT = Path(__file__).resolve().parent.parent
FOLDER = ROOT / "docs/images/web"
PREFIX = "webdocs"
DESK = {"width": 1360, "height": 850}
TABLET = {"width": 820, "height": 1100}


def start(stack: ExitStack, *command: str) -> tuple[Side, str]:
    """Start one of the project's modules, which ends with the stack; return it and its first line."""
    child = Side(command[0], ["env", "-C", str(ROOT), sys.executable, "-m", *command])
    stack.enter_context(child)
    stack.callback(child.kill)
    return child, child.receive()


def shoot(page: Any, name: str) -> None:
    """Write what the page shows."""
    FOLDER.mkdir(parents=True, exist_ok=True)
    page.screenshot(path=FOLDER / f"{name}.png")
    print(f"docs/images/web/{name}.png")


def overview(browser: Any, url: str, restart_plc: Any) -> None:
    """All channels, with a PLC that was away."""
    page = browser.new_page(viewport=DESK)
    page.goto(url)
    page.get_by_text("/cell/count feedback").first.wait_for()
    time.sleep(3)
    restart_plc()
    page.wait_for_selector('[data-kind="plc-back"]')
    time.sleep(6)
    shoot(page, "overview")
    page.close()


def message(browser: Any, url: str) -> None:
    """A message with a long array, in the dark."""
    page = browser.new_page(viewport=DESK, color_scheme="dark")
    page.goto(f"{url}#/channels/{PREFIX}.t.agv.scan")
    page.locator(".message-body summary").filter(has_text="header").click()
    time.sleep(40)
    shoot(page, "message")
    page.close()


def plots(browser: Any, url: str) -> None:
    """Four numbers of two topics."""
    page = browser.new_page(viewport=DESK)
    fields = {
        "robot1.tcp_pose": ("pose.position.x", "pose.position.z"),
        "robot1.wrench": ("wrench.force.z",),
        "robot1.joint_states": ("position[1]",),
    }
    for channel, paths in fields.items():
        page.goto(f"{url}#/channels/{PREFIX}.t.{channel}")
        for path in paths:
            page.get_by_role("button", name=f"Plot {path}", exact=True).click()
    page.goto(f"{url}#/plots")
    time.sleep(33)
    shoot(page, "plots")
    page.close()


def write(browser: Any, url: str) -> None:
    """The form of a test message on a tablet, with a value that does not fit."""
    page = browser.new_page(viewport=TABLET, has_touch=True)
    page.goto(f"{url}#/channels/{PREFIX}.t.cell.test")
    page.get_by_text("Write a test message", exact=True).click()
    linear = page.get_by_role("group", name="linear")
    linear.get_by_label("x").fill("0.25")
    linear.get_by_label("y").fill("fast")
    linear.scroll_into_view_if_needed()
    time.sleep(2)
    shoot(page, "write")
    page.close()


def main() -> None:
    """Write all pictures."""
    from playwright.sync_api import sync_playwright

    with ExitStack() as stack:
        stack.callback(remove_objects, PREFIX)
        _, (plc, _) = (start(stack, "benchmarks.web_machine", role, PREFIX) for role in ("bridge", "plc"))

        def restart_plc() -> None:
            plc.kill()
            time.sleep(5)
            start(stack, "benchmarks.web_machine", "plc", PREFIX)

        stack.enter_context(calling_cell(PREFIX))
        _, served = start(stack, "rosplc", "web", "--prefix", PREFIX, "--port=0", "--allow-write", "--json")
        url = json.loads(served)["url"]
        browser = stack.enter_context(sync_playwright()).chromium.launch(
            executable_path="/usr/bin/chromium", args=["--no-sandbox"]
        )
        overview(browser, url, restart_plc)
        message(browser, url)
        plots(browser, url)
        write(browser, url)
        browser.close()


if __name__ == "__main__":
    main()
