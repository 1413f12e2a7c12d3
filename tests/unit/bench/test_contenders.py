"""Every contender that is installed exchanges a few messages; the final values are checked, no time is."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from textwrap import dedent

import pytest

from rosplc.errors import SetupError
from rosplc_bench.compiling import compile_program
from rosplc_bench.contenders import CONTENDERS, Contender, Place, layout
from rosplc_bench.experiment import MODBUS_S, REFERENCE_KBIT_S, SHARED_MEMORY_S, kbit_per_second
from rosplc_bench.pairs import (
    ARRANGEMENTS,
    BLOCKS,
    CYCLE,
    CYCLES,
    CYCLIC,
    ONE_CORE,
    WAITING,
    Pair,
    Plan,
    start_pair,
    take_turns,
)
from rosplc_bench.run import Context, Effort, Missing

pytestmark = pytest.mark.verifies("comparison", real="each installed contender")

CORES = tuple(sorted(os.sched_getaffinity(0))[:2])
DEBIAN = {
    "gcc is missing": "gcc",
    "pkg-config is missing": "pkg-config",
    "libmodbus-dev is missing": "libmodbus-dev",
}


@pytest.fixture(scope="session")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("programs")


@pytest.fixture
def scratch() -> Iterator[Path]:
    """Give a folder in shared memory, and see that nothing of it is left outside."""
    with TemporaryDirectory(prefix="rosplc-bench-", dir="/dev/shm") as folder:
        yield Path(folder)
    assert not [path for path in Path("/dev/shm").iterdir() if Path(folder).name in path.name]


def start(contender: Contender, place: Place) -> Pair:
    try:
        return contender.start(place)
    except Missing as missing:
        if missing.reason in DEBIAN:
            pytest.skip(f"Debian package {DEBIAN[missing.reason]} is missing")
        pytest.skip(missing.reason)


@pytest.mark.parametrize("contender", CONTENDERS, ids=lambda each: each.name)
def test_values_come_through(contender: Contender, scratch: Path, cache: Path) -> None:
    """In every arrangement that a contender allows, each number comes back with one added by either side."""
    with start(contender, Place.under(scratch, contender.name, cache)) as pair:
        for arrangement in dict.fromkeys((*ARRANGEMENTS, *WAITING)):
            if arrangement.name not in contender.ways:
                continue
            cycles = (4,) if arrangement.slow else (10, 20)
            way = contender.ways[arrangement.name]
            turn = pair.turn(arrangement, way, CORES, Plan(2, 2, cycles))
            assert turn.wrong == 0 and turn.runs == 2 * len(cycles)
            assert len(turn.spent_ns) == 2 * sum(cycles) and all(value > 0 for value in turn.spent_ns)
            assert [sum(turn.spent_ns)] == [sum(map(sum, turn.durations_ns))]
            assert turn.cpu_ns > 0
        processes = [pair.a.pid, pair.b.pid]
    assert not any(Path(f"/proc/{pid}").exists() for pid in processes)


def test_every_contender_is_described() -> None:
    """Names are unique, and each has a description and its ways to wait."""
    names = [each.name for each in CONTENDERS]
    assert len(names) == len(set(names))
    known = {each.name for each in (*ARRANGEMENTS, *WAITING)}
    for each in CONTENDERS:
        assert each.title and each.about and each.ways
        assert set(each.ways) <= known and all(way.words for way in each.ways.values())


LIAR = """
    import sys
    from pathlib import Path
    from rosplc_bench.peers.exchange import serve
    from rosplc_bench.peers.memory import LockedMemory

    class Liar(LockedMemory):
        def send(self, record):
            self.values[57] += 1  # one number of a hundred, as in a message that was torn
            super().send(record)

    side, file, *names = sys.argv[1:]
    serve(side, (Liar if side == "B" else LockedMemory)(side, Path(file), tuple(names)))
"""


def test_a_contender_with_wrong_values_is_reported_as_failed(
    scratch: Path, cache: Path, tmp_path: Path
) -> None:
    """One number that is wrong in each answer makes the run a failure, counted and named."""
    script = tmp_path / "liar.py"
    script.write_text(dedent(LIAR))

    def begin(place: Place) -> Pair:
        tail = [str(place.folder / "areas"), *place.names]
        a, b = ([sys.executable, str(script), side, *tail] for side in "AB")
        return start_pair("liar", place, a, b)

    liar = Contender("liar", "A liar", "wrong", {CYCLIC[0].name: CYCLE}, begin)
    context = Context(Effort("test", 1, 0.1, 1, 0.1), scratch, cache, CORES)
    (found,) = take_turns(context, [liar], [CYCLIC[0]])
    assert found["contenders"][0]["wrong"] == found["contenders"][0]["runs"] > 0
    assert "wrong values" in context.failures[0].reason


def test_a_process_that_ends_is_an_error_with_its_words(scratch: Path, cache: Path) -> None:
    """What it printed last, and how it ended, are in the error; no name is left."""
    place = Place.under(scratch, "ends", cache)
    command = [sys.executable, "-c", "import sys; sys.exit('no such board')"]
    with pytest.raises(SetupError, match="no such board"):
        start_pair("ends", place, command, command)


def test_a_process_that_dies_in_a_turn_is_an_error(scratch: Path, cache: Path) -> None:
    """A side that is killed in a turn ends it with the signal's name, and the pair can be ended."""
    place = Place.under(scratch, "dies", cache)
    script = (
        "import os; print('ready', flush=True); input(); print('answering', flush=True); "
        "os.kill(os.getpid(), 9)"
    )
    command = [sys.executable, "-c", script]
    with start_pair("dies", place, command, command) as pair:
        with pytest.raises(SetupError, match=r"SIGKILL|printed"):
            pair.turn(ONE_CORE, BLOCKS, CORES[:1], Plan(2, 1, (2,)))
        pair.kill()


def test_programs_are_compiled_once(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A second request finds the program; without a compiler it says so, with the command that helps."""
    try:
        first = compile_program("bare", cache)
    except Missing:
        pytest.skip("Debian package gcc is missing")
    made = first.stat().st_mtime_ns
    assert compile_program("bare", cache) == first and first.stat().st_mtime_ns == made
    monkeypatch.setenv("PATH", "")
    with pytest.raises(Missing) as caught:
        compile_program("bare", cache)
    assert "apt-get install gcc" in caught.value.remedy


def test_the_record_is_the_numbers_and_nothing_else() -> None:
    """200 bytes: what the experiment carries."""
    assert layout().size == 200


def test_the_reference_figures_agree_with_each_other() -> None:
    """Its rates follow from its durations: the last one of Modbus, and about the mean of shared memory."""
    assert set(MODBUS_S) == set(SHARED_MEMORY_S) == set(CYCLES)
    rates = [kbit_per_second(count, seconds) for count, seconds in MODBUS_S.items()]
    assert min(rates) < REFERENCE_KBIT_S["Modbus TCP"] < max(rates)
    rates = [kbit_per_second(count, seconds) for count, seconds in SHARED_MEMORY_S.items()]
    assert min(rates) < REFERENCE_KBIT_S["shared memory"] < max(rates)
