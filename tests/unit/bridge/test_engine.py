"""A running bridge: what arrives, and what is counted."""

from __future__ import annotations

import logging
import time

import pytest

from rosplc.bridge import Level
from tests.lib.waiting import wait_for
from tests.unit.bridge.conftest import INT, JOINTS, STRING, Cell, numbers, unwire, wire


def test_a_message_from_ros_stands_in_the_slot(cell: Cell) -> None:
    """A PLC reads what a node published, with its stamp, the first one flagged as such."""
    bridge = cell.start(f"  /joints: {{type: {JOINTS}, to: plc, stale_after: never, limits: {{name: 4}}}}\n")
    plc = cell.plc("/joints")
    value = {"header": {"frame_id": "base"}, "name": ["a", "b"], "position": [1.5, -2.0]}
    publisher = cell.publisher("/joints", JOINTS)
    publisher.write(wire(JOINTS, value), 123_456_789)
    got = wait_for(plc.read)
    assert (got["header"]["frame_id"], got["name"], got["position"]) == ("base", ["a", "b"], [1.5, -2.0])
    assert plc.reader is not None
    info = plc.reader.peek(bytearray(plc.layout.size))
    assert info is not None
    assert (info.sequence, info.flags, info.stamp_ns, info.stamp_clock) == (1, 1, 123_456_789, 1)
    publisher.write(wire(JOINTS, value))
    wait_for(plc.read)
    info = plc.reader.peek(bytearray(plc.layout.size))
    assert info is not None
    assert (info.sequence, info.flags) == (2, 0)
    status = bridge.status().topic("/joints")
    assert (status.received, status.published, status.refused, status.lost) == (2, 2, 0, 0)


def test_a_message_from_the_plc_is_published(cell: Cell) -> None:
    """A node receives what the PLC wrote, stamped on arrival where the PLC has no clock."""
    cell.start(f"  /joints: {{type: {JOINTS}, to: ros, limits: {{name: 4}}}}\n")
    messages = cell.listen("/joints", JOINTS)
    plc = cell.plc("/joints")
    value = {"header": {"frame_id": "base"}, "name": ["a", "b"], "velocity": [0.25]}
    before = time.time_ns()
    plc.write(value, stamp_clock=0)
    plc.write(value, stamp_ns=77, stamp_clock=3)
    plc.write(value, stamp_ns=99, stamp_clock=1)
    wait_for(lambda: len(messages) == 3)
    assert messages[0] == wire(JOINTS, value)
    first, second, third = cell.stamps["/joints"]
    assert before <= first <= second <= time.time_ns()
    assert third == 99


@pytest.mark.parametrize("stamp_ns", [2**63 - 1, 2**63, 2**64 - 1])
def test_a_stamp_that_ros_cannot_carry_costs_no_message(cell: Cell, stamp_ns: int) -> None:
    """A PLC's stamp beyond signed 64 bits is replaced by the time of arrival."""
    cell.start(f"  /out: {{type: {INT}, to: ros}}\n")
    messages = cell.listen("/out", INT)
    before = time.time_ns()
    cell.plc("/out").write({"data": 1}, stamp_ns=stamp_ns, stamp_clock=1)
    wait_for(lambda: messages)
    assert before <= cell.stamps["/out"][0] <= time.time_ns()


def test_every_message_from_the_plc_arrives_in_order(cell: Cell) -> None:
    """By default nothing that the PLC writes is skipped, as long as the slots hold it."""
    cell.start(f"  /out: {{type: {INT}, to: ros, slots: 256}}\n")
    messages = cell.listen("/out", INT)
    plc = cell.plc("/out")
    for number in range(200):
        plc.write({"data": number})
    wait_for(lambda: len(messages) == 200)
    assert numbers(messages) == list(range(200))


