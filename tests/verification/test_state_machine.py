"""The base blocks' state machine, executed: every start order, retirement, staleness, order, losses."""

from __future__ import annotations

import struct
from collections.abc import Iterator

import pytest

from rosplc.layout import Limits
from rosplc.shm import Direction
from rosplc.shm.constants import IDENTITY, STATE_RETIRED, WRITER_LINE
from tests.verification.c_plc import LANGUAGES, CMachine
from tests.verification.plc_cell import READ, Cell, layout_of, pattern, target, targets
from tests.verification.virtual_cell import CANNOT, VirtualMachine

pytestmark = pytest.mark.verifies("st-messages", own="translated Structured Text")


@pytest.fixture(params=targets())
def codesys(request: pytest.FixtureRequest) -> Iterator[Cell]:
    """Give the blocks for CODESYS; the delayed rule and online changes are theirs alone."""
    with Cell(target(request.param)) as made:
        yield made


@pytest.fixture(params=[*targets(), *LANGUAGES, "virtual"])
def cell(request: pytest.FixtureRequest) -> Iterator[Cell]:
    """Give each PLC side: the blocks for CODESYS, those of the C library, and the virtual PLC."""
    why = CANNOT.get(request.node.originalname) if request.param == "virtual" else None
    if why:
        request.applymarker(pytest.mark.xfail(reason=why, strict=True, raises=AssertionError))
    with made_cell(request.param) as made:
        yield made


def made_cell(kind: str) -> Cell:
    if kind == "virtual":
        return Cell(machine=VirtualMachine)
    if kind in LANGUAGES:
        return Cell(machine=lambda folder: CMachine(kind, folder))
    return Cell(target(kind))


def test_plc_first(cell: Cell) -> None:
    """A PLC that starts before the bridge says 101, and takes what is published once the bridge is there."""
    cell.scan(20)
    assert cell.get("/plain", "udiError", "xAttached") == (101, False)
    writer = cell.channel("/plain").writer()
    cell.until("/plain", "xAttached", True)
    assert cell.get("/plain", "udiError") == 0
    writer.publish(pattern(7))
    cell.scan()
    assert cell.get("/plain", "xNew", "xValid", "udiSequence") == (True, True, 1)
    assert cell.record("/plain") == pattern(7)
    cell.scan()
    assert cell.get("/plain", "xNew", "xValid") == (False, True)


def test_bridge_first_shows_but_does_not_execute(cell: Cell) -> None:
    """A message from before the PLC attached is valid, but never new (M14)."""
    writer = cell.channel("/plain").writer()
    writer.publish(pattern(3))
    cell.until("/plain", "xValid", True)
    assert cell.get("/plain", "xNew") is False
    assert cell.record("/plain") == pattern(3)
    for _ in range(50):
        cell.scan()
        assert cell.get("/plain", "xNew") is False
    writer.publish(pattern(4))
    cell.scan()
    assert cell.get("/plain", "xNew") is True


def test_stop_and_run_never_executes_a_retained_command(cell: Cell) -> None:
    """A program that is stopped and started again takes the last command for state, not for new."""
    writer = cell.channel("/plain").writer()
    cell.until("/plain", "xAttached", True)
    writer.publish(pattern(5))
    cell.scan()
    assert cell.get("/plain", "xNew") is True
    cell.machine.stop()
    cell.machine.start()
    for _ in range(100):
        cell.scan(beats=[writer])
        assert cell.get("/plain", "xNew") is False
    assert cell.record("/plain") == pattern(5)
    assert cell.get("/plain", "xValid") is True


def test_latched_takes_the_state_as_new(cell: Cell) -> None:
    """A latched topic's reader takes what is there, once, as a new message."""
    writer = cell.channel("/latched").writer()
    writer.publish(pattern(9))
    cell.until("/latched", "xNew", True)
    assert cell.record("/latched") == pattern(9)
    assert cell.get("/latched", "udiLost") == 0
    cell.scan()
    assert cell.get("/latched", "xNew") is False


