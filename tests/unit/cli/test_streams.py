"""Standard streams that are closed, full, or in a narrow character set."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

CHECK_FDS = """
import os, sys
from rosplc.cli import prepare_streams
prepare_streams()
fd = os.open(sys.argv[1], os.O_RDONLY)
assert fd > 2, fd
print("seen by nobody", file=sys.stderr)
os.write(2, b"nor this")
"""


def shell(command, *arguments, **environment):
    return subprocess.run(
        ["sh", "-c", command, "sh", sys.executable, *map(str, arguments)],
        capture_output=True,
        timeout=60,
        env={**os.environ, **environment},
    )


@pytest.fixture
def config(tmp_path):
    path = tmp_path / "rosplc.yaml"
    path.write_text("topics: {/a: {type: std_msgs/msg/Bool, to: plc}}\n")
    return path


def test_closed_streams_catch_no_other_file(tmp_path):
    """With all three closed, the next file that is opened is none of them, and nothing is written into it."""
    victim = tmp_path / "object"
    victim.write_bytes(b"untouched")
    done = shell('exec "$1" -c "$3" "$2" <&- >&- 2>&-', victim, CHECK_FDS)
    assert done.returncode == 0
    assert victim.read_bytes() == b"untouched"


@pytest.mark.foreign
@pytest.mark.parametrize("closed", [">&-", "2>&-", "<&- >&- 2>&-"])
def test_closed_streams_are_no_error(config, closed):
    """A verb does its work without a stream to say it on."""
    done = shell(f'exec "$1" -m rosplc check "$2" {closed}', config)
    assert (done.returncode, done.stderr) == (0, b"")


@pytest.mark.foreign
@pytest.mark.parametrize("as_json", ["", "--json"])
def test_full_output_is_an_error(config, as_json):
    """Output that cannot be written ends with SYS005."""
    done = shell(f'exec "$1" -m rosplc check "$2" {as_json} >/dev/full', config)
    assert done.returncode == 1
    assert b"SYS005" in done.stderr
    assert b"Exception" not in done.stderr


@pytest.mark.foreign
def test_a_narrow_character_set_is_no_error(config):
    """What the terminal cannot show is written as an escape."""
    done = shell('exec "$1" -m rosplc check "$2"', config, PYTHONIOENCODING="latin-1")
    assert (done.returncode, done.stderr) == (0, b"")
    assert b"ROS \\u2192 PLC" in done.stdout