def test_newest_alone_where_asked(cell: Cell) -> None:
    """With every: false a burst becomes its last message; nothing counts as lost."""
    bridge = cell.start(f"  /out: {{type: {INT}, to: ros, slots: 256, every: false}}\n", more="tick: 200ms")
    messages = cell.listen("/out", INT)
    plc = cell.plc("/out")
    plc.write({"data": 0})
    wait_for(lambda: messages)
    for number in range(1, 100):
        plc.write({"data": number})
    wait_for(lambda: numbers(messages)[-1] == 99)
    status = bridge.status().topic("/out")
    assert len(messages) < 100
    assert status.lost == 0
    assert status.received + status.skipped == 100


def test_what_was_skipped_on_purpose_is_no_loss_of_the_next_object(cell: Cell) -> None:
    """With every: false skipped messages stay skipped ones when the object is opened again."""
    bridge = cell.start(f"  /out: {{type: {INT}, to: ros, every: false}}\n", more="tick: 200ms")
    messages = cell.listen("/out", INT)
    plc = cell.plc("/out")
    plc.write({"data": 0})
    wait_for(lambda: messages)
    for number in range(1, 20):
        plc.write({"data": number})
    wait_for(lambda: numbers(messages)[-1] == 19)
    skipped = bridge.status().topic("/out").skipped
    assert skipped
    cell.namespace.path("/out").unlink()
    wait_for(lambda: cell.namespace.path("/out").exists())
    wait_for(lambda: bridge.status().topic("/out").problem == "")
    status = bridge.status().topic("/out")
    assert (status.lost, status.skipped) == (0, skipped)


def test_overwritten_messages_are_counted_and_named(cell: Cell) -> None:
    """What the PLC overwrote before the bridge came counts as lost, with what would help."""
    bridge = cell.start(f"  /out: {{type: {INT}, to: ros}}\n", more="tick: 200ms")
    messages = cell.listen("/out", INT)
    plc = cell.plc("/out")
    slots = bridge.project.topic("/out").slots
    plc.write({"data": 0})
    wait_for(lambda: messages)
    for number in range(1, 10 * slots):
        plc.write({"data": number})
    wait_for(lambda: numbers(messages)[-1] == 10 * slots - 1)
    status = bridge.status().topic("/out")
    assert status.received + status.lost == 10 * slots
    assert status.lost >= 8 * slots
    assert "raise slots" in wait_for(lambda: bridge.status().topic("/out").reason)


def test_refused_messages_name_field_size_and_limit(cell: Cell, caplog: pytest.LogCaptureFixture) -> None:
    """An oversized message is counted on both sides and does not keep the next one out."""
    caplog.set_level(logging.WARNING)
    bridge = cell.start(f"  /text: {{type: {STRING}, to: plc, limits: {{data: 10}}}}\n")
    plc = cell.plc("/text")
    publisher = cell.publisher("/text", STRING)
    for _ in range(50):
        publisher.write(wire(STRING, {"data": "x" * 11}))
    publisher.write(wire(STRING, {"data": "fits"}))
    assert wait_for(plc.read) == {"data": "fits"}
    status = bridge.status().topic("/text")
    assert (status.received, status.published, status.refused) == (51, 1, 50)
    assert status.code == "COD004"
    assert "data: string has 11 bytes; the limit is 10" in status.reason
    assert status.judgement[0] is Level.WARN
    assert plc.attached.snapshot().writer.refused == 50
    lines = [record for record in caplog.records if "refused" in record.message]
    assert len(lines) == 1, "repeated warnings are held back"


def test_bytes_that_are_no_message_are_refused(cell: Cell) -> None:
    """Damaged bytes are counted and explained; they harm nothing."""
    bridge = cell.start(f"  /joints: {{type: {JOINTS}, to: plc}}\n")
    publisher = cell.publisher("/joints", JOINTS)
    for junk in (b"\0\1\0\0", b"\0\1\0\0" + b"\xff" * 64):
        publisher.write(junk)
    wait_for(lambda: bridge.status().topic("/joints").refused == 2)
    assert bridge.status().topic("/joints").code.startswith("COD")