def test_bridge_restart_keeps_the_sequence(cell: Cell) -> None:
    """A bridge that starts again adopts the object; the PLC goes on without an error."""
    channel = cell.channel("/plain")
    writer = channel.writer()
    cell.until("/plain", "xAttached", True)
    writer.publish(pattern(1))
    cell.scan()
    cell.drop(channel)
    cell.scan(3)
    writer = cell.channel("/plain").writer()
    writer.publish(pattern(2))
    cell.scan()
    assert cell.get("/plain", "xNew", "udiSequence", "udiLost", "udiError") == (True, 2, 0, 0)


def test_silent_bridge_is_reported_and_found_again(cell: Cell) -> None:
    """Without beats the peer is gone (125); a new object at the name is found, its first message new."""
    channel = cell.channel("/plain")
    writer = channel.writer(beat_ms=100)
    cell.until("/plain", "xPeerAlive", True, beats=[writer])
    path = cell.namespace.path("/plain")
    path.unlink()  # as a session's clean-up does; nobody says RETIRED
    cell.until("/plain", "udiError", 125)
    assert cell.get("/plain", "xPeerAlive") is False
    cell.drop(channel)
    writer = cell.channel("/plain").writer(beat_ms=100)
    cell.until("/plain", "xPeerAlive", True, beats=[writer])
    writer.publish(pattern(8))
    cell.scan()
    assert cell.get("/plain", "xNew", "udiError") == (True, 0)


def test_retired_object_is_left(cell: Cell) -> None:
    """RETIRED is noticed at the next call (111); the object that follows is opened at once."""
    channel = cell.channel("/plain")
    channel.writer()
    cell.until("/plain", "xAttached", True)
    channel.region.store(IDENTITY["state"], STATE_RETIRED)
    cell.scan()
    assert cell.get("/plain", "udiError", "xAttached") == (111, False)
    cell.drop(channel)
    cell.channel("/plain").writer()
    assert cell.until("/plain", "xAttached", True) < 30
    assert cell.get("/plain", "udiError") == 0


def test_replaced_object_of_another_layout(cell: Cell) -> None:
    """Another layout is refused (112), and the block says which it found."""
    other = layout_of("geometry_msgs/msg/Accel")
    assert other.layout_id != layout_of("geometry_msgs/msg/Twist").layout_id
    channel = cell.channel("/plain", other)
    cell.until("/plain", "udiError", 112)
    low, high = other.layout_id_words
    assert cell.get("/plain", "udiFoundLayoutLo", "udiFoundLayoutHi", "xAttached") == (low, high, False)
    channel.retire()
    cell.channels.remove(channel)
    cell.channel("/plain")
    cell.until("/plain", "udiError", 0)
    assert cell.get("/plain", "xAttached") is True


def test_replaced_by_a_larger_layout(cell: Cell) -> None:
    """An object that is larger or smaller than expected is refused by its layout, not by a crash."""
    for name in ("sensor_msgs/msg/JointState", "std_msgs/msg/Bool"):
        channel = cell.channel("/plain", layout_of(name, limits=Limits(sequence=64)))
        cell.until("/plain", "udiError", 112)
        channel.retire()
        cell.channels.remove(channel)
        cell.until("/plain", "udiError", 101)


def test_wrong_direction(cell: Cell) -> None:
    """An object of the other direction is refused (110), by both blocks."""
    cell.channel("/plain", direction=Direction.TO_ROS)
    cell.channel("/out", direction=Direction.TO_PLC)
    cell.until("/plain", "udiError", 110)
    cell.until("/out", "udiError", 110)


