"""Looking at channels again and again: states, rates, events."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest

from rosplc.config.plans import ClassicPlan
from rosplc.config.resolve import TopicPlan
from rosplc.errors import ChannelError
from rosplc.levels import Level
from rosplc.monitor import Expectation, Expected, State, Watch
from rosplc.monitor.watch import MAX_CHANNELS
from rosplc.ros import DEFAULT
from rosplc.shm import Direction
from tests.channels import layout_of


def only(picture):
    (view,) = picture.channels
    return view


def settle(cell, watch, *alive, looks=5):
    """Look a few times, 0.25 s apart, while these beat; return the last picture and all events."""
    events = []
    for _ in range(looks):
        for each in alive:
            each.beat()
        cell.pass_time(0.25)
        picture = watch.look()
        events += picture.events
    return picture, [event.kind for event in events]


def test_a_channel_that_is_in_order_is_ok(cell):
    """Bridge and PLC beat, messages come: rate, age and counters are told, and nothing is wrong."""
    side = cell.side("/n")
    reader = cell.plc_reader("/n")
    watch = cell.watch()
    watch.look()
    record = bytearray(8)
    for number in range(10):
        side.send(data=float(number))
        reader.latest(record)
        cell.pass_time(0.2)
        picture = watch.look()
    view = only(picture)
    assert (view.state, view.topic, view.direction) == (State.OK, "/n", "to_plc")
    assert (view.type_name, view.bridge) == ("std_msgs/msg/Float64", "cell")
    assert view.rate_hz == pytest.approx(5, rel=0.01)
    assert (view.age_ns, view.received, view.stale) == (0, 10, False)
    assert (view.bridge_alive, view.plc_alive, view.writer_alive, view.reader_alive) == (True,) * 4
    assert [reader.task for reader in view.readers] == ["PLC_PRG"]
    assert not picture.wrong
    assert picture.worst is State.OK


def test_the_first_look_claims_to_know_nothing_of_life(cell):
    """Who lives is not known before somebody was seen to beat, or not to."""
    cell.side("/n").send(data=1.0)
    view = only(cell.watch().look())
    assert (view.state, view.bridge_alive, view.rate_hz) == (State.UNKNOWN, None, None)


def test_a_bridge_that_was_killed_is_dead(cell):
    """Its claim stays and its beat stops: one event for the bridge, and its process is named."""
    sides = [cell.side(f"/n{number}") for number in range(3)]
    watch = cell.watch()
    watch.look()
    settle(cell, watch, *sides)
    picture, kinds = settle(cell, watch)
    assert {view.state for view in picture.channels} == {State.DEAD}
    assert kinds.count("bridge-gone") == 1
    assert str(os.getpid()) in picture.channels[0].words
    assert (picture.bridges[0].alive, picture.bridges[0].channels) == (False, 3)
    assert State.DEAD.level is Level.ERROR
    _, kinds = settle(cell, watch, *sides)
    assert kinds.count("bridge-back") == 1


@pytest.mark.parametrize("direction", Direction)
def test_a_bridge_that_is_starting_is_told_from_a_dead_one(cell, monkeypatch, direction):
    """A young process that holds a claim and never beat is starting; once it beat, it is alive, or dead."""
    monkeypatch.setattr("rosplc.monitor.tracked.is_starting", lambda pid: pid == os.getpid())
    side = cell.side("/n", direction=direction)
    watch = cell.watch(expected=Expected(stale_after_ns=0))
    watch.look()
    picture, kinds = settle(cell, watch, looks=8)
    assert (only(picture).state, picture.bridges[0].alive, kinds) == (State.UNKNOWN, None, [])
    assert "is starting" in only(picture).words
    picture, _ = settle(cell, watch, side)
    assert picture.bridges[0].alive is True
    picture, kinds = settle(cell, watch, looks=8)
    assert (only(picture).state, kinds) == (State.DEAD, ["bridge-gone"])
    monkeypatch.setattr("rosplc.monitor.tracked.is_starting", lambda pid: False)
    other = cell.watch()
    other.look()
    picture, _ = settle(cell, other, looks=8)
    assert only(picture).state is State.DEAD


def test_a_bridge_that_ended_in_order_is_told_from_a_dead_one(cell):
    """Claims given back mean that nobody was killed."""
    side = cell.side("/n")
    watch = cell.watch()
    watch.look()
    settle(cell, watch, side)
    side.close()
    picture, kinds = settle(cell, watch)
    assert only(picture).state is State.NO_BRIDGE
    assert "bridge-gone" in kinds


@pytest.mark.parametrize("direction", Direction)
def test_a_plc_task_that_stops_is_dead(cell, direction):
    """In both directions a claim without a beat is the PLC's end, and a new beat its return."""
    side = cell.side("/n", direction=direction)
    plc = cell.plc_reader("/n") if direction is Direction.TO_PLC else cell.plc_writer("/n")
    watch = cell.watch(expected=Expected(stale_after_ns=0))
    watch.look()
    picture, _ = settle(cell, watch, side, plc)
    assert only(picture).state is State.OK
    picture, kinds = settle(cell, watch, side, looks=8)
    assert (only(picture).state, only(picture).plc_claimed) == (State.DEAD, True)
    assert kinds == ["plc-gone"]
    _, kinds = settle(cell, watch, side, plc)
    assert kinds == ["plc-back"]


