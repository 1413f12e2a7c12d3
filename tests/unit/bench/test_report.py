"""A report is plain data: it survives JSON and is rendered from it alone."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from rosplc.errors import SetupError
from rosplc_bench.draw import Figure, Series, cell_text, draw
from rosplc_bench.report import (
    SCHEMA,
    Failure,
    Measured,
    Page,
    Report,
    Section,
    Skip,
    Table,
    markdown,
    render,
    summary,
    write,
)

MACHINE = {
    "when": "2026-01-01T00:00:00+00:00",
    "processor": "a board",
    "architecture": "armv7l",
    "cores": 1,
    "virtual": False,
    "governor": "performance",
    "kernel": "Linux 6",
    "memory_mib": 512,
    "python": "3.11",
    "compiler": "gcc 12",
    "libmodbus": "3.1.6",
    "versions": {"rosplc": "0", "pymodbus": "none"},
    "load_before": [0.1, 0.2, 0.3],
    "load_after": [1.0, 1.0, 1.0],
}


def page(data: dict[str, float]) -> Page:
    """Show one number as everything that a page has."""
    value = data["value"]
    return Page(
        lead=("Before.",),
        tables=(
            Table("Times (µs)", ("", "p50"), (("we", value), ("they|them", None)), "both spin", "A note."),
        ),
        figures=(Figure("times", "Times", "n", "µs", (Series("we", (1, 10), (value, value)),), y_log=True),),
        after=("After.",),
        summary=(f"We take {value} µs.",),
    )


SECTIONS = {"one": Section("one", "Section one", "Is it so?", lambda _: {}, page)}


def report(value: float = 3.0) -> Report:
    measured = Measured("one", 1.5, {"value": value}, (Skip("they", "no gcc", "install it"),))
    options = {"effort": {"name": "quick", "rounds": 1}, "only": []}
    return Report(MACHINE, options, (measured,))


def test_a_report_survives_json() -> None:
    """What was written is read back equal, and names its schema."""
    text = json.dumps(report().to_dict())
    assert json.loads(text)["schema"] == SCHEMA
    assert Report.from_json(text) == report()


@pytest.mark.parametrize(
    "text", ["", "{}", "[]", '{"schema": "rosplc-bench 0"}', '{"schema": "rosplc-bench 1"}']
)
def test_what_is_no_report_is_refused(text: str) -> None:
    """Anything else than a report of this schema is SYS007."""
    with pytest.raises(SetupError) as caught:
        Report.from_json(text, "x.json")
    assert caught.value.code == "SYS007"


def test_a_report_of_another_release_is_refused() -> None:
    """A section that is unknown, or that lacks a figure, is SYS007 and no traceback."""
    with pytest.raises(SetupError, match="does not have a section"):
        render(report(), {})
    broken = Report(MACHINE, report().options, (Measured("one", 1.0, {"other": 1.0}),))
    with pytest.raises(SetupError, match="is incomplete"):
        render(broken, SECTIONS)


def test_what_is_shown_follows_the_data() -> None:
    """The same section with another value shows another summary; a skip is named with its remedy."""
    for value in (3.0, 1.0):
        text = "\n".join(summary(report(value), SECTIONS))
        assert f"We take {value} µs." in text
        assert "skipped: they: no gcc; install it" in text


def test_the_page_holds_everything_with_its_waiting() -> None:
    """Machine, figures and tables are in the Markdown, and how one waited below each table."""
    text = markdown(report(), SECTIONS, "images/")
    for part in (
        "a board",
        "![Times](images/times.svg)",
        "| we | 3.00 |",
        "| they\\|them |  |",
        "Before.",
        "After.",
    ):
        assert part in text
    assert "*Waiting: both spin.* A note." in text
    assert "Not measured: they: no gcc (install it)" in text


def test_a_busy_machine_is_named() -> None:
    """Where other programs ran, page and summary warn of the ratios; on a quiet machine they do not."""
    loaded = Report({**MACHINE, "load_before": [0.9, 0.2, 0.3]}, report().options, report().sections)
    for found, words in ((loaded, True), (report(), False)):
        assert ("Other programs were running" in markdown(found, SECTIONS)) is words
        assert ("Other programs were running" in "\n".join(summary(found, SECTIONS))) is words


def test_lines_fit_the_terminal() -> None:
    """No sentence of the summary is wider than the terminal; a table's rows stay as they are."""
    row = " row " + "x" * 75
    section = Section("one", "One", "Who?", lambda _: {}, lambda _: Page(summary=("word " * 60, row)))
    lines = list(summary(report(), {"one": section}, 60))
    assert row in lines
    assert all(len(line) <= 60 for line in lines if line != row)


def test_failures_stand_in_page_and_summary() -> None:
    """A report with a failure is not good, and says so in both."""
    failed = Report(MACHINE, report().options, (Measured("one", 1.0, {}, (), (Failure("we", "torn"),)),))
    assert report().good and not failed.good
    assert "Failed: we" in markdown(failed, SECTIONS)
    assert "FAILED: we: torn" in "\n".join(summary(failed, SECTIONS))


@pytest.mark.parametrize(
    ("cell", "text"),
    [
        (None, ""),
        (0.0, "0"),
        (0.00192, "0.00192"),
        (9.996, "10.0"),
        (999.6, "1,000"),
        (16_700_000.0, "16,700,000"),
        (12345, "12,345"),
        ("text", "text"),
        (float("inf"), "inf"),
    ],
)
def test_numbers_have_three_digits(cell: float | str | None, text: str) -> None:
    """Measured numbers are shown with three significant digits, counts whole."""
    assert cell_text(cell) == text


def test_files_of_a_report(tmp_path: Path) -> None:
    """A folder gets report.json, report.md and each figure twice; the JSON is the report."""
    pytest.importorskip("matplotlib")
    files = write(report(), SECTIONS, tmp_path / "new" / "folder")
    assert [path.name for path in files] == ["report.json", "report.md", "times.png", "times.svg"]
    assert Report.from_json(files[0].read_text()) == report()
    assert files[2].read_bytes().startswith(b"\x89PNG")
    assert "<svg" in files[3].read_text()


def test_a_folder_that_cannot_be_written(tmp_path: Path) -> None:
    """A file in the folder's place is SYS005."""
    (tmp_path / "file").write_text("")
    with pytest.raises(SetupError) as caught:
        write(report(), SECTIONS, tmp_path / "file")
    assert caught.value.code == "SYS005"


def test_a_figure_is_the_same_for_the_same_data(tmp_path: Path) -> None:
    """Drawing twice gives the same bytes, so that a page's images change only with its figures."""
    pytest.importorskip("matplotlib")
    bars = Figure(
        "b",
        "Bars",
        "",
        "µs",
        (Series("a", (), (1.0,), group="rosplc"), Series("b", (), (900.0,))),
        "bars",
        y_log=True,
    )
    lines = page({"value": 2.0}).figures[0]
    for figure in (bars, lines):
        first = [path.read_bytes() for path in draw(figure, tmp_path)]
        assert first == [path.read_bytes() for path in draw(figure, tmp_path)]
