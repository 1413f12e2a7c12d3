"""Write the results in docs/explanation/comparison.md from a report of ``rosplc-bench --full --out DIR``.

usage: python tools/generate_comparison.py [DIR/report.json] [--verify]

The report itself is kept beside the figures in docs/images/bench, so that ``--verify`` can tell whether
every figure on the page is a measured one.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from generated_page import ROOT, filled, write_or_verify
from rosplc_bench.cli import SECTIONS
from rosplc_bench.draw import draw
from rosplc_bench.report import Report, markdown_body, render

DOCS = ROOT / "docs"
PAGE = DOCS / "explanation" / "comparison.md"
IMAGES = DOCS / "images" / "bench"
REPORT = IMAGES / "report.json"


def page(report: Report) -> str:
    """Return the whole page with the report's results in their place."""
    return filled(PAGE, {"results": "\n".join(markdown_body(report, SECTIONS, "../images/bench/"))})


def main() -> int:
    """Write or compare the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("report", type=Path, nargs="?", default=REPORT)
    parser.add_argument("--verify", action="store_true", help="only say whether the page is up to date")
    arguments = parser.parse_args()
    report = Report.from_json(arguments.report.read_text(encoding="utf-8"), str(arguments.report))
    if arguments.verify:
        return write_or_verify(PAGE, page(report), verify=True)
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