@pytest.mark.parametrize("topic", ["/plain", "/zero", "/value"])
def test_stale(cell: Cell, topic: str) -> None:
    """A stale message is held, zeroed or replaced, at the moment it becomes stale; the next one recovers."""
    cell.machine.write(f"{cell.block('/value')}.stSafe", pattern(99))
    writer = cell.channel(topic).writer()
    cell.until(topic, "xPeerAlive", True, beats=[writer])
    assert cell.get(topic, "xStale") is True, "nothing has come yet"
    writer.publish(pattern(6))
    cell.scan()
    assert cell.get(topic, "xStale", "xNew") == (False, True)
    cell.scan(20, beats=[writer])
    assert cell.get(topic, "xStale", "tAge") == (False, 200)
    assert cell.record(topic) == pattern(6)
    cell.scan(beats=[writer])
    assert cell.get(topic, "xStale", "tAge") == (True, 210)
    expected = {"/plain": pattern(6), "/zero": bytes(48), "/value": pattern(99)}[topic]
    assert cell.record(topic) == expected
    writer.publish(pattern(7))
    cell.scan()
    assert cell.get(topic, "xStale", "xNew", "tAge") == (False, True, 0)
    assert cell.record(topic) == pattern(7)


SAFE = struct.pack("<6d", 0.25, 0, 0, 0, -0.001, 5)


def test_the_safe_value_of_the_configuration_holds(cell: Cell) -> None:
    """Without any bridge, beside a retained message, after silence, with the bridge gone: msg is safe."""
    cell.scan()
    assert cell.get("/safe", "xAttached", "xStale", "xSubstituted", "xValid") == (False, True, True, False)
    assert cell.record("/safe") == SAFE
    channel = cell.channel("/safe")
    writer = channel.writer()
    writer.publish(pattern(3))
    cell.until("/safe", "xValid", True, beats=[writer])
    assert cell.get("/safe", "xNew", "xStale", "xSubstituted") == (False, True, True)
    assert cell.record("/safe") == SAFE
    writer.publish(pattern(4))
    cell.scan()
    assert cell.get("/safe", "xNew", "xStale", "xSubstituted") == (True, False, False)
    assert cell.record("/safe") == pattern(4)
    cell.scan(30, beats=[writer])
    assert cell.get("/safe", "xPeerAlive", "xStale", "xSubstituted") == (True, True, True)
    assert cell.record("/safe") == SAFE
    writer.publish(pattern(5))
    cell.scan()
    assert cell.record("/safe") == pattern(5)
    channel.retire()
    cell.channels.remove(channel)
    cell.scan(30)
    assert cell.get("/safe", "xAttached", "xStale", "xSubstituted") == (False, True, True)
    assert cell.record("/safe") == SAFE


def test_the_first_message_after_silence_is_marked(cell: Cell) -> None:
    """XRecovered: the first message at all, the first after xStale, the first of another writer."""
    channel = cell.channel("/plain")
    writer = channel.writer()
    cell.until("/plain", "xPeerAlive", True, beats=[writer])
    seen = []
    for pause in (0, 5, 30, 5):
        cell.scan(pause, beats=[writer])
        writer.publish(pattern(1))
        cell.scan()
        seen.append(cell.get("/plain", "xNew", "xRecovered"))
        cell.scan()
        assert cell.get("/plain", "xNew", "xRecovered") == (False, False)
    assert seen == [(True, True), (True, False), (True, True), (True, False)]
    cell.drop(channel)
    writer = cell.channel("/plain").writer()
    writer.publish(pattern(2))
    writer.publish(pattern(3))
    cell.scan()
    assert cell.get("/plain", "xNew", "xFirst", "xRecovered", "xStale") == (True, False, True, False)


def test_publishers_are_known_only_while_the_bridge_lives(cell: Cell) -> None:
    """A ROS publisher that goes is seen at the next scan; without a living bridge nothing is known."""
    unknown = 0xFFFFFFFF
    cell.scan()
    assert cell.get("/plain", "udiSources", "xSourcePresent") == (unknown, False)
    writer = cell.channel("/plain").writer(beat_ms=100)
    writer.set_sources(2)
    cell.until("/plain", "xPeerAlive", True, beats=[writer])
    assert cell.get("/plain", "udiSources", "xSourcePresent") == (2, True)
    writer.set_sources(0)
    cell.scan(beats=[writer])
    assert cell.get("/plain", "udiSources", "xSourcePresent", "xPeerAlive") == (0, False, True)
    writer.set_sources(1)
    cell.until("/plain", "xPeerAlive", False)
    assert cell.get("/plain", "udiSources", "xSourcePresent") == (unknown, False)