@pytest.mark.parametrize("direction", Direction)
def test_a_plc_that_was_replaced_is_back(cell, direction):
    """A new process has a claim of its own, of which nothing is known at first; still it is a return."""
    side = cell.side("/n", direction=direction)
    plc = cell.plc_reader if direction is Direction.TO_PLC else cell.plc_writer
    watch = cell.watch(expected=Expected(stale_after_ns=0))
    watch.look()
    settle(cell, watch, side, first := plc("/n"))
    settle(cell, watch, side, looks=8)
    first.release()
    watch.look()
    _, kinds = settle(cell, watch, side, plc("/n"))
    assert kinds == ["plc-back"]


def test_a_plc_that_is_not_there_is_no_plc(cell):
    """A bridge alone is a warning, not an error."""
    side = cell.side("/n", direction=Direction.TO_ROS)
    watch = cell.watch()
    watch.look()
    picture, _ = settle(cell, watch, side)
    assert only(picture).state is State.NO_PLC
    assert only(picture).words == "no PLC task writes it"


def test_silence_is_stale_after_the_time_allowed_and_half_a_second(cell):
    """One late message changes nothing; messages that come for half a second end it."""
    side = cell.side("/n")
    reader = cell.plc_reader("/n")
    watch = cell.watch()
    watch.look()
    side.send(data=1.0)
    watch.look()
    picture, kinds = settle(cell, watch, side, reader, looks=5)
    assert (only(picture).stale, only(picture).state, kinds) == (True, State.OK, [])
    picture, kinds = settle(cell, watch, side, reader, looks=2)
    assert (only(picture).state, kinds) == (State.STALE, ["stale"])
    side.writer.set_sources(0)
    assert "no publisher is left" in only(watch.look()).words
    side.send(data=2.0)
    picture, kinds = settle(cell, watch, side, reader, looks=1)
    assert (only(picture).stale, only(picture).state, kinds) == (False, State.STALE, [])
    side.send(data=2.0)
    picture, kinds = settle(cell, watch, side, reader, looks=3)
    assert (only(picture).state, kinds) == (State.OK, ["recovered"])


def test_without_a_plc_the_state_is_the_same_whenever_one_looks(cell):
    """Until a message came, a PLC task that is missing comes before a silent source."""
    side, watch = cell.side("/n"), cell.watch()
    watch.look()
    states = set()
    for _ in range(20):
        picture, _ = settle(cell, watch, side, looks=1)
        states.add(only(picture).state)
    assert states - {State.UNKNOWN} == {State.NO_PLC}
    assert only(picture).silent


def test_each_stale_has_its_recovered(cell):
    """The two events come in pairs, also where the channel is in another trouble before and after."""
    side, reader, watch = cell.side("/n"), cell.plc_reader("/n"), cell.watch()
    side.send(data=1.0)
    watch.look()
    found = []

    def go(*alive, looks=8, sends=False):
        for _ in range(looks):
            if sends:
                side.send(data=1.0)
            found.extend(settle(cell, watch, *alive, looks=1)[1])

    go(side, reader, sends=True)
    go(side, reader)  # silent
    reader.release()
    go(side)  # and without a PLC
    go(side, sends=True)  # messages come again, still without a PLC
    assert found == ["stale", "recovered"] or found == ["stale", "plc-gone", "recovered"]
    found.clear()
    go(side)
    go(looks=12)  # the bridge dies while it is silent
    go(side, sends=True)
    assert [kind for kind in found if kind in ("stale", "recovered")] == ["stale", "recovered"]
    found.clear()
    go(looks=12)  # it dies while messages come: that is the event
    go(side, sends=True)
    assert found == ["bridge-gone", "bridge-back"]


def test_several_prefixes_or_one_topic(cell):
    """A watch may be over the bridges of some configurations, or over one topic alone."""
    cell.side("/a"), cell.side("/b")
    assert len(Watch((cell.namespace.prefix, "other"), clock=cell.clock).look().channels) == 2
    assert not Watch(("other",), clock=cell.clock).look().channels
    assert [view.topic for view in cell.watch(topic="/b").look().channels] == ["/b"]


