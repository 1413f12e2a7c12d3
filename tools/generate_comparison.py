"""Write the results in docs/explanation/comparison.md from a report of ``rosplc-bench --full --out DIR``.

usage: python tools/generate_comparison.py [DIR/report.json] [--verify]

And those of services in performance.md, from what ``make bench-services`` has measured. The reports are kept
beside the figures in docs/images/bench, so that ``--verify`` can tell whether every figure is a measured one.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from generated_page import ROOT, filled, write_or_verify
from rosplc_bench.cli import SECTIONS
from rosplc_bench.draw import draw
from rosplc_bench.report import Report, markdown_body, render

DOCS = ROOT / "docs"
PAGE = DOCS / "explanation" / "comparison.md"
IMAGES = DOCS / "images" / "bench"
REPORT = IMAGES / "report.json"
PERFORMANCE = DOCS / "explanation" / "performance.md"
SERVICES = IMAGES / "services.json"


def page(report: Report) -> str:
    """Return the whole page with the report's results in their place."""
    return filled(PAGE, {"results": "\n".join(markdown_body(report, SECTIONS, "../images/bench/"))})


def services() -> str:
    """Return the page on performance with the round trips of services, if they were measured."""
    shown = "No figures yet: `make bench-services` writes them here."
    if SERVICES.exists():
        shown = round_trips(json.loads(SERVICES.read_text(encoding="utf-8")))
    return filled(PERFORMANCE, {"services": shown})


def round_trips(report: dict[str, Any]) -> str:
    """Return what ``benchmarks.bench_services --json`` has printed, as tables."""
    where, lines = report["environment"], []
    for table in report["tables"]:
        lines += [
            f"| {table['title']}, {table['unit']} | median | p99 | ratio | all rounds | unanswered |",
            "| --- | ---: | ---: | ---: | ---: | ---: |",
            *(
                f"| {row['name']} | {row['median']:.0f} | {row['p99']:.0f} | {row['to bare']:.2f} "
                f"| {row['lowest']:.2f} to {row['highest']:.2f} "
                f"| {row['unanswered']} of {row['count'] + row['unanswered']} |"
                for row in table["rows"]
            ),
            "",
            *(f"*{name}: {why}.*\n" for name, why in table["facts"].items()),
        ]
    versions = ", ".join(f"{name} {where['versions'].get(name, '')}" for name in ("rosplc", "cyclonedds"))
    kind = "virtual machine" if where["virtual"] else "machine"
    lines += [
        f"*Waiting: {report['tables'][0]['waiting']}.*",
        f"{where['processor']}, {kind} with {where['cores']} cores, {where['kernel']}, "
        f"Python {where['python']}, {versions}, {where['when']}; load {where['load_before'][0]} before "
        f"and {where['load_after'][0]} after.",
    ]
    return "\n".join(lines)


def main() -> int:
    """Write or compare the pages."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("report", type=Path, nargs="?", default=REPORT)
    parser.add_argument("--verify", action="store_true", help="only check whether the page is up to date")
    arguments = parser.parse_args()
    report = Report.from_json(arguments.report.read_text(encoding="utf-8"), str(arguments.report))
    status = write_or_verify(PERFORMANCE, services(), verify=arguments.verify)
    if arguments.verify:
        return max(status, write_or_verify(PAGE, page(report), verify=True))
    IMAGES.mkdir(parents=True, exist_ok=True)
    for old in (*IMAGES.glob("*.svg"), *IMAGES.glob("*.png")):
        old.unlink()
    REPORT.write_text(json.dumps(report.to_dict()) + "\n", encoding="utf-8")
    for shown in render(report, SECTIONS).values():
        for figure in shown.figures:
            for path in draw(figure, IMAGES):
                if path.suffix == ".png":
                    path.unlink()  # the page shows the SVG
    return write_or_verify(PAGE, page(report), verify=False)


if __name__ == "__main__":
    raise SystemExit(main())
