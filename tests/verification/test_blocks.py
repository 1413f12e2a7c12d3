"""What the base blocks report, and how they share a topic: errors, claims, retained instances, stamps."""

from __future__ import annotations

import shutil
from collections.abc import Iterator

import pytest

pytest.importorskip("blark")
if shutil.which("gcc") is None:
    pytest.skip("Debian package gcc is missing", allow_module_level=True)

from rosplc._version import __version__
from rosplc.shm import OwnedChannel
from rosplc.shm.constants import WRITER_LINE, ErrorNumber
from rosplc_st.build import build
from rosplc_st.machine import LibraryMachine, ProcessMachine
from rosplc_st.translator import Options
from tests.verification.plc_cell import TWIST, Cell, cell_build, cell_texts, layout_of, pattern

BARRIER = ("pou: MemoryBarrier.MemoryBarrier",)


@pytest.fixture
def cell() -> Iterator[Cell]:
    with Cell() as made:
        yield made


def other_writer(channel: OwnedChannel, epoch: int = 77, beat_ms: int = 250) -> None:
    """Leave the claim of a writer that has died."""
    channel.region.store(WRITER_LINE["writer_epoch"], epoch)
    channel.region.store(WRITER_LINE["writer_beat_ms"], beat_ms)


@pytest.mark.parametrize(
    ("target", "fenced", "defined", "delayed"),
    [
        ("x86", True, (), False),
        ("x86", True, BARRIER, False),
        ("x86", False, (), True),
        ("arm", False, BARRIER, True),
        ("arm", True, BARRIER, False),
        ("arm", True, (), True),
    ],
)
def test_without_a_proven_fence_the_delayed_rule_is_in_force(
    target: str, fenced: bool, defined: tuple[str, ...], delayed: bool
) -> None:
    """On ARM a fence is proven only with --fences and the library; the blocks show which rule they follow."""
    built = cell_build(Options(defined=defined), target=target, fenced=fenced)
    with Cell(built) as cell:
        channel = cell.channel("/out")
        writer = cell.channel("/plain").writer()
        cell.until("/out", "xReady", True)
        cell.until("/plain", "xPeerAlive", True, beats=[writer])
        assert cell.get("/out", "xDelayed") is delayed
        assert cell.get("/plain", "xDelayed") is delayed
        assert channel.region.word(WRITER_LINE["writer_rule"]) == (2 if delayed else 1)
        fences = cell.machine.counters().barriers
        writer.publish(pattern(1))
        cell.until("/plain", "xNew", True, scans=4)
        assert (cell.machine.counters().barriers > fences) is (target == "arm" and bool(defined))


def test_silence_is_one_error_until_the_bridge_beats(cell: Cell) -> None:
    """While an object exists and no bridge runs, opening it again and again changes no error."""
    for topic in ("/plain", "/out"):
        channel = cell.channel(topic)
        end = channel.writer(beat_ms=100) if topic == "/plain" else channel.reader(beat_ms=100)
        cell.until(topic, "xPeerAlive", True, beats=[end])
        cell.until(topic, "udiError", 125)
        opened = cell.machine.counters().opened
        seen = set()
        for _ in range(2000):
            cell.scan()
            seen.add(cell.get(topic, "udiError"))
        assert seen == {125}
        assert cell.machine.counters().opened > opened
        cell.until(topic, "xPeerAlive", True, beats=[end])
        cell.scan(beats=[end])
        assert cell.get(topic, "udiError") == 0


def test_a_second_caller_shows_for_ten_seconds(cell: Cell) -> None:
    """124 is not hidden by what happens next, and goes by itself once the second caller stays away."""
    path = f"{cell.block('/plain')}.xInside"
    cell.machine.set(path, True)
    cell.scan(step=0)
    assert cell.get("/plain", "udiError", "xError", "udiReentries") == (124, True, 1)
    cell.machine.set(path, False)
    writer = cell.channel("/plain").writer()
    seen = []
    for _ in range(1010):
        cell.scan(beats=[writer])
        seen.append(cell.get("/plain", "udiError"))
    assert seen[:1000] == [124] * 1000
    assert seen[-1] == 0
    assert cell.get("/plain", "xAttached", "udiReentries") == (True, 1)


