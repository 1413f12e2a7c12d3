"""What every ROS backend does alike, whatever its middleware.

The tests run over the harnesses of ``backends/registry.py``. Where a middleware honestly cannot
do something, its harness says so (:class:`~tests.conformance.backends.base.Abilities`), and the
test holds it to what it says: no flag switches a test off.
"""

from __future__ import annotations

import itertools
import re
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from rosplc.errors import RosplcError
from rosplc.model import TypeStore
from rosplc.ros import LATCHED, SENSOR_DATA, Qos, incompatibility
from tests.conformance.backends.base import STRING, AnyInbox, AnyOutbox, Harness, PeerInbox
from tests.conformance.backends.registry import HARNESSES
from tests.lib.waiting import repeat_until, wait_for

pytestmark = [
    pytest.mark.timeout(120),
    pytest.mark.verifies("backends", own="the same tests for all backends"),
]

RELIABLE = Qos(depth=1000)
INT32 = "std_msgs/msg/Int32"


def marked(harness: type[Harness]) -> object:
    """Return a harness as a parameter."""
    why = harness.missing()
    marks = [pytest.mark.needs(*harness.packages, when=why is None, why=why)]
    marks += [pytest.mark.verify(minutes=1)] if harness.repeats else []
    return pytest.param(
        harness, marks=[*marks, *([pytest.mark.ros2] if harness.real else [])], id=harness.title
    )


def over(condition: Callable[[type[Harness]], bool]) -> pytest.MarkDecorator:
    """Return a decorator: the test runs over the harnesses for which the condition holds."""
    chosen = [marked(harness) for harness in HARNESSES if condition(harness)]
    return pytest.mark.parametrize("graph", chosen, indirect=True)


@pytest.fixture(params=map(marked, HARNESSES))
def graph(request: pytest.FixtureRequest) -> Iterator[Harness]:
    with request.param() as graph:
        yield graph


def connect(graph: Harness, topic: str = "/chatter", qos: Qos | None = None, receiver: str = "collect"):  # type: ignore[no-untyped-def]
    """Return a matched pair on a topic: outbox, inbox."""
    outbox = graph.node("talker").advertise(topic, STRING, qos)
    inbox = graph.node("listener").subscribe(topic, STRING, qos, receiver)
    wait_for(lambda: outbox.matched() and inbox.matched())
    return outbox, inbox


def send_until(outbox: Any, payload: bytes, done: Callable[[], object]) -> None:
    """Send a message again and again until it has had its effect."""
    repeat_until(lambda: outbox.write(payload), done)


# -- delivery


def test_message_arrives_with_its_stamp(graph: Harness) -> None:
    """Bytes arrive as they were sent, and so does the source stamp, where there is one."""
    outbox, inbox = connect(graph)
    before = time.time_ns()
    assert outbox.write(graph.string("hello"), 1_234_567_890)
    wait_for(inbox.count)
    ((payload, stamp),) = inbox.since(0)
    assert payload == graph.string("hello")
    if graph.abilities.source_stamps:
        assert stamp == 1_234_567_890
    else:  # the time of arrival takes its place
        assert before <= stamp <= time.time_ns()


def test_stamp_is_the_present_time_unless_given(graph: Harness) -> None:
    """A message without a stamp carries the time of its sending."""
    outbox, inbox = connect(graph)
    before = time.time_ns()
    outbox.write(graph.string("hello"))
    after = time.time_ns()
    wait_for(inbox.count)
    ((_, stamp),) = inbox.since(0)
    assert before <= stamp
    if graph.abilities.source_stamps:
        assert stamp <= after


def test_payload_is_padded_to_four_bytes(graph: Harness) -> None:
    """A CDR payload of any length is sent, filled up with zeros to whole words; ROS 1's as it is."""
    outbox, inbox = connect(graph)
    outbox.write(b"\1\0\0\0a" if graph.ros1 else b"\0\1\0\0\2\0\0\0a\0")
    wait_for(inbox.count)
    ((payload, _),) = inbox.since(0)
    assert payload == (b"\1\0\0\0a" if graph.ros1 else b"\0\1\0\0\2\0\0\0a\0\0\0")


def test_large_message_arrives_whole(graph: Harness) -> None:
    """Four megabytes, more than any datagram or socket buffer holds, arrive as they were sent."""
    outbox, inbox = connect(graph)
    text = "".join(chr(97 + number % 26) for number in range(1 << 22))
    payload = graph.string(text)
    assert outbox.write(payload)
    if graph.abilities.drops_on_full_links:  # it may be lost on its way; then another one is sent
        repeat_until(lambda: outbox.write(payload), inbox.count, every=1.0)
    wait_for(inbox.count)
    assert set(graph.texts(inbox)) == {text}


