"""What `import rosplc` offers, and what it costs."""

from __future__ import annotations

import subprocess
import sys

import pytest

import rosplc
from rosplc import errors


@pytest.mark.parametrize("name", rosplc.__all__)
def test_every_export_can_be_had(name):
    """Each name in __all__ is there, shows in dir(), and is the same object each time."""
    assert getattr(rosplc, name) is getattr(rosplc, name)
    assert name in dir(rosplc)


def test_every_error_class_is_exported():
    """A program can catch any rosplc error by a name of the top package."""
    for name in errors.__all__:
        if isinstance(getattr(errors, name), type) and issubclass(getattr(errors, name), Exception):
            assert getattr(rosplc, name) is getattr(errors, name)


def test_a_wrong_name_is_an_attribute_error():
    """A misspelt export is reported as Python does."""
    with pytest.raises(AttributeError, match="no attribute 'atach'"):
        _ = rosplc.atach


def test_importing_rosplc_loads_neither_ros_nor_the_configuration():
    """`import rosplc` stays cheap: backends, typer and pydantic come only when they are used."""
    heavy = ("cyclonedds", "typer", "pydantic", "rosbags")
    code = f"import sys, rosplc; print([name for name in {heavy} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