def test_stale_while_the_bridge_is_absent(cell: Cell) -> None:
    """A topic gets stale, and its message zero, even where the bridge's object is gone."""
    channel = cell.channel("/zero")
    writer = channel.writer()
    cell.until("/zero", "xPeerAlive", True, beats=[writer])
    writer.publish(pattern(6))
    cell.scan()
    channel.retire()
    cell.channels.remove(channel)
    cell.scan(22)
    assert cell.get("/zero", "xStale", "xAttached") == (True, False)
    assert cell.record("/zero") == bytes(48)


def test_in_order_takes_every_message(cell: Cell) -> None:
    """In order, Next() gives one message after the other within a scan, up to uiMaxPerScan."""
    writer = cell.channel("/in_order", slots=16).writer()
    cell.until("/in_order", "xAttached", True)
    for number in range(1, 11):
        writer.publish(pattern(number))
    cell.scan()
    cell.machine.scan("Consume", step=0)
    count = cell.machine.get("Consume.uiCount")
    assert count == 8, "uiMaxPerScan"
    assert [cell.machine.get(f"Consume.adValues[{i}]") for i in range(count)] == list(range(1, 9))
    cell.scan()
    cell.machine.scan("Consume", step=0)
    assert cell.machine.get("Consume.uiCount") == 2
    assert cell.machine.get("Consume.adValues[1]") == 10
    assert cell.get("/in_order", "udiLost", "udiSequence") == (0, 10)
    cell.scan()
    cell.machine.scan("Consume", step=0)
    assert cell.machine.get("Consume.uiCount") == 0


def test_in_order_counts_losses(cell: Cell) -> None:
    """Messages that the ring no longer holds are counted, and reading goes on with the oldest left."""
    writer = cell.channel("/in_order", slots=4).writer()
    cell.until("/in_order", "xAttached", True)
    writer.publish(pattern(0))
    cell.scan()
    for number in range(1, 11):
        writer.publish(pattern(number))
    cell.scan()
    cell.machine.scan("Consume", step=0)
    count = cell.machine.get("Consume.uiCount")
    assert [cell.machine.get(f"Consume.adValues[{i}]") for i in range(count)] == [8, 9, 10]
    assert cell.get("/in_order", "udiLost") == 7


def test_newest_counts_what_it_skipped(cell: Cell) -> None:
    """The newest message is taken, those between count as lost."""
    writer = cell.channel("/plain").writer()
    cell.until("/plain", "xAttached", True)
    for number in range(1, 6):
        writer.publish(pattern(number))
    cell.scan()
    assert cell.record("/plain") == pattern(5)
    assert cell.get("/plain", "udiLost", "udiSequence") == (0, 5), "the first message's past is no loss"
    for number in range(6, 9):
        writer.publish(pattern(number))
    cell.scan()
    assert cell.get("/plain", "udiLost", "udiSequence") == (2, 8)


@pytest.mark.parametrize("topic", ["/plain", "/in_order"])
def test_wrap_around(cell: Cell, topic: str) -> None:
    """Sequences wrap from 2^32-1 to N without a loss, a repetition or a discontinuity."""
    channel = cell.channel(topic)
    channel.region.store(WRITER_LINE["head"], 2**32 - 4)
    writer = channel.writer()
    cell.until(topic, "xAttached", True)
    sequences = []
    for number in range(1, 9):
        sequences.append(writer.publish(pattern(number)))
        cell.scan()
        assert cell.get(topic, "xNew", "udiSequence") == (True, sequences[-1])
        assert cell.record(topic) == pattern(number)
    assert sequences[2:5] == [2**32 - 1, 4, 5]
    assert cell.get(topic, "udiLost", "udiDiscontinuities") == (0, 0)


