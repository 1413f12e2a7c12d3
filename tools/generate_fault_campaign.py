"""Write the figures in docs/explanation/fault-campaign.md from the JSON of ``python -m tests.soak``.

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

from generated_page import ROOT, filled, write_or_verify

sys.path.insert(0, str(ROOT))

from tests.soak.draw import draw_recovery, draw_series
from tests.soak.results import cell_name, compact, processes, recovery_table, run_table, trend_table

PAGE = ROOT / "docs" / "explanation" / "fault-campaign.md"
IMAGES = ROOT / "docs" / "images" / "soak"
RUNS = IMAGES / "runs.json"


def drawn(runs: list[dict[str, Any]]) -> dict[str, dict[str, Any]]:
    """Return, by the names of their figures, the longest run of each kind of cell."""
    longest: dict[str, dict[str, Any]] = {}
    for run in runs:
        name = cell_name(run)
        if name not in longest or len(run["rounds"]) > len(longest[name]["rounds"]):
            longest[name] = run
    return {f"cell-{number}.svg": run for number, run in enumerate(longest.values(), 1)}


def body(runs: list[dict[str, Any]]) -> list[str]:
    """Return the lines between the marks."""
    machine = runs[0]["machine"]
    versions = ", ".join(f"{name} {machine[name]}" for name in ("rosplc", "cyclonedds", "eclipse-zenoh"))
    rounds = sum(len(run["rounds"]) for run in runs)
    violations = [f"seed {run['seed']}, {text}" for run in runs for text in run["violations"]]
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
    if violations:
        lines += ["Violations:", "", *(f"* {text}" for text in violations), ""]
    lines += [
        "### Recovery",
        "",
        "The recovery time is measured from the end of the fault until every topic has delivered a "
        "message that was sent after the fault. If a process was killed, the fault ends when the new "
        "process starts. The successor of a killed PLC waits for three missed beats (of 100 ms each), and "
        "a lock whose holder is dead is freed after `recover_after` (2 s). For a fault with few rounds, "
        "p99 is the longest recovery time. The table includes only runs whose PLC and ROS nodes were "
        "forked: in other runs, starting Python takes most of the recovery time.",
        "",
        *recovery_table(runs),
        "",
        "![Each round's recovery time, by kind of fault](../images/soak/recovery.svg)",
        "",
        "### Resources of each process",
        "",
        f"{processes(runs):,} processes survived until the end of a round. For each component in each kind "
        "of cell, the table shows the process that lived longest, with the medians over the first and the "
        "last quarter of its lifetime. For memory, the first half of its lifetime is left out, because "
        "memory usage has not settled by then. The bridge's descriptor counts exclude the lock files "
        "of objects. An increase counts as a leak if the Mann-Kendall trend test detects it and if it "
        f"exceeds the limit in the table of claims. Leaks: {len(leaks) or 'none'}. The DDS library keeps "
        "8 KiB of memory for each node that has connected, until the library's buffers are full, and 0.2 KiB "
        "for each topic that has been opened.",
        "",
        *trend_table(runs),
        "",
    ]
    for name, run in drawn(runs).items():
        text = f"{cell_name(run)}, seed {run['seed']}: memory and descriptors over the rounds"
        lines += [f"![{text}](../images/soak/{name})", ""]
    return lines


def page(runs: list[dict[str, Any]]) -> str:
    """Return the whole page with the runs' figures in their place."""
    return filled(PAGE, {"figures": "\n".join(body(runs))})


def main() -> int:
    """Write or compare the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("runs", type=Path, nargs="*")
    parser.add_argument("--verify", action="store_true", help="only check whether the page is up to date")
    arguments = parser.parse_args()
    if arguments.runs:
        runs = [compact(json.loads(path.read_text(encoding="utf-8"))) for path in arguments.runs]
    else:
        runs = json.loads(RUNS.read_text(encoding="utf-8"))
    if arguments.verify:
        return write_or_verify(PAGE, page(runs), verify=True)
    IMAGES.mkdir(parents=True, exist_ok=True)
    for old in IMAGES.glob("*.svg"):
        old.unlink()
    RUNS.write_text(json.dumps(runs, separators=(",", ":")) + "\n", encoding="utf-8")
    for name, run in drawn(runs).items():
        draw_series(run, IMAGES / name)
    draw_recovery(runs, IMAGES / "recovery.svg")
    return write_or_verify(PAGE, page(runs), verify=False)


if __name__ == "__main__":
    raise SystemExit(main())