def test_an_error_has_number_name_and_text(cell: Cell) -> None:
    """The three agree; the version and the layout are visible beside them."""
    cell.until("/plain", "udiError", 101)
    assert cell.get("/plain", "xError", "eError", "udiResult") == (True, ErrorNumber.NO_OBJECT, 16)
    assert cell.get("/plain", "sState") == "101 object does not exist"
    assert cell.machine.get("RosPlc_Settings.sVersion") == __version__
    writer = cell.channel("/plain").writer()
    cell.until("/plain", "xAttached", True, beats=[writer])
    assert cell.get("/plain", "xError", "eError", "sState") == (False, 0, "ok")
    low, high = layout_of(TWIST).layout_id_words
    assert cell.get("/plain", "sLayout") == f"{high:08x}{low:08x}"


@pytest.mark.parametrize("kind", ["RETAIN", "PERSISTENT RETAIN"])
def test_retained_instances_start_again(kind: str) -> None:
    """After a power cycle a retained instance keeps its message, but neither handle nor claim."""
    texts = dict(cell_texts())
    for name in ("ROS_Read", "ROS_Write"):
        texts[name] = texts[name].replace("VAR_GLOBAL\n", f"VAR_GLOBAL {kind}\n")
    built = build(texts, program=True)
    with Cell(built, ProcessMachine(built)) as cell:
        cell.machine._ask(f"directory {cell.folder}")
        cell.machine.start()
        cell.set("/out", "xEnable", True)
        writer = cell.channel("/plain").writer()
        channel = cell.channel("/out")
        reader = channel.reader()
        for topic, output in (("/plain", "xAttached"), ("/out", "xPublished")):
            cell.until(topic, output, True, beats=[writer, reader])
        writer.publish(pattern(3))
        cell.scan(beats=[writer, reader])
        published = cell.get("/out", "udiPublished")
        cell.machine.power_cycle()
        assert cell.record("/plain") == pattern(3)
        assert cell.get("/plain", "xAttached", "xNew") == (False, False)
        cell.until("/plain", "xPeerAlive", True, beats=[writer, reader])
        cell.until("/out", "xPublished", True, beats=[writer, reader])
        assert cell.get("/out", "udiPublished") == published + 1
        writer.publish(pattern(4))
        cell.scan(beats=[writer, reader])
        assert cell.get("/plain", "xNew") is True
        assert cell.record("/plain") == pattern(4)


def test_messages_that_another_claim_keeps_back_are_counted(cell: Cell) -> None:
    """While another's claim runs out each enabled call counts, and the block shows how long it will take."""
    channel = cell.channel("/out")
    reader = channel.reader()
    other_writer(channel)
    cell.until("/out", "udiError", 114, beats=[reader])
    cell.scan(beats=[reader])
    before, left = cell.get("/out", "udiUnsent", "tTakeover")
    assert 0 < left <= 750
    cell.scan(10, beats=[reader])
    assert cell.get("/out", "udiUnsent", "tTakeover") == (before + 10, left - 100)
    scans = cell.until("/out", "xPublished", True, beats=[reader])
    assert scans * 10 <= left - 100 + 50
    cell.scan(5, beats=[reader])
    assert cell.get("/out", "udiUnsent", "tTakeover", "udiError") == (before + 10 + scans - 1, 0, 0)


def test_a_claim_is_free_after_three_of_the_beats_that_its_writer_announced(cell: Cell) -> None:
    """The PLC's own writer in a task of 10 ms announces 250 ms: the next one waits 750 ms."""
    channel = cell.channel("/out")
    reader = channel.reader()
    cell.until("/out", "xReady", True, beats=[reader])
    assert channel.region.word(WRITER_LINE["writer_beat_ms"]) == 250
    cell.machine.start()  # as after a crash: nobody has given the claim back
    cell.until("/out", "udiError", 114, beats=[reader])
    assert cell.until("/out", "xReady", True, beats=[reader]) * 10 <= 3 * 250 + 50


