"""A headless Chromium, for tests of pages."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

CHROMIUM = "/usr/bin/chromium"
WATCHDOG_MS = 60_000


@contextmanager
def chromium() -> Iterator[Any]:
    """Debian's Chromium, driven by playwright; expectations wait for a minute."""
    from playwright.sync_api import expect, sync_playwright

    expect.set_options(timeout=WATCHDOG_MS)
    with sync_playwright() as driver:
        # Its sandbox needs rights that a container's root does not give away.
        browser = driver.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield browser
        browser.close()