def test_a_topic_without_any_message_is_silent(cell):
    """Nothing came yet, and nobody publishes: the words say both."""
    side = cell.side("/n")
    side.writer.set_sources(0)
    reader = cell.plc_reader("/n")
    watch = cell.watch()
    watch.look()
    picture, _ = settle(cell, watch, side, reader, looks=8)
    view = only(picture)
    assert (view.state, view.age_ns) == (State.SILENT, None)
    assert view.words == "no message yet from ROS: no publisher"


def test_a_configuration_decides_what_is_stale_and_lost(cell):
    """`never` is never stale; where each message counts, a loss is wrong; without one it is not."""
    side = cell.side("/n")
    reader = cell.plc_reader("/n")
    plain = cell.watch()
    key = (cell.namespace.prefix, "/n")
    strict = cell.watch(expected=Expected({key: Expectation(0, in_order=True)}))
    plain.look()
    strict.look()
    record = bytearray(8)
    for _ in range(3):
        for number in range(10):
            side.send(data=float(number))
        reader.latest(record)
        cell.pass_time(0.25)
        loose, judged = only(plain.look()), only(strict.look())
    assert (loose.lost, loose.state, loose.configured) == (18, State.OK, False)
    assert (judged.state, judged.configured, judged.stale_after_ns) == (State.LOST, True, 0)
    settle(cell, strict, side, reader, looks=50)
    assert only(strict.look()).state is State.OK


def test_messages_that_are_refused_are_told(cell):
    """Refused counts for ten seconds, and each look says how many were new."""
    side = cell.side("/n")
    watch = cell.watch(expected=Expected(stale_after_ns=0))
    watch.look()
    settle(cell, watch, side)
    side.writer.refuse()
    side.writer.refuse()
    picture = watch.look()
    assert (only(picture).state, only(picture).refused) == (State.REFUSED, 2)
    assert [event.words for event in picture.events] == ["2 messages refused"]
    picture, _ = settle(cell, watch, side, looks=45)
    assert only(picture).state is State.NO_PLC


def test_the_age_before_the_first_message_seen_comes_from_the_stamp(cell):
    """A message that was there before the look is as old as its stamp says, at least."""
    side = cell.side("/n")
    side.writer.publish(side.layout.pack({}), stamp_ns=cell.clock.time_ns() - 7_000_000_000)
    watch = cell.watch()
    assert only(watch.look()).age_ns == 7_000_000_000
    side.writer.publish(
        side.layout.pack({}), stamp_ns=cell.clock.time_ns() + 10**12
    )  # another machine's clock
    assert only(watch.look()).age_ns == 0


def test_objects_come_go_and_are_replaced(cell):
    """Each is an event and none an error; another layout is named."""
    watch = cell.watch()
    assert watch.look().channels == ()
    side = cell.side("/n")
    assert [event.kind for event in watch.look().events] == ["appeared"]
    side.channel.retire()
    side.close()
    picture = watch.look()
    assert ([event.kind for event in picture.events], picture.channels) == (["vanished"], ())
    side = cell.side("/n")
    watch.look()
    side.close()
    side.channel.path.unlink()
    cell.side("/n", "std_msgs/msg/Int32")
    (event,) = [event for event in watch.look().events if event.channel]
    assert event.kind == "replaced"
    assert "std_msgs/msg/Int32" in event.words


@pytest.mark.parametrize(
    ("harm", "code"),
    [
        (lambda file: file.truncate(600), "SHM109"),
        (lambda file: file.truncate(0), "SHM103"),
        (lambda file: (file.seek(0), file.write(b"\xff" * 64)), "SHM104"),
        (lambda file: (file.seek(12), file.write(b"\x09\0\0\0")), "SHM108"),
    ],
)
def test_a_damaged_object_is_unreadable_and_recovers(cell, harm, code):
    """A file that shrinks under the look, or is scribbled over, neither ends the watch nor stays broken."""
    side = cell.side("/n")
    watch = cell.watch()
    watch.look()
    before = side.channel.path.read_bytes()
    with side.channel.path.open("r+b") as file:
        harm(file)
    picture = watch.look()
    if only(picture).state is not State.UNREADABLE:  # the mapping is checked by its own words alone
        cell.pass_time(2)
        watch.close()
        picture = watch.look()
    assert (only(picture).state, only(picture).code) == (State.UNREADABLE, code)
    with pytest.raises(ChannelError, match=code):
        watch.message(only(picture))
    side.channel.path.write_bytes(before)
    cell.pass_time(2)
    assert only(watch.look()).state is not State.UNREADABLE