def test_reliable_messages_arrive_in_order(graph: Harness) -> None:
    """Nothing is lost, doubled or exchanged between reliable endpoints with room enough."""
    outbox, inbox = connect(graph, qos=RELIABLE)
    texts = [str(number) for number in range(1000)]
    assert outbox.write_all([graph.string(text) for text in texts]) == 1000
    wait_for(lambda: inbox.count() >= 1000)
    assert graph.texts(inbox) == texts
    assert outbox.status().sent == 1000
    wait_for(lambda: inbox.status().received == 1000)
    assert inbox.status().dropped == 0


def test_several_subscribers_and_publishers(graph: Harness) -> None:
    """Each subscriber of a topic gets what each publisher sends, in that publisher's order."""
    outboxes = [graph.node(f"talker{n}").advertise("/chatter", STRING, RELIABLE) for n in range(2)]
    inboxes = [graph.node(f"listener{n}").subscribe("/chatter", STRING, RELIABLE) for n in range(2)]
    wait_for(lambda: all(end.matched() == 2 for end in (*outboxes, *inboxes)))
    for number in range(50):
        for which, outbox in enumerate(outboxes):
            assert outbox.write(graph.string(f"{which}:{number}"))
    for inbox in inboxes:
        wait_for(lambda i=inbox: i.count() == 100)
        for which in "01":
            own = [text for text in graph.texts(inbox) if text[0] == which]
            assert own == [f"{which}:{number}" for number in range(50)]


# tests/interop and tests/unit/ros have the independent peers of the others.
@over(lambda harness: harness.backend in ("zenoh", "rospy"))
def test_foreign_peer_hears_and_is_heard(graph: Harness) -> None:
    """Independent programs on the same middleware exchange messages with the backend, both ways."""
    assert graph.foreign_peers()
    for which in graph.foreign_peers():
        node = graph.node(f"node_{which}")
        peer = graph.foreign(which, f"peer_{which}")
        outbox = node.advertise(f"/out_{which}", STRING, RELIABLE)
        inbox = node.subscribe(f"/in_{which}", STRING, RELIABLE)
        heard: PeerInbox = peer.subscribe(f"/out_{which}", STRING, RELIABLE)
        said = peer.advertise(f"/in_{which}", STRING, RELIABLE)
        wait_for(lambda o=outbox, i=inbox: o.matched() and i.matched())
        texts = [str(number) for number in range(100)]
        # A peer may be connected for its subscriber before it is for itself, and say the first to nobody.
        send_until(said, graph.string("first"), inbox.count)
        for text in texts:
            outbox.write(graph.string(text))
            said.write(graph.string(text))
        wait_for(lambda h=heard, i=inbox: len(h.since(0)) >= 100 and graph.texts(i)[-1:] == ["99"])
        assert graph.texts(heard) == texts
        assert [text for text in graph.texts(inbox) if text != "first"] == texts
        peer.close()
        wait_for(lambda o=outbox, i=inbox: o.matched() == 0 and i.matched() == 0)


# -- those who come late


def test_latched_messages_reach_late_subscribers(graph: Harness) -> None:
    """A transient_local subscriber that comes late gets the last ``depth`` messages, in order."""
    outbox = graph.node("talker").advertise("/map", STRING, Qos(durability="transient_local", depth=3))
    for number in range(5):
        outbox.write(graph.string(str(number)))
    inbox = graph.node("listener").subscribe("/map", STRING, LATCHED)
    old = ["2", "3", "4"] if graph.abilities.latched_depth else ["4"]
    wait_for(lambda: inbox.count() >= len(old))
    wait_for(outbox.matched)
    outbox.write(graph.string("now"))
    wait_for(lambda: "now" in graph.texts(inbox))
    assert graph.texts(inbox) == [*old, "now"]


def test_late_subscriber_gets_no_more_than_its_own_depth(graph: Harness) -> None:
    """With depth 1 the newest of the latched messages arrives, and then what is sent."""
    outbox = graph.node("talker").advertise("/map", STRING, LATCHED)
    for number in range(5):
        outbox.write(graph.string(str(number)))
    inbox = graph.node("listener").subscribe("/map", STRING, Qos(durability="transient_local", depth=1))
    wait_for(lambda: outbox.matched() and "4" in graph.texts(inbox))
    outbox.write(graph.string("5"))
    wait_for(lambda: "5" in graph.texts(inbox))
    # The receive thread may have handed over an older one before the next took its place.
    assert graph.texts(inbox) == sorted(graph.texts(inbox))


def test_volatile_late_subscriber_gets_no_history(graph: Harness) -> None:
    """A volatile subscriber begins with what is sent after it came, unless the publisher alone decides."""
    outbox = graph.node("talker").advertise("/map", STRING, LATCHED)
    outbox.write(graph.string("old"))
    inbox = graph.node("listener").subscribe("/map", STRING, Qos())
    wait_for(lambda: outbox.matched() and inbox.matched())
    if graph.abilities.latched_by_publisher:
        wait_for(inbox.count)
    outbox.write(graph.string("new"))
    wait_for(lambda: "new" in graph.texts(inbox))
    assert graph.texts(inbox) == (["old", "new"] if graph.abilities.latched_by_publisher else ["new"])


