"""``rosplc top`` and ``rosplc web`` watch the bridge of the folder's rosplc.yaml."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from tests.command import rosplc


class _Screen:
    """Stands for the terminal's screen: remembers what it was to show."""

    return_code = 0
    watched: list[Any]

    def __init__(self, watch: Any, interval: float) -> None:
        self.watched.append(watch)

    def run(self) -> None:
        """End at once."""


@pytest.mark.parametrize(("options", "expected"), [((), {"line7"}), (("--prefix", "line8"), {"line8"})])
@pytest.mark.parametrize("verb", ["top", "web"])
def test_the_folders_configuration_is_the_default(
    verb: str, options: tuple[str, ...], expected: set[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without --config and --prefix it is ./rosplc.yaml's bridge; a prefix takes its place."""
    pytest.importorskip("textual" if verb == "top" else "aiohttp")
    (tmp_path / "rosplc.yaml").write_text(
        "prefix: line7\ntopics:\n  /n: {type: std_msgs/msg/Int32, to: plc}\n"
    )
    monkeypatch.chdir(tmp_path)
    watched: list[Any] = []
    monkeypatch.setattr(_Screen, "watched", watched, raising=False)
    monkeypatch.setattr("rosplc.cli.top._check_terminal", lambda: None)
    monkeypatch.setattr("rosplc.monitor.terminal.TopApp", _Screen)
    monkeypatch.setattr("rosplc.web.serve", lambda settings, watch, **_: watched.append(watch))
    rosplc(verb, *options)
    assert set(watched[0].prefixes) == expected
