"""docs/reference/python-api.md is generated from docstrings, and leaves out nothing that programs may use."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

import rosplc
from docstrings import describe, signature
from rosplc.errors import RosplcError

pytestmark = pytest.mark.verifies("generated", own="rosplc alone")

ROOT = Path(__file__).resolve().parents[2]
TOOL = ROOT / "tools" / "generate_api_reference.py"
PAGE = ROOT / "docs" / "reference" / "python-api.md"


def test_every_public_name_is_on_the_page() -> None:
    """What `rosplc` exports is described, once."""
    text = PAGE.read_text(encoding="utf-8")
    headings = re.findall(r"^### (\w+)$", text, re.MULTILINE)
    assert len(headings) == len(set(headings))
    errors = {name for name in rosplc.__all__ if isinstance(getattr(rosplc, name), type)} & {
        cls.__name__ for cls in (RosplcError, *RosplcError.__subclasses__())
    }
    assert set(rosplc.__all__) - errors - {"__version__"} <= set(headings)
    assert all(f"`{name}`" in text for name in errors)


@pytest.mark.parametrize("entry", ["Channel", "ReadBlock", "TypeStore"])
def test_every_method_has_words(entry: str) -> None:
    """A signature alone tells nobody when to use it."""
    (section,) = re.findall(
        rf"^### {entry}\n(.*?)^##", PAGE.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL
    )
    members = re.split(r"^\*\*`", section, flags=re.MULTILINE)[1:]
    assert len(members) > 3
    for member in members:
        assert len(member.partition("`**")[2].split()) > 2, member


def carry(topic: str, *, mode: int = 0o640, limit: float = 1.5) -> None:
    """Carry a topic; see :meth:`Channel.read`.

    Longer, with ``code``::

        carry("/a")

    Args:
        topic: As ROS writes it: ``"/a"``,
            and never else.
        mode: Bits.
        limit: Seconds.

    Raises:
        ValueError: Never.
    """


def test_a_docstring_becomes_markdown() -> None:
    """Sections become lists, roles become code, examples are blocks that are not run."""
    assert describe(carry) == (
        'Carry a topic; see `Channel.read`.\n\nLonger, with `code`:\n\n```text\ncarry("/a")\n```\n\n'
        '*Arguments*\n\n* `topic`: As ROS writes it: `"/a"`,\n  and never else.\n* `mode`: Bits.\n'
        "* `limit`: Seconds.\n\n"
        "*Raises*\n\n* `ValueError`: Never."
    )


def test_a_signature_reads_as_in_the_source() -> None:
    """Annotations without quotes, permission bits in octal; long ones get a line per argument."""
    assert signature("carry", carry) == "carry(topic: str, *, mode: int = 0o640, limit: float = 1.5)"
    assert signature("carry", carry, width=30).splitlines()[1:3] == ["    topic: str,", "    *,"]
