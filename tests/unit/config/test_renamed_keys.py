"""Keys with another name in 0.1.0: they work, are warned of, and can be rewritten in place."""

from __future__ import annotations

from pathlib import Path

import pytest
from typer.testing import CliRunner

from rosplc.cli.app import app
from rosplc.config import ConfigErrors, parse_config
from rosplc.config.file import RENAMED, rename_keys

OLD = """\
bridge: cell1   # the first cell
topics:
  # what the arm is told
  /a: {type: std_msgs/msg/Int32, to: plc, "depth": 8,   rate: 50Hz, qos: {depth: 7}}
  /b:
    type: std_msgs/msg/Int32
    to: ros
    'rate':   1kHz  # as measured
    depth: 64
"""
NEW = (
    OLD.replace('"depth": 8,   rate:', '"slots": 8,   expected_rate:')
    .replace("'rate':", "'expected_rate':")
    .replace("    depth: 64", "    slots: 64")
)


def test_former_names_work_and_are_warned_of(caplog: pytest.LogCaptureFixture) -> None:
    """They mean what the present ones mean, and a warning names file, line and the present name."""
    old = parse_config(OLD, name="c.yaml").settings
    assert [record.message.split(";")[0] for record in caplog.records] == [
        "c.yaml:4: topics./a.depth is now called slots",
        "c.yaml:4: topics./a.rate is now called expected_rate",
        "c.yaml:8: topics./b.rate is now called expected_rate",
        "c.yaml:9: topics./b.depth is now called slots",
    ]
    caplog.clear()
    assert parse_config(NEW, name="c.yaml").settings == old
    assert not caplog.records
    assert (old.topics["/a"].slots, old.topics["/a"].qos.depth) == (8, 7)


def test_both_names_at_once_are_refused() -> None:
    """The error is at the former name's line."""
    for old, new in RENAMED.items():
        text = f"topics:\n  /a:\n    type: a/b\n    to: plc\n    {new}: 10Hz\n    {old}: 10Hz\n"
        with pytest.raises(ConfigErrors, match=rf"c\.yaml:6: topics\./a\.{old}: .* also set"):
            parse_config(text, name="c.yaml")
        assert rename_keys(text) == (text, [])


@pytest.mark.parametrize("ends", ["\n", "\r\n"])
def test_the_file_is_rewritten_and_nothing_else_in_it(tmp_path: Path, ends: str) -> None:
    """Comments, layout, quotes, line ends, the byte order mark and the file's mode stay."""
    path = tmp_path / "c.yaml"
    path.write_bytes(b"\xef\xbb\xbf" + OLD.replace("\n", ends).encode())
    path.chmod(0o640)
    done = CliRunner().invoke(app, ["check", str(path), "--fix"])
    assert done.exit_code == 0, done.output
    assert path.read_bytes() == b"\xef\xbb\xbf" + NEW.replace("\n", ends).encode()
    assert path.stat().st_mode & 0o777 == 0o640
    assert [found.name for found in tmp_path.iterdir()] == ["c.yaml"]
    assert rename_keys(NEW) == (NEW, [])


@pytest.mark.parametrize(
    "text", ["", "topics:", "topics: [1]", "- 1", "topics: {/a: 5}", "bridge: ä\ntopics: {/a: {rate: 1Hz}}"]
)
def test_a_damaged_configuration_is_left_alone(text: str) -> None:
    """What has no such keys is returned unchanged; positions count characters."""
    after, changes = rename_keys(text)
    assert after == text.replace("rate", "expected_rate")
    assert len(changes) == text.count("rate")