def test_writer_wrap_around(cell: Cell) -> None:
    """The PLC's writer continues at head and wraps from 2^32-1 to N."""
    channel = cell.channel("/out")
    channel.region.store(WRITER_LINE["head"], 2**32 - 3)
    reader = channel.reader()
    out = bytearray(48)
    taken = []
    cell.set("/out", "xEnable", False)
    cell.until("/out", "xReady", True)
    cell.set("/out", "xEnable", True)
    for number in range(1, 8):
        cell.machine.write("ROS_Write.out.msg", pattern(number))
        cell.scan()
        info = reader.next(out)
        if info is not None:
            assert out == pattern(number)
            taken.append(info.sequence)
    assert taken[:4] == [2**32 - 2, 2**32 - 1, 4, 5]
    assert reader.lost == 0
    assert reader.discontinuities == 0, "the bridge began with 0: its first message is no discontinuity"


def test_writer_sends_nothing_before_it_is_told() -> None:
    """A block whose program never sets xEnable claims and beats, and publishes nothing."""
    with Cell() as cell:
        cell.machine.start()
        reader = cell.channel("/out").reader()
        cell.until("/out", "xReady", True)
        cell.scan(20, beats=[reader])
        assert cell.get("/out", "xEnable", "udiPublished") == (False, 0)
        assert reader.latest(bytearray(48)) is None


def test_writer_publishes_what_msg_holds(cell: Cell) -> None:
    """Each call with xEnable publishes msg once; without, it beats only; the first is marked as such."""
    channel = cell.channel("/out")
    reader = channel.reader()
    out = bytearray(48)
    cell.set("/out", "xEnable", False)
    cell.until("/out", "xReady", True)
    cell.scan(5)
    assert cell.get("/out", "udiPublished") == 0
    assert reader.next(out) is None
    before = channel.snapshot().writer.beat
    cell.scan(3)
    assert channel.snapshot().writer.beat != before
    cell.set("/out", "xEnable", True)
    for number in (1, 2, 3):
        cell.machine.write("ROS_Write.out.msg", pattern(number))
        cell.scan()
        info = reader.next(out)
        assert info is not None and bytes(out) == pattern(number)
        assert info.flags == (1 if number == 1 else 0)
        assert cell.get("/out", "xPublished", "udiPublished") == (True, number)
    cell.scan()
    assert cell.get("/out", "udiTaken") == 3


def test_writer_stamp(cell: Cell) -> None:
    """A stamp of the program's own is carried, by the PLC's clock; without one it is 0."""
    reader = cell.channel("/out").reader()
    out = bytearray(48)
    cell.until("/out", "xPublished", True)
    info = reader.latest(out)
    assert info is not None and (info.stamp_ns, info.stamp_clock) == (0, 0)
    cell.set("/out", "udiStampLo", 5)
    cell.set("/out", "udiStampHi", 7)
    cell.scan()
    info = reader.latest(out)
    assert info is not None and (info.stamp_ns, info.stamp_clock) == ((7 << 32) + 5, 3)


def test_reader_passes_stamp_and_flags_on(cell: Cell) -> None:
    """Stamp and flags of the slot are in the block's outputs."""
    writer = cell.channel("/plain").writer()
    cell.until("/plain", "xAttached", True)
    writer.publish(pattern(1), stamp_ns=(3 << 32) + 9, flags=2)
    cell.scan()
    assert cell.get("/plain", "udiStampLo", "udiStampHi", "xTruncated", "xSubstituted") == (9, 3, True, False)
    writer.publish(pattern(1), flags=4)
    cell.scan()
    assert cell.get("/plain", "xTruncated", "xSubstituted") == (False, True)


def test_reader_claims_a_line(cell: Cell) -> None:
    """A PLC's reader claims one line, shows what it has taken, and gives it back at the program's end."""
    channel = cell.channel("/plain")
    writer = channel.writer()
    cell.until("/plain", "xAttached", True)
    writer.publish(pattern(1))
    cell.scan(3, beats=[writer])
    lines = [line for line in channel.snapshot().readers if line.claim]
    assert len(lines) == 1
    assert lines[0].taken == 1 and lines[0].generation == channel.region.generation
    before = lines[0].beat
    cell.scan(beats=[writer])
    assert next(line for line in channel.snapshot().readers if line.claim).beat != before
    cell.machine.stop()
    assert not [line for line in channel.snapshot().readers if line.claim]