def test_truncation_only_where_asked(cell: Cell) -> None:
    """With on_overflow: truncate the message arrives, cut, flagged and counted."""
    bridge = cell.start(f"  /text: {{type: {STRING}, to: plc, limits: {{data: 4}}, on_overflow: truncate}}\n")
    plc = cell.plc("/text")
    cell.publisher("/text", STRING).write(wire(STRING, {"data": "abcdefgh"}))
    assert wait_for(plc.read) == {"data": "abcd"}
    status = bridge.status().topic("/text")
    assert (status.published, status.truncated, status.refused) == (1, 1, 0)
    assert plc.attached.snapshot().writer.truncated == 1


def test_rate_limit_towards_the_plc_keeps_the_last_message(cell: Cell) -> None:
    """A burst becomes its first message and, an interval later, its last one."""
    bridge = cell.start(f"  /in: {{type: {INT}, to: plc, rate_limit: 300ms, slots: 64}}\n")
    plc = cell.plc("/in")
    publisher = cell.publisher("/in", INT)
    start = time.monotonic()
    for number in range(40):
        publisher.write(wire(INT, {"data": number}))
    got = [wait_for(lambda: plc.read(in_order=True))]
    got.append(wait_for(lambda: plc.read(in_order=True)))
    assert time.monotonic() - start >= 0.3
    assert [value["data"] for value in got] == [0, 39]
    status = bridge.status().topic("/in")
    assert (status.received, status.published, status.skipped) == (40, 2, 38)


def test_rate_limit_towards_ros_keeps_the_last_message(cell: Cell) -> None:
    """The same from the PLC: first and last, nothing in between."""
    bridge = cell.start(f"  /out: {{type: {INT}, to: ros, rate_limit: 300ms, slots: 64}}\n")
    messages = cell.listen("/out", INT)
    plc = cell.plc("/out")
    for number in range(40):
        plc.write({"data": number})
    wait_for(lambda: len(messages) == 2)
    assert numbers(messages) == [0, 39]
    assert bridge.status().topic("/out").skipped == 38


def test_on_change_towards_the_plc(cell: Cell) -> None:
    """Equal messages are passed on once; a refused one in between changes nothing."""
    bridge = cell.start(
        f"  /text: {{type: {STRING}, to: plc, limits: {{data: 4}}, on_change: true, slots: 16}}\n"
    )
    plc = cell.plc("/text")
    publisher = cell.publisher("/text", STRING)
    for text in ("a", "a", "too long", "a", "b", "b", "a"):
        publisher.write(wire(STRING, {"data": text}))
    wait_for(lambda: bridge.status().topic("/text").received == 7)
    got = []
    while (value := plc.read(in_order=True)) is not None:
        got.append(value["data"])
    assert got == ["a", "b", "a"]
    status = bridge.status().topic("/text")
    assert (status.published, status.skipped, status.refused) == (3, 3, 1)
    assert plc.attached.snapshot().writer.refused == 1


def test_on_change_towards_ros(cell: Cell) -> None:
    """What the PLC repeats is published once, whatever is in unused bytes of the record."""
    cell.start(f"  /text: {{type: {STRING}, to: ros, on_change: true, slots: 64}}\n")
    messages = cell.listen("/text", STRING)
    plc = cell.plc("/text")
    assert plc.writer is not None
    for rest in (b"", b"junk", b"more junk"):
        record = plc.layout.pack({"data": "same"})
        record[5 : 5 + len(rest)] = rest
        plc.writer.publish(record)
    plc.write({"data": "other"})
    wait_for(lambda: len(messages) == 2)
    assert [unwire(STRING, data)["data"] for data in messages] == ["same", "other"]


def test_print_logs_each_message(cell: Cell, caplog: pytest.LogCaptureFixture) -> None:
    """print: true shows content in both directions."""
    caplog.set_level(logging.INFO, "rosplc.bridge")
    cell.start(
        f"  /in: {{type: {INT}, to: plc, print: true}}\n  /out: {{type: {INT}, to: ros, print: true}}\n"
    )
    plc = cell.plc("/out")
    cell.publisher("/in", INT).write(wire(INT, {"data": 41}))
    plc.write({"data": 42})
    wait_for(lambda: "/in: to the PLC: {'data': 41}" in caplog.text)
    wait_for(lambda: "/out: from the PLC: {'data': 42}" in caplog.text)
