"""Every kind of finding appears on a machine that has the problem, and not on one without it."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from rosplc.doctor import KINDS, Area, Level
from rosplc.shm import Namespace
from tests.unit.doctor.cases import CASES
from tests.unit.doctor.stage import Stage, problems

pytestmark = pytest.mark.verifies("doctor", own="simulation of each problem")

ROOT = Path(__file__).resolve().parents[3]
NEEDS_ROOT = {"DOC218"}


@pytest.fixture
def stage(tmp_path: Path, shm_namespace: Namespace) -> Iterator[Stage]:
    stage = Stage(tmp_path, shm_namespace)
    yield stage
    for each in stage.kept:
        if hasattr(each, "close"):
            each.close()


def test_every_kind_has_a_case() -> None:
    """No kind of finding is in the table without a machine that has it and one that has not."""
    missing = set(KINDS) - set(CASES)
    assert missing <= (set() if os.geteuid() == 0 else NEEDS_ROOT)
    assert set(CASES) <= set(KINDS)


@pytest.mark.parametrize("code", sorted(CASES))
def test_a_problem_is_found(code: str, stage: Stage) -> None:
    """A machine with the problem gives the finding, in its area, with what to do."""
    found = problems(CASES[code][0](stage))
    assert code in found
    finding = found[code]
    assert finding.area is KINDS[code].area or KINDS[code].area is Area.DOCTOR
    assert finding.seen and not finding.seen.endswith(".")
    assert finding.remedy.endswith(".")


@pytest.mark.parametrize("code", sorted(CASES))
def test_a_problem_that_is_not_there_is_not_found(code: str, stage: Stage) -> None:
    """The same machine without the problem does not give the finding."""
    assert code not in problems(CASES[code][1](stage))


@pytest.mark.parametrize("code", sorted(KINDS))
def test_the_table_is_complete(code: str) -> None:
    """A kind has a code of three letters and three digits, a title, a meaning and a remedy."""
    kind = KINDS[code]
    assert re.fullmatch(r"DOC[0-9]{3}", code) and kind.code == code
    assert kind.level > Level.OK
    assert kind.title and not kind.title.endswith(".")
    assert kind.meaning.endswith(".") and kind.remedy.endswith(".")
