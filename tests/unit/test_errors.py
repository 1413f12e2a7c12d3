"""The error tree: codes, texts, and the page generated from them."""

from __future__ import annotations

import pickle
import re
from pathlib import Path

import pytest

from rosplc import errors
from rosplc.errors import CODES, ChannelError, LayoutError, RosplcError

ROOT = Path(__file__).resolve().parents[2]
FAMILIES = {cls.family: cls for cls in RosplcError.__subclasses__()}


@pytest.mark.parametrize("code", sorted(CODES))
def test_every_code_belongs_to_one_family_and_says_what_helps(code: str) -> None:
    """A code is a family's three letters and three digits, with a title and a remedy."""
    assert re.fullmatch(r"[A-Z]{3}[0-9]{3}", code)
    assert code[:3] in FAMILIES
    info = CODES[code]
    assert info.code == code
    assert info.title and not info.title.endswith(".")
    assert info.remedy.endswith(".")


def test_every_family_has_codes() -> None:
    """No error class exists without a code to raise it with."""
    assert {code[:3] for code in CODES} == set(FAMILIES)


def test_a_code_is_registered_once() -> None:
    """A second registration of a code is refused, so meanings cannot change by accident."""
    with pytest.raises(ValueError, match="registered twice"):
        errors._register("SHM101", "something else", "Nothing.")


def test_text_has_place_event_code_and_remedy() -> None:
    """The text reads: place, what happened, code, what helps."""
    error = ChannelError("SHM112", "layout 0123 where 4567 is expected", where="/dev/shm/rosplc.t.a")
    assert str(error) == (
        "/dev/shm/rosplc.t.a: layout 0123 where 4567 is expected [SHM112] " + CODES["SHM112"].remedy
    )


def test_own_remedy_replaces_the_usual_one() -> None:
    """A remedy given with the error is the one that is shown."""
    error = LayoutError("LAY001", "capacity 0", remedy="Use 1.")
    assert error.remedy == "Use 1."
    assert str(error) == "capacity 0 [LAY001] Use 1."


def test_error_is_plain_data_for_machines() -> None:
    """to_dict gives exactly the four parts, for --json output."""
    error = ChannelError("SHM101", "gone", where="/a", remedy="Start it.")
    assert error.to_dict() == {"code": "SHM101", "what": "gone", "where": "/a", "remedy": "Start it."}


@pytest.mark.parametrize(("family", "cls"), sorted(FAMILIES.items()))
def test_error_survives_pickling(family: str, cls: type[RosplcError]) -> None:
    """Errors cross process borders without losing a part."""
    code = next(code for code in sorted(CODES) if code.startswith(family))
    error = cls(code, "what", where="where", remedy="remedy")
    again = pickle.loads(pickle.dumps(error))
    assert type(again) is cls
    assert again.to_dict() == error.to_dict()
    assert str(again) == str(error)


@pytest.mark.parametrize("code", ["SHM999", "LAY001", "", "SHM"])
def test_code_of_another_family_or_none_is_refused(code: str) -> None:
    """An error cannot be raised with a code that its class does not have."""
    with pytest.raises(ValueError, match="not a registered code of ChannelError"):
        ChannelError(code, "what")


def test_plc_error_numbers_are_those_of_the_specification() -> None:
    """Section 9 of the format and the SHM codes name the same numbers."""
    text = (ROOT / "spec" / "shm-format.md").read_text(encoding="utf-8")
    section = text[text.index("## 9.") : text.index("## 10.")]
    table = {int(number) for number in re.findall(r"^\| (\d{3}) \|", section, re.MULTILINE)}
    prose = section[section.index("Further numbers") :].split("\n\n", 1)[0]
    further = {int(number) for number in re.findall(r"\b(1\d\d)\b", prose)}
    assert table | further == {int(code[3:]) for code in CODES if code.startswith("SHM")}


def test_every_code_has_its_place_on_the_page() -> None:
    """A family that the generator does not know would be left out in silence."""
    page = (ROOT / "docs" / "reference" / "errors.md").read_text(encoding="utf-8")
    assert set(re.findall(r"^### (\w+)$", page, re.MULTILINE)) == set(CODES)


def test_every_code_named_in_the_sources_is_registered() -> None:
    """A misspelt code in a raise would otherwise only show when it is raised."""
    families = "|".join(FAMILIES)
    for path in sorted((ROOT / "src").rglob("*.py")):
        for code in re.findall(rf'"((?:{families})\d{{3}})"', path.read_text(encoding="utf-8")):
            assert code in CODES, f"{path.name} names {code}"