def test_writer_gives_the_claim_back(cell: Cell) -> None:
    """The end of the program frees the writer's claim."""
    channel = cell.channel("/out")
    cell.until("/out", "xReady", True)
    assert channel.region.word(WRITER_LINE["writer_epoch"])
    cell.machine.stop()
    assert channel.region.word(WRITER_LINE["writer_epoch"]) == 0
    assert cell.machine.counters().open_handles == 0


def test_online_change_keeps_handle_and_place(codesys: Cell) -> None:
    """An online change moves the instances; no handle is lost or opened, no message lost or invented."""
    writer = codesys.channel("/plain").writer()
    channel = codesys.channel("/out")
    reader = channel.reader()
    out = bytearray(48)
    codesys.until("/plain", "xAttached", True)
    codesys.until("/out", "xReady", True)
    epoch = channel.region.word(WRITER_LINE["writer_epoch"])
    writer.publish(pattern(1))
    codesys.scan(beats=[writer])
    before = codesys.machine.counters()
    for number in range(2, 12):
        codesys.machine.online_change()
        codesys.machine.write("ROS_Write.out.msg", pattern(number))
        if number % 2:
            writer.publish(pattern(number))
        codesys.scan(beats=[writer])
        assert codesys.get("/plain", "xNew") is bool(number % 2)
        info = reader.latest(out)
        assert info is not None and bytes(out) == pattern(number)
    assert channel.region.word(WRITER_LINE["writer_epoch"]) == epoch, "the claim is kept"
    after = codesys.machine.counters()
    assert (after.opened, after.closes) == (before.opened, before.closes)
    assert codesys.get("/plain", "udiLost") == 0


def test_one_open_attempt_per_scan(cell: Cell) -> None:
    """However many blocks look for their objects, one scan makes at most one attempt."""
    most = 0
    for _ in range(300):
        before = cell.machine.counters().opens
        cell.scan()
        most = max(most, cell.machine.counters().opens - before)
    assert most == 1


def test_back_off(cell: Cell) -> None:
    """Attempts to open become rarer, down to one in two seconds for each block."""
    cell.scan(600)
    before = cell.machine.counters().opens
    cell.scan(1000)  # 10 s
    attempts = cell.machine.counters().opens - before
    assert 7 * 4 <= attempts <= 7 * 6


def test_every_block_gets_its_turn(cell: Cell) -> None:
    """Blocks that find nothing do not starve the others of the scan's attempt."""
    cell.channel("/out2")
    assert cell.until("/out2", "xAttached", True, scans=300) < 300


def test_reentry(cell: Cell) -> None:
    """A second task inside an instance is refused with 124, and nothing is touched."""
    writer = cell.channel("/plain").writer()
    cell.until("/plain", "xAttached", True)
    cell.machine.set(f"{cell.block('/plain')}.xInside", True)  # as if another task were inside
    writer.publish(pattern(1))
    cell.machine.scan(READ)
    assert cell.get("/plain", "udiError", "xNew") == (124, False)
    assert cell.record("/plain") == bytes(48)
    cell.machine.set(f"{cell.block('/plain')}.xInside", False)
    cell.machine.scan(READ)
    assert cell.get("/plain", "xNew") is True


@pytest.mark.parametrize("option", ["round_pages", "check_size", "return_size", "cache_names"])
def test_unknown_behaviour_of_the_runtime(option: str) -> None:
    """Page rounding, size checks, the size told back and caching by name change nothing that matters."""
    with Cell() as cell:
        cell.machine.option(option)
        other = cell.channel("/plain", layout_of("sensor_msgs/msg/JointState", limits=Limits(sequence=64)))
        cell.until("/plain", "udiError", 112)
        other.retire()
        cell.channels.remove(other)
        channel = cell.channel("/plain")
        writer = channel.writer()
        reader = cell.channel("/out").reader()
        cell.until("/plain", "xAttached", True)
        cell.until("/out", "xReady", True)
        writer.publish(pattern(2))
        cell.machine.write("ROS_Write.out.msg", pattern(4))
        cell.scan()
        assert cell.get("/plain", "xNew", "udiError") == (True, 0)
        out = bytearray(48)
        assert reader.latest(out) is not None and out == pattern(4)
        channel.retire()
        cell.channels.remove(channel)
        writer = cell.channel("/plain").writer()
        cell.scan()
        cell.until("/plain", "xPeerAlive", True, beats=[writer])
        writer.publish(pattern(5))
        cell.scan()
        assert cell.record("/plain") == pattern(5)
        cell.machine.stop()
        assert cell.machine.counters().open_handles == 0