def test_volatile_publisher_keeps_nothing(graph: Harness) -> None:
    """What a volatile publisher sent while nobody listened reaches nobody later."""
    outbox = graph.node("talker").advertise("/chatter", STRING, Qos())
    assert outbox.write(graph.string("nobody hears this"))
    inbox = graph.node("listener").subscribe("/chatter", STRING, Qos())
    wait_for(lambda: outbox.matched() and inbox.matched())
    outbox.write(graph.string("new"))
    wait_for(inbox.count)
    assert graph.texts(inbox) == ["new"]


# -- what keeps peers apart

SETTINGS = [
    Qos(reliability=r, durability=d)  # type: ignore[arg-type]
    for r, d in itertools.product(("reliable", "best_effort"), ("volatile", "transient_local"))
]


@pytest.mark.parametrize("offered", SETTINGS, ids=lambda q: f"{q.reliability}-{q.durability}")
def test_settings_match_or_say_why_not(graph: Harness, offered: Qos) -> None:
    """Endpoints match exactly where the rules allow it; elsewhere both sides name the reason."""
    outbox = graph.node("talker").advertise("/chatter", STRING, offered)
    node = graph.node("listener")
    inboxes = [node.subscribe("/chatter", STRING, q) for q in SETTINGS]
    matching = graph.abilities.matches_qos
    expected = [incompatibility(offered, q) if matching else None for q in SETTINGS]
    for inbox, why in zip(inboxes, expected, strict=True):
        if why is None:
            wait_for(lambda i=inbox: i.matched() == 1)
            wait_for(lambda i=inbox: i.status().code == "")
        else:
            words = f"node /talker publishes /chatter as {STRING}, but {why}"
            wait_for(lambda i=inbox, w=words: i.status().reason == w)
            assert (inbox.status().matched, inbox.status().code) == (0, "ROS004")
    if matching:
        wait_for(lambda: outbox.matched() == expected.count(None))
    else:
        wait_for(outbox.matched)
    for why in filter(None, expected):
        words = f"node /listener subscribes to /chatter as {STRING}, but {why}"
        wait_for(lambda w=words: w in outbox.status().reason)
        assert outbox.status().code == "ROS004"
    outbox.write(graph.string("to those who match"))
    for inbox, why in zip(inboxes, expected, strict=True):
        if why is None:
            wait_for(inbox.count)
        else:
            assert inbox.count() == 0


def test_another_type_is_reported(graph: Harness) -> None:
    """A peer that uses another type on the topic is named, with its type, on both sides."""
    outbox = graph.node("talker").advertise("/chatter", INT32, Qos())
    inbox = graph.node("listener").subscribe("/chatter", STRING, Qos())
    wait_for(lambda: inbox.status().code == "ROS003" and outbox.status().code == "ROS003")
    wait_for(lambda: "node /talker" in inbox.status().reason)
    status = inbox.status()
    assert status.matched == 0
    assert status.reason == f"node /talker publishes /chatter as {INT32}, but the local type is {STRING}"


# An installed rclpy has no message packages that are made for a test.
@over(lambda harness: not harness.real)
def test_another_definition_is_reported(graph: Harness) -> None:
    """A peer whose type has the same name but other fields is named on both sides."""
    name = "cell_msgs/msg/State"
    theirs, ours = {name: "int32 a\nfloat32 b\n"}, {name: "int32 a\nint32 b\n"}
    talker = graph.node("talker", definitions=theirs)
    listener = graph.node("listener", definitions=ours)
    outbox, inbox = talker.advertise("/state", name, Qos()), listener.subscribe("/state", name, Qos())
    after, seen = talker.advertise("/after", STRING), listener.subscribe("/after", STRING)
    if not graph.abilities.tells_definitions:
        wait_for(lambda: inbox.matched() and outbox.matched())
        return
    wait_for(lambda: inbox.status().code == "ROS003" and outbox.status().code == "ROS003")
    wait_for(lambda: "node /talker" in inbox.status().reason)
    expected = f"node /talker publishes /state as {name} with another definition"
    assert inbox.status().reason.startswith(expected)
    outbox.write(bytes(8) if graph.ros1 else b"\0\1\0\0" + bytes(8))
    wait_for(lambda: after.matched() and seen.matched())
    send_until(after, graph.string("later"), seen.count)  # what was sent before would have come by now
    assert inbox.count() == 0


def test_nobody_there_is_no_error(graph: Harness) -> None:
    """Without a peer the status says so, and has no error code."""
    node = graph.node("alone")
    outbox = node.advertise("/out", STRING, Qos())
    inbox = node.subscribe("/in", STRING, Qos())
    wait_for(lambda: (outbox.status().code, outbox.status().reason) == ("", "no node subscribes to /out"))
    wait_for(lambda: (inbox.status().code, inbox.status().reason) == ("", "no node publishes /in"))
    assert outbox.write(graph.string("into the void"))


# -- bytes that are no messages


def without_header(graph: Harness) -> list[bytes]:
    """Return payloads that every backend refuses to send."""
    return [b""] if graph.ros1 else [b"", b"\0\1", b"\0\7\0\0\2\0\0\0a\0", b"abcdefgh"]


