"""The end-to-end comparison: what tells torn messages, rounded numbers and lost strings, and all of it."""

from __future__ import annotations

import json
import struct
import threading
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest

from rosplc.model import TypeStore
from rosplc.ros import open_backend
from rosplc_bench import end_to_end
from rosplc_bench.end_to_end_sides import (
    KINDS,
    QOS,
    Kind,
    Line,
    Program,
    Translator,
    pack_registers,
    register_count,
    topics,
    unpack_registers,
)
from rosplc_bench.protocols import READ_LIMIT, WRITE_LIMIT, pieces
from rosplc_bench.report import table_lines
from rosplc_bench.run import EFFORTS, Context

KIND_LIST = list(KINDS.values())


def names(kind: Kind) -> str:
    return kind.name


@pytest.mark.parametrize("kind", KIND_LIST, ids=names)
def test_a_whole_message_is_exact(kind: Kind) -> None:
    """A message that arrives as it was sent is whole, exact, and has all its strings."""
    judgement = kind.judge(kind.leaves(4711))
    assert (judgement.number, judgement.torn, judgement.error) == (4711, False, 0.0)
    assert judgement.strings == kind.strings()


@pytest.mark.parametrize("kind", KIND_LIST, ids=names)
def test_pieces_of_two_messages_are_torn(kind: Kind) -> None:
    """Wherever a message is cut, the new beginning with the old end is torn; but constants cannot tell."""
    old, new = kind.leaves(7), kind.leaves(8)
    for cut in range(1, len(kind.paths)):
        mixed = new[:cut] + old[cut:]
        assert kind.judge(mixed).torn == (mixed not in (old, new)), cut


def test_an_array_cut_inside_is_torn() -> None:
    """Half of an array from one message and half from the next is torn."""
    kind = KINDS["JointState24"]
    leaves = kind.leaves(8)
    position = kind.paths.index("position")
    leaves[position] = kind.leaves(7)[position][:11] + leaves[position][11:]
    assert kind.judge(leaves).torn


def test_nothing_written_yet_is_no_message() -> None:
    """Variables that are still zero are neither whole nor torn."""
    kind = KINDS["PoseStamped"]
    zero = ["" if path.endswith("frame_id") else 0 for path in kind.paths]
    assert kind.judge(zero).number == 0
    assert not kind.judge(zero).torn


@pytest.mark.parametrize("kind", KIND_LIST, ids=names)
def test_registers_lose_strings_and_digits(kind: Kind) -> None:
    """Through registers a message keeps its number, loses its strings, and is off as a float32 is."""
    leaves = kind.leaves(1234)
    judgement = kind.judge(unpack_registers(kind, pack_registers(kind, leaves)))
    assert (judgement.number, judgement.torn, judgement.strings) == (1234, False, 0)
    assert 0 < judgement.error < 2**-23
    sent = kind.leaf(kind.paths[-1], 1234)
    value = sent[0] if isinstance(sent, list) else sent
    assert struct.unpack("f", struct.pack("f", value))[0] != value


def test_register_counts_and_requests() -> None:
    """A Twist fits into one request; a JointState of 24 joints needs two, written or read."""
    assert register_count(KINDS["Twist"]) == 12
    large = register_count(KINDS["JointState24"])
    assert large == 2 * (2 + 3 * 24)
    assert pieces(large, WRITE_LIMIT) == [(0, 123), (123, large)]
    assert pieces(large, READ_LIMIT) == [(0, 125), (125, large)]


class Image:
    """A PLC's registers, filled request by request."""

    def __init__(self, kind: Kind) -> None:
        self.values = [0] * register_count(kind)
        self.back: list[Any] = []

    def read(self, kind: Kind) -> Sequence[Any]:
        return unpack_registers(kind, self.values)

    def write(self, kind: Kind, leaves: Sequence[Any]) -> None:
        self.back.append(leaves)

    def clear(self, kind: Kind) -> None:
        self.values[:] = [0] * len(self.values)


def test_a_scan_between_two_requests_counts_a_torn_message() -> None:
    """The control: a writer stopped between two requests is seen as torn, and as whole afterwards."""
    kind = KINDS["JointState24"]
    image = Image(kind)
    program = Program(image)
    program.use(kind)
    program()
    assert (program.seen, program.torn) == (0, 0)
    for number in (1, 2):
        values = pack_registers(kind, kind.leaves(number))
        for step, (begin, end) in enumerate(pieces(len(values), WRITE_LIMIT)):
            image.values[begin:end] = values[begin:end]
            program()
            program()  # nothing has changed since: not counted again
            assert program.seen == 2 * (number - 1) + step + 1
            assert program.torn == number
    assert len(image.back) == program.seen


@pytest.fixture
def robot() -> Iterator[tuple[Line, Any, Translator]]:
    """Give the ROS side of one type, and a peer that can send back what it likes."""
    store = TypeStore.bundled("jazzy")
    kind = KINDS["PoseStamped"]
    domain = 900_000 + threading.get_native_id()
    ours, theirs = (open_backend("memory", store, name, domain=domain) for name in ("robot", "bridge"))
    forth, back = topics("test", kind.name)
    heard: list[bytes] = []
    theirs.subscribe(forth, kind.type_name, QOS, lambda data, _: heard.append(data))
    publisher = theirs.advertise(back, kind.type_name, QOS)
    line = Line(ours, store, "test", kind)
    yield line, (publisher, heard), Translator(store, kind)
    ours.close()
    theirs.close()


