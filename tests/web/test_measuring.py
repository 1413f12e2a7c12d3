"""The measurement of the page: that it works, not how long it takes."""

from __future__ import annotations

import shutil

import pytest


@pytest.mark.verify(minutes=0.5)
@pytest.mark.needs("chromium")
@pytest.mark.xdist_group("chromium")
@pytest.mark.timeout(600)
def test_the_pages_measurement_finds_every_channel_and_value() -> None:
    """One short round gives a time to load, an age for values, and the server's share of a core."""
    from benchmarks import web_page

    if shutil.which(web_page.CHROMIUM) is None:
        pytest.skip("Debian package chromium is missing")
    times, share = web_page.run(1, channels=20, updates=8)["tables"]
    assert [row["count"] > 0 and row["median"] > 0 for row in times["rows"]] == [True, True]
    assert len(share["rows"]) == 2