def test_payload_without_header_is_refused(graph: Harness) -> None:
    """Bytes that cannot be a message are refused and counted; the next message goes through."""
    outbox, inbox = connect(graph)
    for number, payload in enumerate(without_header(graph)):
        if graph.ros1 and not graph.abilities.checks_outgoing:
            break
        with pytest.raises(RosplcError, match=r"/chatter.*ROS008"):
            outbox.write(payload)
        assert (outbox.status().rejected, outbox.status().sent) == (number + 1, 0)
    outbox.write(graph.string("good"))
    wait_for(inbox.count)
    assert graph.texts(inbox) == ["good"]
    assert outbox.status().sent == 1


def test_bytes_of_another_shape_break_nothing(graph: Harness) -> None:
    """Bytes that do not fit the type are refused where the middleware looks, else delivered as they are."""
    outbox, inbox = connect(graph, qos=RELIABLE)
    bad = b"\xff\xff\xff\x7fa" if graph.ros1 else b"\0\1\0\0\xff\xff\xff\x7fabcd"
    if graph.abilities.checks_outgoing:
        with pytest.raises(RosplcError, match=r"/chatter.*ROS008"):
            outbox.write(bad)
        expected = []
    else:
        assert outbox.write(bad)
        expected = [bad]
    outbox.write(graph.string("good"))
    wait_for(lambda: inbox.count() > len(expected))
    assert [payload for payload, _ in inbox.since(0)] == [*expected, graph.string("good")]


@pytest.mark.parametrize(
    "bad",
    [b"", b"\0", b"\0\1\0\0\xff\xff\xff\x7fabcd", b"\xff" * 64, bytes(1 << 15)],
    ids=lambda b: str(len(b)),
)
def test_malformed_bytes_that_arrive_break_nothing(graph: Harness, bad: bytes) -> None:
    """Whatever a broken peer sends, the backend goes on and delivers the next good message."""
    _, inbox = connect(graph)
    send = graph.rogue("/chatter", STRING)
    assert send is not None
    good = graph.string("good")
    send(bad)
    # What goes past a library goes past its repetitions, too.
    repeat_until(lambda: send(good), lambda: good in (payload for payload, _ in inbox.since(0)))
    delivered = [payload for payload, _ in inbox.since(0) if payload != good]
    if graph.abilities.checks_incoming:
        assert delivered == []
        if bad[:2] == b"\0\1":  # without a header it is no part of any message, and of no topic
            repeat_until(lambda bad=bad: send(bad), lambda: inbox.status().rejected)
    else:  # the bridge's codec refuses it

        def arrived() -> list[bytes]:
            return [payload for payload, _ in inbox.since(0) if payload != good]

        # What is sent right after the match may pass a real middleware by.
        repeat_until(
            lambda: send(bad), lambda: len(arrived()) + inbox.status().rejected + inbox.status().dropped
        )
        assert set(arrived()) <= {bad} and (arrived() or bad[:2] != b"\0\1")


def test_unknown_type_is_refused(graph: Harness) -> None:
    """A type that the store does not know is refused in both directions."""
    node = graph.node("node")
    for call in (node.subscribe, node.advertise):
        with pytest.raises(RosplcError) as refused:
            call("/chatter", "std_msgs/msg/Sting", Qos())
        assert refused.value.code == "TYP001"
    assert node.status() == ()


def test_bad_names_are_refused(graph: Harness) -> None:
    """Names that break ROS's rules are refused, of topics, nodes and namespaces."""
    node = graph.node("node")
    calls: tuple[Callable[[], object], ...] = (
        lambda: node.advertise("/a b", STRING, Qos()),
        lambda: node.subscribe("/1st", STRING, Qos()),
        lambda: graph.node("no-de"),
        lambda: graph.node("node", namespace="relative"),
    )
    for call in calls:
        with pytest.raises(RosplcError) as refused:
            call()
        assert refused.value.code == "ROS005"


def test_namespace_and_remapping_apply(graph: Harness) -> None:
    """Relative and private names are expanded, then remapped."""
    node = graph.node("cell", namespace="/robot1", remap={"cmd_vel": "/base/cmd_vel"})
    endpoints = [node.advertise(name, STRING, Qos()) for name in ("cmd_vel", "~/state", "/abs", "odom")]
    expected = ["/base/cmd_vel", "/robot1/cell/state", "/abs", "/robot1/odom"]
    assert [endpoint.topic() for endpoint in endpoints] == expected
    assert [status.topic for status in node.status()] == expected


# -- many topics


