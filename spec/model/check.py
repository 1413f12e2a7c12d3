"""Search the channel protocol exhaustively, and show that the search finds violations.

    python spec/model/check.py                   what must hold, what must fail (under a minute)
    python spec/model/check.py --large           bigger bounds (minutes)
    python spec/model/check.py --trace "without F1"   the shortest way to each matching failure

Requires only Python 3.10. The exit status is 1 if a property that must hold breaks, or one that must
break holds.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence

from explore import Result
from scenarios import HOLDS, HOLDS_WITHOUT, LARGE, LIMITS, MUTATIONS, Scenario

__all__ = ["as_expected", "main"]

GROUPS = {
    "must hold": HOLDS,
    "must fail: one rule taken away": MUTATIONS,
    "holds without one rule: another rule covers it": HOLDS_WITHOUT,
    "known limits": LIMITS,
}


def as_expected(scenario: Scenario, result: Result) -> bool:
    """Return whether the search has the expected result and tested at least one acceptance."""
    if scenario.breaks:
        return result.violation.startswith(scenario.breaks)
    return not result.violation and result.accepted > 0


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the searches and print a line for each; return the exit status."""
    raw = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=raw)
    parser.add_argument("--large", action="store_true", help="bigger bounds")
    parser.add_argument("--trace", metavar="NAME", help="only scenarios of this name, with their steps")
    options = parser.parse_args(arguments)
    groups = {"must hold, bigger bounds": LARGE} if options.large else GROUPS
    wrong = 0
    for title, scenarios in groups.items():
        chosen = [one for one in scenarios if not options.trace or options.trace in one.name]
        if chosen:
            print(f"\n{title}\n{'states':>10} {'seconds':>8}")
        for scenario in chosen:
            begin = time.monotonic()
            result = scenario.search()
            seconds = time.monotonic() - begin
            right = as_expected(scenario, result)
            wrong += not right
            found = result.violation or "every property holds"
            mark = "" if right else "  <-- NOT AS EXPECTED"
            print(f"{result.states:>10} {seconds:>8.1f}  {scenario.name}: {found}{mark}", flush=True)
            if options.trace:
                print(f"{'':20}why: {scenario.why}" if scenario.why else "")
                print("".join(f"{'':20}{line}\n" for line in result.trace))
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