def test_clock_wraps(cell: Cell) -> None:
    """TIME's overflow after 49 days changes no age and no retry."""
    cell.machine.set_time(2**32 - 105)
    writer = cell.channel("/plain").writer()
    cell.until("/plain", "xPeerAlive", True, beats=[writer])
    writer.publish(pattern(1))
    cell.scan()
    for age in range(1, 20):
        cell.scan(beats=[writer])
        assert cell.get("/plain", "tAge", "xStale") == (10 * age, False)


def test_delayed_reader(codesys: Cell) -> None:
    """Without fences a message is chosen, copied and proven in three scans, and then new exactly once."""
    codesys.machine.set("RosPlc_Settings.xFenced", False)
    writer = codesys.channel("/plain").writer()
    codesys.until("/plain", "xAttached", True)
    assert codesys.get("/plain", "xDelayed") is True
    for number in range(1, 6):
        writer.publish(pattern(number))
        news = []
        for _ in range(5):
            codesys.scan()
            news.append(codesys.get("/plain", "xNew"))
        assert news.count(True) == 1 and news.index(True) <= 2
        assert codesys.record("/plain") == pattern(number)
    assert codesys.get("/plain", "udiLost") == 0


def test_delayed_reader_refuses_what_was_overtaken(codesys: Cell) -> None:
    """A copy whose slot was written again before the proof is thrown away and counted."""
    codesys.machine.set("RosPlc_Settings.xFenced", False)
    writer = codesys.channel("/plain").writer()
    codesys.until("/plain", "xAttached", True)
    taken = []
    for number in range(1, 61):
        writer.publish(pattern(number))
        writer.publish(pattern(number + 1000))
        codesys.scan()
        if codesys.get("/plain", "xNew"):
            taken.append(codesys.get("/plain", "udiSequence"))
            sequence = taken[-1]
            assert codesys.record("/plain") == pattern((sequence + 1) // 2 + (0 if sequence % 2 else 1000))
    assert taken == sorted(set(taken))
    assert codesys.get("/plain", "udiRetries") > 0


def test_delayed_writer(codesys: Cell) -> None:
    """Without fences a message is published in the scan after it was filled, and the writer says so."""
    codesys.machine.set("RosPlc_Settings.xFenced", False)
    channel = codesys.channel("/out")
    reader = channel.reader()
    out = bytearray(48)
    codesys.until("/out", "xReady", True)
    assert channel.region.word(WRITER_LINE["writer_rule"]) == 2
    got = []
    for number in range(1, 20):
        codesys.machine.write("ROS_Write.out.msg", pattern(number))
        codesys.scan()
        if reader.next(out) is not None:
            got.append(bytes(out))
    assert got[-18:] == [pattern(number) for number in range(1, 19)], "the last one waits for its scan"
    assert reader.lost == 0


def test_fenced_writer_says_so(cell: Cell) -> None:
    """With fences the writer's rule is 1."""
    channel = cell.channel("/out")
    cell.until("/out", "xReady", True)
    assert channel.region.word(WRITER_LINE["writer_rule"]) == 1


def test_reader_under_a_delayed_writer(cell: Cell) -> None:
    """A reader uses one slot less where the writer follows the delayed rule (M23)."""
    channel = cell.channel("/in_order")
    writer = channel.writer()
    cell.until("/in_order", "xAttached", True)
    writer.publish(pattern(0))
    cell.scan()
    channel.region.store(WRITER_LINE["writer_rule"], 2)
    for number in range(1, 4):
        writer.publish(pattern(number))
    cell.scan()
    assert cell.record("/in_order") == pattern(2), "of three messages in four slots the oldest is given up"
    assert cell.get("/in_order", "udiLost") == 1