def exchange(graph: Harness, count: int) -> None:
    """Let that many topics each deliver a message of their own."""
    talker, listener = graph.node("talker"), graph.node("listener")
    outboxes = [talker.advertise(f"/topic{n}", STRING, Qos()) for n in range(count)]
    inboxes = [listener.subscribe(f"/topic{n}", STRING, Qos()) for n in range(count)]
    for outbox, inbox in zip(outboxes, inboxes, strict=True):
        wait_for(lambda o=outbox, i=inbox: o.matched() and i.matched())
    for number, outbox in enumerate(outboxes):
        assert outbox.write(graph.string(f"message {number}"))
    for number, inbox in enumerate(inboxes):
        wait_for(inbox.count)
        assert graph.texts(inbox) == [f"message {number}"]
    assert {status.matched for status in talker.status()} == {1}
    assert {status.code for status in (*talker.status(), *listener.status())} == {""}


def test_many_topics(graph: Harness) -> None:
    """100 topics in one process each deliver their own messages."""
    exchange(graph, 100)


@pytest.mark.verify(minutes=3)
@pytest.mark.timeout(600)
def test_thousands_of_endpoints(graph: Harness) -> None:
    """1,000 topics, so 2,000 endpoints, each deliver their own messages."""
    exchange(graph, 1000)


# -- back-pressure


def test_slow_receiver_keeps_the_newest(graph: Harness) -> None:
    """While a receiver is busy, older messages give way to newer ones; the newest arrives."""
    talker, listener, watcher = (graph.node(name) for name in ("talker", "listener", "witness"))

    def texts(topic: str, pause: float) -> list[str]:
        outbox = talker.advertise(topic, STRING, RELIABLE)
        inbox = listener.subscribe(topic, STRING, Qos(depth=2), "gate")
        wait_for(lambda: outbox.matched() and inbox.matched())
        witness = watcher.subscribe(topic, STRING, RELIABLE)
        wait_for(lambda: outbox.matched() == 2 and witness.matched())
        outbox.write(graph.string("0"))
        wait_for(inbox.count)
        for number in range(1, 10):
            outbox.write(graph.string(str(number)))
        wait_for(lambda: "9" in graph.texts(witness))
        time.sleep(pause)  # until the other queue has it, too; no event tells
        inbox.release()
        wait_for(lambda: "9" in graph.texts(inbox))
        return graph.texts(inbox)

    # On a busy machine the pause may be over before the queue has all of them.
    assert any(texts(f"/chatter{pause}", pause) == ["0", "8", "9"] for pause in (1, 4, 16))


def test_write_never_waits_for_a_blocked_receiver(graph: Harness) -> None:
    """Far more than any queue holds can be written while the receiver is stopped, and nothing hangs."""
    outbox = graph.node("talker").advertise("/chatter", STRING, Qos(depth=10))
    inbox = graph.node("listener").subscribe("/chatter", STRING, Qos(depth=10), "gate")
    wait_for(lambda: outbox.matched() and inbox.matched())
    payload = graph.string("x" * 2000)
    written = 10_000  # 20 MB
    outbox.write(graph.string("first"))
    wait_for(inbox.count)
    taken = 1 + outbox.write_all([payload] * written)
    assert outbox.status().sent == taken
    assert outbox.status().dropped == written + 1 - taken
    inbox.release()
    send_the_newest(graph, outbox, inbox, "last")


def send_the_newest(graph: Harness, outbox: AnyOutbox, inbox: AnyInbox, word: str) -> int:
    """Send until the newest message has been heard: once, where no full link loses it."""
    for number in itertools.count(1):
        text = f"{word} {number}"
        outbox.write(graph.string(text))

        def heard(text: str = text) -> bool:
            return inbox.count() > 0 and graph.text(inbox.since(inbox.count() - 1)[0][0]) == text

        if not graph.abilities.drops_on_full_links:
            wait_for(heard)
        elif not in_a_second(heard):
            continue
        return number
    raise AssertionError


def in_a_second(condition: Callable[[], bool]) -> bool:
    """Return true as soon as the condition is, false after a second."""
    ends = time.monotonic() + 1
    while not (fulfilled := condition()) and time.monotonic() < ends:
        time.sleep(0.005)
    return fulfilled


def test_delivered_and_lost_add_up(graph: Harness) -> None:
    """After a flood, delivered and counted losses add up to what was sent, where that can be counted."""
    outbox = graph.node("talker").advertise("/chatter", STRING, Qos(depth=20))
    inbox = graph.node("listener").subscribe("/chatter", STRING, Qos(depth=20), "slow")
    wait_for(lambda: outbox.matched() and inbox.matched())
    outbox.write(graph.string("flood 0"))
    wait_for(inbox.count)
    taken = 1 + outbox.write_all([graph.string(f"flood {number}") for number in range(1, 3000)])
    taken += send_the_newest(graph, outbox, inbox, "end")
    assert outbox.status().sent == taken
    wait_for(lambda: inbox.status().received == inbox.count())

    def counted() -> int:
        return inbox.status().received + inbox.status().dropped

    if graph.abilities.counts_losses:
        wait_for(lambda: counted() == taken)
    else:  # the flag would be too low if everything that was lost were counted
        assert counted() <= taken
        assert inbox.count() == taken or counted() < taken
    for word in ("flood", "end"):
        got = [int(text.split()[1]) for text in graph.texts(inbox) if text.startswith(word)]
        assert got == sorted(set(got))  # in order, none twice


