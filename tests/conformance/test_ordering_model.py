"""The exhaustive model of the ordering rules finds nothing in them, and finds what it is given."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

MODEL = Path(__file__).parents[2] / "spec" / "model"
sys.path.insert(0, str(MODEL))

from check import as_expected  # noqa: E402  (spec/model is no package: it must run without rosplc)
from explore import explore  # noqa: E402
from protocol import Config  # noqa: E402
from scenarios import HOLDS, HOLDS_WITHOUT, LARGE, LIMITS, MUTATIONS, Scenario  # noqa: E402

pytestmark = [
    pytest.mark.verifies("torn", own="an exhaustive model with each rule removed in turn"),
    pytest.mark.verifies("calls-once", own="an exhaustive model"),
]


def name(scenario: Scenario) -> str:
    return scenario.name


@pytest.mark.foreign
@pytest.mark.parametrize("scenario", HOLDS, ids=name)
def test_every_property_holds_in_every_interleaving(scenario: Scenario) -> None:
    """No interleaving of the specified steps breaks a property."""
    result = scenario.search()
    assert not result.violation, "\n".join((result.violation, *result.trace))
    assert as_expected(scenario, result)


@pytest.mark.parametrize("scenario", MUTATIONS, ids=name)
def test_a_missing_rule_is_found(scenario: Scenario) -> None:
    """With one rule taken away the search finds the property that it protects broken."""
    result = scenario.search()
    print(scenario.why, *result.trace, sep="\n")
    assert result.violation.startswith(scenario.breaks), result
    assert result.trace


@pytest.mark.parametrize("scenario", HOLDS_WITHOUT, ids=name)
def test_a_second_net_is_one(scenario: Scenario) -> None:
    """Rules documented as the second net under another one are exactly that."""
    assert as_expected(scenario, scenario.search())


@pytest.mark.foreign
@pytest.mark.parametrize("scenario", LIMITS, ids=name)
def test_a_documented_limit_is_real(scenario: Scenario) -> None:
    """What the documentation says is not promised does happen in the model."""
    result = scenario.search()
    assert result.violation.startswith(scenario.breaks), result


@pytest.mark.verify(minutes=0.25)
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("scenario", LARGE, ids=name)
def test_every_property_holds_in_larger_bounds(scenario: Scenario) -> None:
    """Larger bounds find nothing either."""
    result = scenario.search()
    assert not result.violation, "\n".join((result.violation, *result.trace))
    assert as_expected(scenario, result)


def test_names_of_scenarios_are_unique() -> None:
    """No scenario hides another of the same name."""
    names = [one.name for one in (*HOLDS, *MUTATIONS, *HOLDS_WITHOUT, *LIMITS, *LARGE)]
    assert len(names) == len(set(names))


def test_a_search_is_the_same_every_time() -> None:
    """Two searches visit the same states in the same order."""
    assert explore(Config(messages=4)) == explore(Config(messages=4))


def test_the_documented_command_shows_a_trace() -> None:
    """``check.py --trace`` prints the steps to a failure, and leaves with 0 since that was expected."""
    command = [sys.executable, str(MODEL / "check.py"), "--trace", "without F1, in order"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=120)
    assert done.returncode == 0, done.stderr
    assert "refuses 1" in done.stdout
