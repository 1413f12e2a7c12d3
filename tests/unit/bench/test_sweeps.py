"""The sweeps move messages of every size and over every number of topics, and check what arrived."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

import pytest

from rosplc.errors import SetupError
from rosplc_bench import sweeps
from rosplc_bench.report import table_lines
from rosplc_bench.run import EFFORTS, Context
from rosplc_bench.sweeps import PAYLOAD_NAMES, TOPIC_NAMES, Amount

AMOUNT = Amount(1, 0.5, (8, 1000, 200_000), (1, 30), 5)


@pytest.fixture
def context(tmp_path: Path) -> Context:
    """Give the surroundings of a run."""
    return Context(EFFORTS["quick"], tmp_path, tmp_path, (0,))


@pytest.mark.foreign
def test_every_contender(context: Context, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each contender takes part as far as it can, and the tables leave out what it cannot."""
    if shutil.which("gcc") is None:
        pytest.skip("Debian package gcc is missing")
    if shutil.which("pkg-config") is None:
        pytest.skip("Debian package pkg-config is missing")
    if subprocess.run(["pkg-config", "--exists", "libmodbus"], check=False).returncode:
        pytest.skip("Debian package libmodbus-dev is missing")
    monkeypatch.setitem(sweeps._AMOUNTS, "quick", AMOUNT)
    data = json.loads(json.dumps(sweeps.run(context)))
    assert not context.failures and not context.skips
    payload = {(one["contender"], one["size"]) for one in data["payload"]}
    assert payload == {
        (name, size)
        for name in PAYLOAD_NAMES
        for size in AMOUNT.sizes
        if not ("modbus" in name and size == 200_000)
    }
    topics = {(one["contender"], one["topics"]) for one in data["topics"]}
    assert topics == {
        (name, count) for name in TOPIC_NAMES for count in (1, 30) if not (count == 30 and name == "asyncua")
    }
    assert all(ns > 0 for one in (*data["payload"], *data["topics"]) for ns in one["ns"])
    page = sweeps.SECTION.render(data)
    for table in page.tables:
        assert table.waiting
        assert all(len(row) == len(table.header) for row in table.rows)
        assert list(table_lines(table))
    assert len(page.figures) == 2


def test_a_contender_that_fails_is_named_and_left_out(context: Context) -> None:
    """Wrong values fail the run, and the other contenders go on."""

    def wrong(_count: int) -> Mapping[str, float]:
        raise SetupError("SYS002", "the messages received differ from those sent")

    found = sweeps._turns(context, [wrong, lambda _count: {"memcpy": 1.0}], AMOUNT)
    assert found == {"memcpy": [1.0]}
    assert len(context.failures) == 1
    assert "differ from those sent" in context.failures[0].reason


def test_who_is_slow_is_asked_once(context: Context) -> None:
    """A contender that takes very long for one message is measured in the first round only."""
    slow = {"asyncua": sweeps._SLOW_MS * 2e6}
    found = sweeps._turns(context, [lambda _count: slow], AMOUNT._replace(rounds=5))
    assert found == {"asyncua": [slow["asyncua"]]}


def test_contenders_of_other_sections_start_nothing(context: Context) -> None:
    """With --only and no contender of this section, nothing is measured."""
    context.only = ("iceoryx2",)
    assert sweeps.run(context) == {}
    assert not context.skips


def test_a_server_that_does_not_come_up_takes_no_other_along(
    context: Context, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A server that ends or hangs is a failure with its name; shared memory is measured anyway."""
    monkeypatch.setitem(sweeps._AMOUNTS, "quick", AMOUNT._replace(sizes=(8,), topics=(1,)))
    monkeypatch.setattr(sweeps, "python", lambda *_: [sys.executable, "-c", "raise SystemExit(3)"])
    context.only = ("asyncua", "rosplc-python")
    data = sweeps.run(context)
    assert [each.what for each in context.failures] == ["sweeps over asyncua"]
    assert {one["contender"] for one in data["payload"]} == {"rosplc-python"}
