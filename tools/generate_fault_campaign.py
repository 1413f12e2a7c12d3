"""Write the figures in docs/explanation/fault-campaign.md from the JSON of ``python -m soak``.

usage: python tools/generate_fault_campaign.py [RUN.json ...] [--verify]

What the runs are shown by is kept beside the figures in docs/images/soak, so that ``--verify`` can tell
whether every figure on the page is a measured one.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

from soak.draw import draw_recovery, draw_series  # noqa: E402
from soak.results import (  # noqa: E402
    cell_name,
    compact,
    processes,
    recovery_table,
    run_table,
    trend_table,
)

PAGE = ROOT / "docs" / "explanation" / "fault-campaign.md"
IMAGES = ROOT / "docs" / "images" / "soak"
RUNS = IMAGES / "runs.json"
BEGIN = "<!-- figures: begin; written by tools/generate_fault_campaign.py -->"
END = "<!-- figures: end -->"


def body(runs: list[dict[str, Any]]) -> list[str]:
    """Return the lines between the marks."""
    machine = runs[0]["machine"]
    versions = ", ".join(f"{name} {machine[name]}" for name in ("rosplc", "cyclonedds", "eclipse-zenoh"))
    rounds = sum(len(run["rounds"]) for run in runs)
    violations = [text for run in runs for text in run["violations"]]
    leaks = [one for run in runs for one in run["trends"] if one["leak"]]
    lines = [
        f"{rounds:,} rounds, {sum(run['messages'] for run in runs):,} messages, "
        f"{len(violations)} violations. {machine['processor']}, {machine['cores']} cores, "
        f"Linux {machine['kernel']}, Python {machine['python']}; {versions}; "
        f"ended {runs[-1]['machine']['ended']} UTC.",
        "",
        *run_table(runs),
        "",
    ]
    lines += [f"* {text}" for text in violations] + [""] * bool(violations)
    lines += [
        "### Recovery",
        "",
        "From the end of the fault until a message that was sent after it has come through on every topic. "
        "For a death the end is the start of the new process.",
        "",
        *recovery_table(runs),
        "",
        "![Each round's recovery time, by kind of fault](../images/soak/recovery.svg)",
        "",
        "### What each process held",
        "",
        f"{processes(runs):,} processes lived to the end of a round. Of each part of each cell the longest "
        "life: medians of its first and its last quarter, for memory of its second half, when it has "
        "settled. A rise counts as a leak by Mann's and Kendall's test for a trend, and by a size: "
        f"{len(leaks) or 'none'} did.",
        "",
        *trend_table(runs),
        "",
    ]
    for index, run in enumerate(runs, 1):
        lines += [
            f"![{cell_name(run)}: memory and descriptors over the rounds](../images/soak/cell-{index}.svg)",
            "",
        ]
    return lines


def page(runs: list[dict[str, Any]]) -> str:
    """Return the whole page with the runs' figures in their place."""
    before, _, rest = PAGE.read_text(encoding="utf-8").partition(BEGIN)
    _, _, after = rest.partition(END)
    return f"{before}{BEGIN}\n\n" + "\n".join(body(runs)).rstrip() + f"\n\n{END}{after}"


def main() -> int:
    """Write or compare the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("runs", type=Path, nargs="*")
    parser.add_argument("--verify", action="store_true", help="only say whether the page is up to date")
    arguments = parser.parse_args()
    if arguments.runs:
        runs = [compact(json.loads(path.read_text(encoding="utf-8"))) for path in arguments.runs]
    else:
        runs = json.loads(RUNS.read_text(encoding="utf-8"))
    if arguments.verify:
        if PAGE.read_text(encoding="utf-8") == page(runs):
            return 0
        print(f"{PAGE} is not what {RUNS} gives: run tools/generate_fault_campaign.py")
        return 1
    IMAGES.mkdir(parents=True, exist_ok=True)
    for old in IMAGES.glob("*.svg"):
        old.unlink()
    RUNS.write_text(json.dumps(runs, separators=(",", ":")) + "\n", encoding="utf-8")
    for index, run in enumerate(runs, 1):
        draw_series(run, IMAGES / f"cell-{index}.svg")
    draw_recovery(runs, IMAGES / "recovery.svg")
    PAGE.write_text(page(runs), encoding="utf-8")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