def test_two_applications_draw_different_claims() -> None:
    """Two that open in the same millisecond, as after one start, get numbers of their own."""
    drawn = set()
    for _ in range(4):
        with Cell() as cell:
            channel = cell.channel("/out")
            channel.region.store(WRITER_LINE["head"], 4)
            cell.until("/out", "xReady", True)
            drawn.add(channel.region.word(WRITER_LINE["writer_epoch"]))
    assert len(drawn) == 4


def test_of_two_writers_with_one_number_one_stays(cell: Cell) -> None:
    """Even one number drawn twice is noticed: by a beat that the block has not stored."""
    channel = cell.channel("/out")
    reader = channel.reader()
    cell.until("/out", "xReady", True, beats=[reader])
    twin = Cell(machine=LibraryMachine(cell_build(), str(cell.folder)))
    twin.machine.start()
    twin.set("/out", "xEnable", True)
    twin.set("/out", "udiEpoch", channel.region.word(WRITER_LINE["writer_epoch"]))
    both = []
    for _ in range(300):
        cell.scan(beats=[reader])
        twin.scan()
        both.append((cell.get("/out", "xReady"), twin.get("/out", "xReady")))
    assert both[-1] in [(True, False), (False, True)]
    assert both.count((True, True)) <= 3
    shutil.rmtree(twin.folder)


def test_time_stamps_in_one_number(cell: Cell) -> None:
    """Nanoseconds since 1970 as ULINT and as LDT; what the program stamps is carried whole."""
    stamp = 1_700_000_000_123_456_789
    writer = cell.channel("/plain").writer()
    reader = cell.channel("/out").reader()
    cell.until("/plain", "xAttached", True)
    writer.publish(pattern(1), stamp_ns=stamp)
    cell.set("/out", "uliStamp", stamp)
    cell.scan()
    assert cell.get("/plain", "uliStamp", "ldtStamp") == (stamp, stamp)
    cell.until("/out", "xPublished", True, beats=[reader])
    info = reader.latest(bytearray(48))
    assert info is not None and (info.stamp_ns, info.stamp_clock) == (stamp, 3)


def test_a_latched_state_beyond_half_of_the_numbers_is_no_discontinuity(cell: Cell) -> None:
    """A reader that begins with nothing has missed nothing, wherever head is."""
    channel = cell.channel("/latched")
    channel.region.store(WRITER_LINE["head"], 2**31 + 5)
    writer = channel.writer()
    writer.publish(pattern(1))
    cell.until("/latched", "xNew", True)
    assert cell.get("/latched", "udiDiscontinuities", "udiLost") == (0, 0)


def test_a_writer_without_fences_that_takes_over_narrows_the_window() -> None:
    """The rule is loaded again after the copy: under it a message N-2 behind is refused (M23)."""
    with Cell(cell_build(Options(cpu_bits=32, defined=BARRIER), target="arm")) as cell:
        channel = cell.channel("/in_order")
        writer = channel.writer()
        cell.until("/in_order", "xAttached", True)
        writer.publish(pattern(0))
        cell.scan()
        plc = cell.machine
        assert isinstance(plc, LibraryMachine)
        for number in range(1, 4):
            writer.publish(pattern(number))
        calls = 0

        def take_over() -> None:
            nonlocal calls
            calls += 1
            if calls == 1:
                channel.region.store(WRITER_LINE["writer_rule"], 2)

        plc.on_barrier(take_over)
        cell.scan()
        plc.on_barrier(None)
        assert cell.record("/in_order") == pattern(2), "message 1 was chosen under the other rule"
        assert cell.get("/in_order", "udiRetries", "udiLost") == (1, 1)