def test_receiver_of_one_topic_that_hangs_spoils_no_process(graph: Harness) -> None:
    """While one receiver hangs, the node can still be asked, and its publishers still send."""
    outbox = graph.node("talker").advertise("/chatter", STRING)
    node = graph.node("listener")
    inbox = node.subscribe("/chatter", STRING, receiver="gate")
    other = node.advertise("/answer", STRING)
    answer = graph.node("third").subscribe("/answer", STRING)
    wait_for(lambda: outbox.matched() and other.matched())
    outbox.write(graph.string("x"))
    wait_for(inbox.count)
    assert {status.topic for status in node.status()} == {"/chatter", "/answer"}
    node.graph()
    other.write(graph.string("still here"))
    wait_for(answer.count)
    inbox.release()


# -- callbacks


def test_failing_receiver_is_counted(graph: Harness, caplog: pytest.LogCaptureFixture) -> None:
    """An exception of the callback is logged once and counted; receiving goes on."""
    outbox, inbox = connect(graph, receiver="fail")
    for number in range(3):
        outbox.write(graph.string(str(number)))
    wait_for(lambda: inbox.status().failed == 3)
    assert graph.texts(inbox) == ["0", "1", "2"]
    if graph.abilities.many_nodes:  # otherwise the log is another process's
        assert caplog.text.count("RuntimeError: broken receiver") == 1


def test_subscription_closes_itself(graph: Harness) -> None:
    """A callback may close its own subscription; nothing more is delivered to it."""
    outbox = graph.node("talker").advertise("/chatter", STRING, RELIABLE)
    node = graph.node("listener")
    inbox = node.subscribe("/chatter", STRING, RELIABLE, "close")
    wait_for(lambda: outbox.matched() and inbox.matched())
    outbox.write_all([graph.string(str(number)) for number in range(10)])
    wait_for(lambda: outbox.matched() == 0)
    assert graph.texts(inbox) == ["0"]
    assert node.status() == ()
    assert inbox.status().reason == "closed"


def test_backend_is_closed_by_a_callback(graph: Harness) -> None:
    """A callback may close the whole backend; nothing more is delivered, and nothing hangs."""
    outbox = graph.node("talker").advertise("/chatter", STRING, RELIABLE)
    node = graph.node("listener")
    inbox = node.subscribe("/chatter", STRING, RELIABLE, "leave")
    wait_for(lambda: outbox.matched() and inbox.matched())
    outbox.write_all([graph.string(str(number)) for number in range(10)])
    wait_for(lambda: outbox.matched() == 0)
    assert graph.texts(inbox) == ["0"]
    wait_for(lambda: node.status() == ())
    node.close()


def test_no_callback_after_close(graph: Harness) -> None:
    """Once ``close`` has returned, no callback runs, though messages keep coming."""
    talker = graph.other("talker")
    outbox = talker.advertise("/chatter", STRING, SENSOR_DATA)
    node = graph.node("listener")
    stop = threading.Event()
    payloads = [graph.string("x")] * 20

    def flood() -> None:
        while not stop.is_set():
            outbox.write_all(payloads, 0.0005)

    thread = threading.Thread(target=flood)
    thread.start()
    try:
        inboxes = []
        for _ in range(20):
            inbox = node.subscribe("/chatter", STRING, SENSOR_DATA, "slow")
            wait_for(inbox.count)
            inbox.close()
            inboxes.append(inbox)
            time.sleep(0.005)
            assert inbox.late() == 0
    finally:
        stop.set()
        thread.join()
    assert [inbox.late() for inbox in inboxes] == [0] * 20


# -- those who go, and come again


def test_peer_that_leaves_is_missed(graph: Harness) -> None:
    """When an endpoint closes, its peers notice."""
    outbox, inbox = connect(graph)
    outbox.close()
    wait_for(lambda: inbox.matched() == 0)
    wait_for(lambda: inbox.status().reason == "no node publishes /chatter")
    talker = graph.node("talker2")
    again = talker.advertise("/chatter", STRING)
    wait_for(lambda: inbox.matched() and again.matched())
    inbox.close()
    wait_for(lambda: again.matched() == 0)


@over(lambda harness: harness.reaches_out)
def test_peer_that_was_killed_comes_back(graph: Harness) -> None:
    """A peer that dies without goodbye and starts again is heard and hears again, and nothing else does."""
    node = graph.node("node")
    outbox, inbox = node.advertise("/down", STRING, RELIABLE), node.subscribe("/up", STRING, RELIABLE)
    for life in range(3):
        peer = graph.process("peer")
        said, heard = peer.advertise("/up", STRING, RELIABLE), peer.subscribe("/down", STRING, RELIABLE)

        def both(said=said, heard=heard) -> bool:  # type: ignore[no-untyped-def]
            return bool(said.matched() and heard.matched())

        wait_for(both)
        before = inbox.count()
        # The node may still be matched with the peer of the life before: send until it is heard.
        tries = itertools.count()

        def send(life: int = life, tries: Iterator[int] = tries) -> None:
            outbox.write(graph.string(f"{life}:{next(tries)}"))
            time.sleep(0.05)

        wait_for(lambda s=send, h=heard: s() or h.count())
        assert said.write(graph.string(f"life {life}"))
        wait_for(lambda b=before: inbox.count() > b)
        assert all(text.startswith(f"{life}:") for text in graph.texts(heard))
        assert graph.texts(inbox)[before:] == [f"life {life}"]
        peer.kill()
        outbox.write(graph.string("nobody hears this"))  # must not hang