def test_the_ros_side_counts_what_comes_back(robot: tuple[Line, Any, Translator]) -> None:
    """A torn message is counted and is no answer; the whole one after it is."""
    line, (publisher, heard), translator = robot
    kind = KINDS["PoseStamped"]

    def answer() -> None:
        end = time.monotonic() + 60
        while not heard and time.monotonic() < end:
            time.sleep(0.001)
        whole = translator.decode(heard[0])
        publisher.write(translator.encode(whole[:5] + kind.leaves(9)[5:]))
        publisher.write(translator.encode(whole))

    peer = threading.Thread(target=answer)
    peer.start()
    report = line.stream(1, 100.0)
    peer.join(60)
    assert line.ready
    assert (report["sent"], report["received"], report["torn"]) == (1, 2, 1)
    assert len(report["latencies_us"]) == 1
    assert (report["error"], report["strings"]) == (0.0, 1)


@pytest.mark.foreign
def test_the_whole_comparison(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """All three ways carry messages; rosplc's come through whole and exact, registers lose what they lose."""
    pytest.importorskip("cyclonedds")
    monkeypatch.setitem(end_to_end._AMOUNTS, "quick", end_to_end.Amount((1.0,), 1, 4, 0.05))
    context = Context(EFFORTS["quick"], tmp_path, tmp_path, (0,))
    data = json.loads(json.dumps(end_to_end.run(context)))
    assert not context.failures
    assert not context.skips
    assert len(data["rounds"]) == 3 * len(KINDS)
    found = {(one["method"], one["kind"]): one for one in data["rounds"]}
    for (method, kind), one in found.items():
        assert one["stream"]["latencies_us"], (method, kind)
        assert one["ping"]["plc"]["seen"] > 0
        if method == "rosplc":
            assert one["ping"]["plc"]["torn"] == one["stream"]["torn"] == one["stream"]["error"] == 0
            assert one["stream"]["strings"] == KINDS[kind].strings()
        elif method == "modbus":
            assert one["stream"]["strings"] == 0 < one["stream"]["error"]
        else:
            assert one["stream"]["error"] == 0
    page = end_to_end.SECTION.render(data)
    for table in page.tables:
        assert table.waiting
        assert len(table.rows) == 12
        assert all(len(row) == len(table.header) for row in table.rows)
        assert list(table_lines(table))
    assert page.figures and page.summary


def part(latencies: list[float], **facts: Any) -> dict[str, Any]:
    return {
        "sent": 2,
        "seconds": 1.0,
        "latencies_us": latencies,
        "received": 3,
        "torn": 1,
        "error": 6e-8,
        "strings": 0,
        "cpu": [0.1, 0.2],
        "plc": {"seen": 10, "torn": 4},
        **facts,
    }


def test_the_page_says_what_was_counted() -> None:
    """Cells are computed from the data: nothing arrived, something torn, and ratios within a round."""
    kinds = {"Twist": {"strings": 0, "leaves": 6, "registers": 12}}
    none = part([], received=0, torn=0, plc={"seen": 0, "torn": 0})
    data = {
        "rate_hz": 100.0,
        "kinds": kinds,
        "rounds": [
            {"cycle_ms": 1.0, "kind": "Twist", "method": method, "stream": stream, "ping": ping}
            for method, stream, ping in (
                ("rosplc", part([100.0]), part([100.0, 100.0])),
                ("modbus", part([250.0]), part([250.0])),
                ("opcua", none, none),
            )
        ],
    }
    times, losses = end_to_end.render(data).tables
    assert [row[4] for row in times.rows] == [1.0, 2.5, None]
    assert [row[6] for row in losses.rows] == ["4 of 10", "4 of 10", "0 of 0"]
    assert [row[5] for row in losses.rows] == [1, 2, 4]
    assert losses.rows[1][3] == "off by up to 6e-08"
    assert losses.rows[2][3] == "?"


def test_a_way_that_does_not_come_up_takes_no_other_along(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A PLC that ends at its start is a failure with its name, and the other way is measured."""
    pytest.importorskip("cyclonedds")
    amount = end_to_end.Amount((1.0,), 1, 2, 0.02)
    monkeypatch.setitem(end_to_end._AMOUNTS, "quick", amount)
    monkeypatch.setattr(end_to_end, "free_port", lambda: -1)
    monkeypatch.setattr(end_to_end, "KINDS", {"Twist": KINDS["Twist"]})
    context = Context(EFFORTS["quick"], tmp_path, tmp_path, (0,), ("rosplc", "modbus"))
    data = end_to_end.run(context)
    assert {one["method"] for one in data["rounds"]} == {"rosplc"}
    assert [failure.what for failure in context.failures] == ["end to end over modbus"]