def test_an_object_that_says_it_is_another_is_unreadable(cell):
    """A description at a wrong name is no channel of that name."""
    side = cell.side("/n")
    copy = side.channel.path.with_name(side.channel.path.name + "_copy")
    copy.write_bytes(side.channel.path.read_bytes())
    views = {view.topic: view for view in cell.watch().look().channels}
    assert views["/n"].code == ""
    assert views["/n_copy"].code == "SHM113"


def test_any_control_word_may_hold_anything(cell):
    """Every word of writer and readers at its extremes: looks go on, and as_json stays JSON."""
    side = cell.side("/n")
    side.send(data=1.0)
    watch = cell.watch()
    watch.look()
    with side.channel.path.open("r+b") as file:
        for at in range(128, 512, 4):
            for value in (b"\xff\xff\xff\xff", b"\0\0\0\x80", b"\1\0\0\0", b"\0\0\0\0"):
                file.seek(at)
                file.write(value)
                file.flush()
                cell.pass_time(0.1)
                json.dumps(watch.look().as_json(), allow_nan=False)


def test_a_topic_of_the_configuration_without_an_object_is_missing(cell):
    """It is in the picture, as an error."""
    expected = Expected({(cell.namespace.prefix, "/n"): Expectation(0), ("other", "/x"): Expectation(0)})
    view = only(cell.watch(expected=expected).look())
    assert (view.topic, view.state, view.code) == ("/n", State.MISSING, "SHM101")


def test_a_message_is_decoded_by_the_objects_description(cell):
    """Values, sequence, stamp and marks; long arrays only as far as asked."""
    side = cell.side("/n", "sensor_msgs/msg/JointState", sequence=8)
    watch = cell.watch()
    view = only(watch.look())
    assert watch.message(view) is None
    side.writer.publish(
        side.layout.pack({"position": [1.0, 2.0, 3.0], "name": ["a\x1b[31m"]}), stamp_ns=5, flags=5
    )
    message = watch.message(view.id)
    assert (message.sequence, message.stamp_ns, message.clock) == (1, 5, "system")
    assert message.marks == ("first", "substituted")
    assert message.values["position"] == [1.0, 2.0, 3.0]
    short = watch.message(view, elements=2)
    assert (short.values["position"], short.values["position"].length) == ([1.0, 2.0], 3)
    json.dumps(message.as_json())


def test_looking_changes_no_byte(cell):
    """Neither looks nor messages leave a trace."""
    side = cell.side("/n")
    side.send(data=1.0)
    before = side.channel.path.read_bytes()
    watch = cell.watch()
    for _ in range(3):
        watch.message(only(watch.look()))
    assert side.channel.path.read_bytes() == before


def test_a_directory_that_cannot_be_listed_is_an_error(cell, tmp_path):
    """SHM123, and SHM118 for a prefix that is none."""
    with pytest.raises(ChannelError, match="SHM123"):
        cell.watch(directory=str(tmp_path / "missing")).look()
    with pytest.raises(ChannelError, match="SHM118"):
        type(cell.watch())("no/prefix")


def test_too_many_objects_are_said(cell, tmp_path, monkeypatch):
    """What is over the limit is left out, and a note says so."""
    monkeypatch.setattr("rosplc.monitor.watch.MAX_CHANNELS", 3)
    for number in range(5):
        (tmp_path / f"{cell.namespace.prefix}.t.n{number}").touch()
    picture = cell.watch(directory=str(tmp_path)).look()
    assert len(picture.channels) == 3
    assert picture.notes == ("2 more objects were not examined",)
    assert MAX_CHANNELS >= 1000


def test_a_classic_topic_is_watched_by_its_changes(cell):
    """Its memory has neither beat nor sequence: that it changes is all there is to see."""
    layout = layout_of("std_msgs/msg/Int32")
    memory = Path("/dev/shm") / f"{cell.namespace.prefix}_classic"
    topic = TopicPlan(
        "/n",
        layout.type_name,
        Direction.TO_PLC,
        layout,
        DEFAULT,
        stale_after_ns=10**9,
        classic=ClassicPlan(memory.name, ""),
    )
    watch = cell.watch(expected=Expected(classic=((cell.namespace.prefix, topic),)))
    assert only(watch.look()).state is State.MISSING
    try:
        memory.write_bytes(bytes(layout.pack({"data": 1})))
        watch.look()
        memory.write_bytes(bytes(layout.pack({"data": 2})))
        cell.pass_time(0.5)
        view = only(watch.look())
        assert (view.state, view.received, view.age_ns, view.plc_alive) == (State.OK, 1, 0, None)
        assert watch.message(view).values == {"data": 2}
        cell.pass_time(2)
        assert only(watch.look()).state is State.STALE
    finally:
        memory.unlink()
    with pytest.raises(ChannelError, match="SHM101"):
        watch.message(view)
