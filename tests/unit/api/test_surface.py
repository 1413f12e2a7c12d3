"""What `import rosplc` offers, and what it costs."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

import rosplc
from rosplc import errors

ROOT = Path(__file__).parents[3]


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


def test_a_configuration_is_loaded_checked_and_generated_without_the_command(tmp_path):
    """The public functions take a file or a loaded project, and never import the command line."""
    file = tmp_path / "rosplc.yaml"
    file.write_text("ros: {backend: memory}\ntopics:\n  /a: {type: std_msgs/String, to: plc}\n")
    code = (
        "import sys, rosplc\n"
        f"project = rosplc.load_project({str(file)!r})\n"
        "print(rosplc.check(project)['topics']['/a']['limits'])\n"
        f"print(len(rosplc.generate(project, {str(tmp_path / 'plc')!r}).written) > 10)\n"
        "print([name for name in sys.modules if name.startswith('rosplc.cli') or name == 'typer'])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines() == ["{'data': 80}", "True", "[]"]
    with pytest.raises(rosplc.ConfigErrors):
        rosplc.check(tmp_path / "missing.yaml")


def test_the_contracts_name_every_target_of_a_dynamic_import():
    """What the registry imports by name is what the contract holds apart."""
    from rosplc.ros.choice import BACKENDS

    text = (ROOT / "pyproject.toml").read_text()
    contract = text.partition("The backends of the registry")[2].partition("modules = [")[2].partition("]")[0]
    assert set(re.findall(r'"([\w.]+)"', contract)) == set(BACKENDS.values())
    source = (ROOT / "src/rosplc/__init__.py").read_text()
    shown = set(re.findall(r"^    from (rosplc[\w.]*) import", source, re.MULTILINE))
    assert set(rosplc._HOME.values()) == shown