@over(lambda harness: harness.reaches_out)
def test_peer_that_stands_still_goes_on(graph: Harness) -> None:
    """A subscriber's process that is stopped for a while blocks no write, and hears again afterwards."""
    outbox = graph.node("node").advertise("/chatter", STRING, Qos(depth=10))
    peer = graph.process("peer")
    inbox = peer.subscribe("/chatter", STRING, Qos(depth=10))
    wait_for(lambda: outbox.matched() and inbox.matched())
    peer.stop()
    try:
        outbox.write_all([graph.string("x" * 1000)] * 2000)
    finally:
        peer.resume()
    sent = itertools.count()

    def heard() -> bool:
        outbox.write(graph.string(f"again {next(sent)}"))
        time.sleep(0.05)
        return any(graph.text(payload).startswith("again") for payload, _ in inbox.since(0))

    wait_for(heard)


@over(lambda harness: harness.abilities.has_hub)
def test_hub_may_be_restarted(graph: Harness) -> None:
    """After the death and restart of the master or router, old peers and new ones exchange messages."""
    node, peer = graph.node("node"), graph.process("peer")
    outbox, inbox = node.advertise("/down", STRING, RELIABLE), node.subscribe("/up", STRING, RELIABLE)
    said, heard = peer.advertise("/up", STRING, RELIABLE), peer.subscribe("/down", STRING, RELIABLE)
    wait_for(lambda: all(end.matched() for end in (outbox, inbox, said, heard)))
    for life in range(2):
        graph.restart_hub(silent_s=0.5)
        sent = itertools.count()

        def old(life: int = life, sent: Iterator[int] = sent) -> bool:
            text = graph.string(f"{life}:{next(sent)}")
            outbox.write(text)
            said.write(text)
            time.sleep(0.05)
            return all(any(t.startswith(f"{life}:") for t in graph.texts(end)) for end in (inbox, heard))

        wait_for(old)
        newcomer = graph.process(f"newcomer{life}")
        late, other = newcomer.subscribe("/down", STRING), newcomer.advertise("/up", STRING)

        def new(life: int = life, late=late, other=other) -> bool:  # type: ignore[no-untyped-def]
            outbox.write(graph.string("to all"))
            other.write(graph.string(f"newcomer {life}"))
            time.sleep(0.05)
            return bool(late.count()) and f"newcomer {life}" in graph.texts(inbox)

        wait_for(new)


# -- the end


def test_closed_things_say_so(graph: Harness) -> None:
    """Whatever is closed refuses further use, and closing twice is harmless."""
    node = graph.node("node")
    outbox = node.advertise("/chatter", STRING, Qos())
    outbox.close()
    outbox.close()
    with pytest.raises(RosplcError, match="ROS009"):
        outbox.write(graph.string("x"))
    other = node.advertise("/other", STRING, Qos())
    inbox = node.subscribe("/third", STRING, Qos())
    node.close()
    node.close()
    inbox.close()
    inbox.close()
    with pytest.raises(RosplcError, match="ROS009"):
        other.write(graph.string("x"))
    for call in (node.subscribe, node.advertise):
        with pytest.raises(RosplcError, match="ROS009"):
            call("/chatter", STRING, Qos())
    assert node.status() == ()


@over(lambda harness: harness.abilities.many_nodes)
def test_closing_leaves_nothing_behind(graph: Harness) -> None:
    """Threads and file descriptors are given back, also by nodes that had been busy."""

    def cycle() -> tuple[int, int]:
        talker, listener = graph.node("talker"), graph.node("listener")
        outbox = talker.advertise("/chatter", STRING, Qos())
        inbox = listener.subscribe("/chatter", STRING, Qos())
        wait_for(outbox.matched)
        outbox.write(graph.string("x"))
        wait_for(inbox.count)
        talker.close()
        listener.close()
        return talker.held()

    cycle()  # the first one loads libraries
    before = cycle()
    node = graph.node("last")
    node.close()
    for _ in range(5):
        cycle()
    # A thread that has been joined may stand in /proc for another moment.
    wait_for(lambda: all(now <= then for now, then in zip(node.held(), before, strict=True)))


def test_process_of_a_closed_backend_ends(graph: Harness) -> None:
    """Once closed, a backend keeps no thread that would hold its process, and the process ends well."""
    node = graph.process("node")
    node.advertise("/chatter", STRING)
    node.subscribe("/chatter", STRING)
    other = graph.node("other")
    other.advertise("/chatter", STRING)
    assert node.leave() == 0


