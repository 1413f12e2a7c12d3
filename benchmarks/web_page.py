"""How long `rosplc web` takes with 200 channels in Chromium: to load, and to show a value.

    python -m benchmarks.web_page [--rounds N] [--json]

A process in the bridge's place writes 200 channels. "Loaded" is from the navigation's start until the row
of the last channel is drawn; "a value" from the moment at which a message was written until the
browser has changed the text of its field. Server and browser share the machine with the writer.
"""

from __future__ import annotations

import secrets
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any

from benchmarks import measure
from benchmarks.processes import cpu_seconds, environment
from benchmarks.views import web
from benchmarks.web_machine import COMMANDS, SOURCES, UNUSED
from rosplc import bind
from rosplc.demo.processes import remove_objects
from rosplc_bench.process import Side

CHROMIUM = "/usr/bin/chromium"
CHANNELS = 200
TOPIC = "/line/time"
UPDATES = 60
MILLISECONDS = 60_000

LOADED = """(count) => {
  if (document.querySelectorAll("tr.channel").length < count) return null;
  return new Promise((resolve) => requestAnimationFrame(() => resolve(performance.now())));
}"""
COLLECT = """() => {
  const field = document.querySelector(".leaf .field-value");
  if (!field) return false;
  window.ages = [];
  new MutationObserver(() => window.ages.push(Date.now() - Number(field.textContent)))
    .observe(field, {childList: true, characterData: true, subtree: true});
  return true;
}"""


def run(rounds: int, channels: int = CHANNELS, updates: int = UPDATES) -> dict[str, Any]:
    """Measure in ``rounds`` rounds; returns a :func:`measure.report`."""
    from playwright.sync_api import sync_playwright

    before = measure.environment()
    loaded: list[float] = []
    ages: list[float] = []
    idle: list[float] = []
    busy: list[float] = []
    with sync_playwright() as driver, _machine(channels) as (prefix, url, pid):
        # Its sandbox needs rights that a container's root does not give away.
        browser = driver.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        with bind(TOPIC, "std_msgs/msg/Int64", prefix=prefix, name="cell1") as clock:
            for _ in range(rounds):
                idle.append(_share(pid, partial(time.sleep, 2.0)))
                page = browser.new_context(viewport={"width": 1440, "height": 900}).new_page()
                page.set_default_timeout(MILLISECONDS)
                page.goto(url)
                loaded.append(page.wait_for_function(LOADED, arg=channels + 1).json_value())
                page.goto(f"{url}#/channels/{prefix}.t.line.time")
                clock.write({"data": 0})
                page.wait_for_function(COLLECT)
                busy.append(_share(pid, partial(_tick, clock, updates, page)))
                ages += page.evaluate("window.ages")
                page.context.close()
        browser.close()
    waiting = "the server polls a message 20 times per second and all channels twice, and sends 10 times"
    rows = [
        measure.row("page loaded, every channel drawn", loaded),
        measure.row("a value, written to shown", ages),
    ]
    share = [measure.row("server, no page", idle), measure.row("server, one page with a message open", busy)]
    title = f"{channels} channels"
    return measure.report(
        [
            measure.table(title, "ms", waiting, rows),
            measure.table(f"{title}: CPU", "% of a core", waiting, share),
        ],
        before,
    )


def _tick(clock: Any, updates: int, page: Any) -> None:
    # The page's driver must be served meanwhile, so the writer is a thread.
    def write() -> None:
        for _ in range(updates):
            clock.write({"data": time.time_ns() // 1_000_000})
            time.sleep(0.1)

    writer = threading.Thread(target=write)
    writer.start()
    while writer.is_alive():
        page.wait_for_timeout(50)
    writer.join()


def _share(pid: int, work: Any) -> float:
    used, began = sum(cpu_seconds(pid)), time.monotonic()
    work()
    return 100 * (sum(cpu_seconds(pid)) - used) / (time.monotonic() - began)


@contextmanager
def _machine(channels: int) -> Iterator[tuple[str, str, int]]:
    prefix = f"bench-{secrets.token_hex(4)}"
    more = channels - len(SOURCES) - len(COMMANDS) - len(UNUSED)
    command = [sys.executable, "-m", "benchmarks.web_machine", "bridge", prefix, str(more)]
    try:
        with Side("machine", command, environment(0)) as machine, web(prefix) as (url, pid):
            machine.receive()
            yield prefix, url, pid
    finally:
        remove_objects(prefix)


if __name__ == "__main__":
    measure.main(run, __doc__, 5)