# -- threads


def test_endpoints_may_be_used_from_many_threads(graph: Harness) -> None:
    """Writing, opening, closing and asking at the same time neither loses nor breaks anything."""
    talker, listener = graph.node("talker"), graph.node("listener")
    outboxes = [talker.advertise(f"/topic{n}", STRING, RELIABLE) for n in range(4)]
    inboxes = [listener.subscribe(f"/topic{n}", STRING, RELIABLE) for n in range(4)]
    wait_for(lambda: all(end.matched() for end in (*outboxes, *inboxes)))
    for node in (talker, listener):
        node.start_traffic("/short", STRING)
    halves = [[graph.string(f"{half}:{n}") for n in range(200)] for half in "01"]
    talker.write_from_threads(outboxes, halves)
    wait_for(lambda: all(inbox.count() >= 400 for inbox in inboxes))
    assert [node.stop_traffic() for node in (talker, listener)] == [[], []]
    for inbox in inboxes:
        for half in "01":
            texts = [text for text in graph.texts(inbox) if text[0] == half]
            assert texts == [f"{half}:{n}" for n in range(200)]


def test_endpoint_may_be_asked_while_it_closes(graph: Harness) -> None:
    """An endpoint that is asked at the moment in which it closes answers, and closing succeeds."""
    node, other = graph.node("node"), graph.node("other")
    other.subscribe("/down", STRING)
    other.advertise("/up", STRING)
    present: list[AnyInbox | AnyOutbox] = []
    failures: list[BaseException] = []
    done = threading.Event()

    def ask() -> None:
        try:
            while not done.is_set():
                for end in tuple(present):
                    end.matched()
                    end.status()
        except BaseException as error:
            failures.append(error)

    threads = [threading.Thread(target=ask) for _ in range(2)]
    for thread in threads:
        thread.start()
    try:
        for _ in range(10):
            ends = node.advertise("/down", STRING), node.subscribe("/up", STRING)
            present[:] = ends
            wait_for(lambda e=ends: failures or all(end.matched() for end in e))
            for end in ends:
                end.close()
    finally:
        done.set()
        for thread in threads:
            thread.join()
    assert not failures


# -- looking at the graph


def test_graph_shows_the_others(graph: Harness) -> None:
    """Other nodes' names, topics, types and settings are seen; one's own are left out."""
    talker = graph.node("talker", namespace="/robot1")
    talker.advertise("/map", STRING, LATCHED)
    talker.subscribe("/cmd_vel", "geometry_msgs/msg/Twist", SENSOR_DATA)
    listener = graph.node("listener")
    listener.advertise("/own", STRING, Qos())

    def complete() -> bool:
        found = [e for e in listener.graph().endpoints if e.topic in ("/map", "/cmd_vel")]
        return len(found) == 2 and all(e.node for e in found)

    wait_for(complete)
    seen = listener.graph()
    assert "/robot1/talker" in seen.nodes
    assert "/listener" not in seen.nodes
    assert "/own" not in seen.topics
    assert seen.topics["/cmd_vel"] == ("geometry_msgs/msg/Twist",)
    assert seen.topics["/map"] == (STRING,)
    cmd_vel, chart = (e for e in seen.endpoints if e.topic in ("/map", "/cmd_vel"))
    assert (cmd_vel.topic, cmd_vel.direction, cmd_vel.node) == ("/cmd_vel", "in", "/robot1/talker")
    assert (chart.topic, chart.direction) == ("/map", "out")
    if graph.abilities.shows_qos:
        assert cmd_vel.qos == Qos(reliability="best_effort", durability="volatile", depth=cmd_vel.qos.depth)
        assert chart.qos.durability == "transient_local"
    else:
        assert cmd_vel.qos == chart.qos
    expected = TypeStore.bundled(graph.distros[0]).type_hash(STRING) if graph.abilities.shows_hashes else ""
    assert chart.type_hash == expected


def test_every_distro_talks_to_itself(graph: Harness) -> None:
    """Nodes of each ROS distribution exchange messages, and see each other's names."""
    for distro in graph.distros:
        listener = graph.node(f"listener_{distro}", distro=distro)
        talker = graph.node(f"talker_{distro}", distro=distro)
        outbox = talker.advertise(f"/{distro}", STRING, Qos())
        inbox = listener.subscribe(f"/{distro}", STRING, Qos())
        wait_for(lambda o=outbox, i=inbox: o.matched() and i.matched())
        outbox.write(graph.string(distro))
        wait_for(inbox.count)
        assert graph.texts(inbox) == [distro]
        wait_for(lambda n=listener, d=distro: f"/talker_{d}" in n.graph().nodes)
        talker.close()
        listener.close()


def test_backend_says_what_it_is(graph: Harness) -> None:
    """A backend's name is its key in the configuration, and topics are among what it carries."""
    node = graph.node("node")
    assert node.name() == graph.backend
    assert "topics" in node.capabilities()
    assert all(re.fullmatch("[a-z_]+", word) for word in node.capabilities())
