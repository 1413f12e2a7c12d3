"""What every ROS backend does alike, whatever middleware it stands on."""

from __future__ import annotations

import itertools
import os
import threading
import time
from collections.abc import Iterator

import pytest

from rosplc.errors import RosplcError
from rosplc.model import TypeStore
from rosplc.ros import LATCHED, SENSOR_DATA, Qos, incompatibility
from tests.interop.graphs import STRING, Graph, free_domain, string, text_of, wait_for

pytestmark = pytest.mark.timeout(120)

RELIABLE = Qos(depth=1000)


@pytest.fixture(params=["memory", "dds"])
def graph(request: pytest.FixtureRequest) -> Iterator[Graph]:
    if request.param == "dds":
        pytest.importorskip("cyclonedds", reason="no wheel of cyclonedds for this machine")
    with free_domain() as domain:
        graph = Graph(request.param, domain)
        yield graph
        graph.close()


class Inbox(list):  # type: ignore[type-arg]
    """Texts received; also a callback."""

    def __call__(self, payload: bytes, stamp_ns: int) -> None:
        self.append(text_of(payload))


def test_message_arrives_with_its_stamp(graph: Graph) -> None:
    """Bytes and source stamp arrive as they were sent."""
    got: list[tuple[bytes, int]] = []
    publisher = graph.node("talker").advertise("/chatter", STRING, Qos())
    graph.node("listener").subscribe("/chatter", STRING, Qos(), lambda *message: got.append(message))
    wait_for(lambda: publisher.matched)
    assert publisher.write(string("hello"), 1_234_567_890)
    wait_for(lambda: got)
    assert got == [(string("hello"), 1_234_567_890)]


def test_stamp_is_the_present_time_unless_given(graph: Graph) -> None:
    """A message without a stamp carries the time of its sending."""
    got: list[int] = []
    publisher = graph.node("talker").advertise("/chatter", STRING, Qos())
    graph.node("listener").subscribe("/chatter", STRING, Qos(), lambda _, stamp: got.append(stamp))
    wait_for(lambda: publisher.matched)
    before = time.time_ns()
    publisher.write(string("hello"))
    after = time.time_ns()
    wait_for(lambda: got)
    assert before <= got[0] <= after


def test_payload_is_padded_to_four_bytes(graph: Graph) -> None:
    """A payload of any length is sent, filled up with zeros to whole words."""
    got: list[bytes] = []
    publisher = graph.node("talker").advertise("/chatter", STRING, Qos())
    graph.node("listener").subscribe("/chatter", STRING, Qos(), lambda payload, _: got.append(payload))
    wait_for(lambda: publisher.matched)
    publisher.write(b"\0\1\0\0\2\0\0\0a\0")
    wait_for(lambda: got)
    assert got == [b"\0\1\0\0\2\0\0\0a\0\0\0"]


def test_reliable_messages_arrive_in_order(graph: Graph) -> None:
    """Nothing is lost, doubled or exchanged between reliable endpoints with room enough."""
    inbox = Inbox()
    publisher = graph.node("talker").advertise("/chatter", STRING, RELIABLE)
    subscription = graph.node("listener").subscribe("/chatter", STRING, RELIABLE, inbox)
    wait_for(lambda: publisher.matched and subscription.matched)
    for number in range(1000):
        assert publisher.write(string(str(number)))
    wait_for(lambda: len(inbox) >= 1000)
    assert inbox == [str(number) for number in range(1000)]
    assert publisher.status().sent == 1000
    assert subscription.status().received == 1000
    assert subscription.status().dropped == 0


def test_latched_messages_reach_late_subscribers(graph: Graph) -> None:
    """A transient_local subscriber that comes late gets the last ``depth`` messages, in order."""
    inbox = Inbox()
    publisher = graph.node("talker").advertise("/map", STRING, Qos(durability="transient_local", depth=3))
    for number in range(5):
        publisher.write(string(str(number)))
    graph.node("listener").subscribe("/map", STRING, LATCHED, inbox)
    wait_for(lambda: len(inbox) >= 3)
    publisher.write(string("now"))
    wait_for(lambda: "now" in inbox)
    assert inbox == ["2", "3", "4", "now"]


def test_late_subscriber_gets_no_more_than_its_own_depth(graph: Graph) -> None:
    """With depth 1 only the newest of the latched messages arrives."""
    inbox = Inbox()
    publisher = graph.node("talker").advertise("/map", STRING, LATCHED)
    for number in range(5):
        publisher.write(string(str(number)))
    node = graph.node("listener")
    hold = threading.Event()

    def slow(payload: bytes, stamp_ns: int) -> None:
        hold.wait()
        inbox(payload, stamp_ns)

    # A message that is being handled holds the receive thread, so the history arrives as a whole.
    other = node.subscribe("/busy", STRING, Qos(), slow)
    busy = graph.node("busy").advertise("/busy", STRING, Qos())
    wait_for(lambda: busy.matched and other.matched)
    busy.write(string("busy"))
    late = node.subscribe("/map", STRING, Qos(durability="transient_local", depth=1), inbox)
    wait_for(lambda: late.matched and publisher.matched)
    if graph.kind == "dds":
        time.sleep(0.5)  # no event tells that the history has arrived; too short a wait fails nothing
    hold.set()
    wait_for(lambda: "4" in inbox)
    assert inbox[-1] == "4"
    publisher.write(string("5"))
    wait_for(lambda: "5" in inbox)


def test_volatile_late_subscriber_gets_no_history(graph: Graph) -> None:
    """A volatile subscriber begins with what is sent after it came, though the publisher latches."""
    inbox = Inbox()
    publisher = graph.node("talker").advertise("/map", STRING, LATCHED)
    publisher.write(string("old"))
    subscription = graph.node("listener").subscribe("/map", STRING, Qos(), inbox)
    wait_for(lambda: publisher.matched and subscription.matched)
    publisher.write(string("new"))
    wait_for(lambda: "new" in inbox)
    assert inbox == ["new"]


SETTINGS = [
    Qos(reliability=r, durability=d)  # type: ignore[arg-type]
    for r, d in itertools.product(("reliable", "best_effort"), ("volatile", "transient_local"))
]


@pytest.mark.parametrize("offered", SETTINGS, ids=lambda q: f"{q.reliability}-{q.durability}")
def test_settings_match_or_say_why_not(graph: Graph, offered: Qos) -> None:
    """Endpoints match exactly where the rules allow it; elsewhere both sides name the reason."""
    publisher = graph.node("talker").advertise("/chatter", STRING, offered)
    node = graph.node("listener")
    subscriptions = [node.subscribe("/chatter", STRING, q, Inbox()) for q in SETTINGS]
    expected = [incompatibility(offered, q) for q in SETTINGS]
    wait_for(lambda: publisher.matched == expected.count(None))
    for subscription, why in zip(subscriptions, expected, strict=True):
        if why is None:
            wait_for(lambda s=subscription: s.matched == 1)
            assert subscription.status().reason == ""
        else:
            words = f"node /talker publishes /chatter as {STRING}, but {why}"
            wait_for(lambda s=subscription, w=words: s.status().reason == w)
            assert (subscription.status().matched, subscription.status().code) == (0, "ROS004")
    for why in filter(None, expected):
        words = f"node /listener subscribes to /chatter as {STRING}, but {why}"
        wait_for(lambda w=words: w in publisher.status().reason)
        assert publisher.status().code == "ROS004"


def test_another_type_is_reported(graph: Graph) -> None:
    """A peer that uses another type on the topic is named, with its type, on both sides."""
    publisher = graph.node("talker").advertise("/chatter", "std_msgs/msg/Int32", Qos())
    subscription = graph.node("listener").subscribe("/chatter", STRING, Qos(), Inbox())
    wait_for(lambda: subscription.status().code == "ROS003" and publisher.status().code == "ROS003")
    wait_for(lambda: "node /talker" in subscription.status().reason)
    status = subscription.status()
    assert status.matched == 0
    assert status.reason == f"node /talker publishes /chatter as std_msgs/msg/Int32, here it is {STRING}"


def test_another_definition_is_reported(graph: Graph) -> None:
    """A peer whose type has the same name but other fields is named on both sides."""
    name = "cell_msgs/msg/State"
    ours = graph.store.with_definition(name, "int32 a\nint32 b\n")
    theirs = graph.store.with_definition(name, "int32 a\nfloat32 b\n")
    publisher = graph.node("talker", theirs).advertise("/state", name, Qos())
    subscription = graph.node("listener", ours).subscribe("/state", name, Qos(), Inbox())
    wait_for(lambda: subscription.status().code == "ROS003" and publisher.status().code == "ROS003")
    wait_for(lambda: "node /talker" in subscription.status().reason)
    expected = f"node /talker publishes /state as {name} with another definition"
    assert subscription.status().reason.startswith(expected)


def test_nobody_there_is_no_error(graph: Graph) -> None:
    """Without a peer the status says so, and has no error code."""
    node = graph.node("alone")
    publisher = node.advertise("/out", STRING, Qos())
    subscription = node.subscribe("/in", STRING, Qos(), Inbox())
    assert (publisher.status().code, publisher.status().reason) == ("", "no node subscribes to /out")
    assert (subscription.status().code, subscription.status().reason) == ("", "no node publishes /in")
    assert publisher.write(string("into the void"))


@pytest.mark.parametrize("payload", [b"", b"\0\1", b"\0\7\0\0\2\0\0\0a\0", b"abcdefgh"], ids=repr)
def test_payload_without_header_is_refused(graph: Graph, payload: bytes) -> None:
    """Bytes without a plain CDR header are refused and counted; the next message goes through."""
    inbox = Inbox()
    publisher = graph.node("talker").advertise("/chatter", STRING, Qos())
    graph.node("listener").subscribe("/chatter", STRING, Qos(), inbox)
    wait_for(lambda: publisher.matched)
    with pytest.raises(RosplcError, match=r"/chatter.*ROS008"):
        publisher.write(payload)
    publisher.write(string("good"))
    wait_for(lambda: inbox)
    assert inbox == ["good"]
    assert (publisher.status().rejected, publisher.status().sent) == (1, 1)


def test_unknown_type_is_refused(graph: Graph) -> None:
    """A type that the store does not know is refused in both directions."""
    node = graph.node("node")
    with pytest.raises(RosplcError) as refused:
        node.subscribe("/chatter", "std_msgs/msg/Sting", Qos(), Inbox())
    assert refused.value.code == "TYP001"
    with pytest.raises(RosplcError) as refused:
        node.advertise("/chatter", "std_msgs/msg/Sting", Qos())
    assert refused.value.code == "TYP001"
    assert node.status() == ()


def test_bad_names_are_refused(graph: Graph) -> None:
    """Names that break ROS's rules are refused, of topics, nodes and namespaces."""
    node = graph.node("node")
    for call in (
        lambda: node.advertise("/a b", STRING, Qos()),
        lambda: node.subscribe("/1st", STRING, Qos(), Inbox()),
        lambda: graph.node("no-de"),
        lambda: graph.node("node", namespace="relative"),
    ):
        with pytest.raises(RosplcError) as refused:
            call()
        assert refused.value.code == "ROS005"


def test_namespace_and_remapping_apply(graph: Graph) -> None:
    """Relative and private names are expanded, then remapped."""
    node = graph.node("cell", namespace="/robot1", remap={"cmd_vel": "/base/cmd_vel"})
    endpoints = [node.advertise(name, STRING, Qos()) for name in ("cmd_vel", "~/state", "/abs", "odom")]
    assert [endpoint.topic for endpoint in endpoints] == [
        "/base/cmd_vel",
        "/robot1/cell/state",
        "/abs",
        "/robot1/odom",
    ]


def test_many_topics(graph: Graph) -> None:
    """250 topics in one process each deliver their own messages."""
    talker, listener = graph.node("talker"), graph.node("listener")
    inboxes = [Inbox() for _ in range(250)]
    publishers = [talker.advertise(f"/topic{n}", STRING, Qos()) for n in range(250)]
    for number, inbox in enumerate(inboxes):
        listener.subscribe(f"/topic{number}", STRING, Qos(), inbox)
    wait_for(lambda: all(publisher.matched for publisher in publishers))
    for number, publisher in enumerate(publishers):
        publisher.write(string(f"message {number}"))
    wait_for(lambda: all(inboxes))
    assert inboxes == [[f"message {number}"] for number in range(250)]
    assert {status.matched for status in talker.status()} == {1}


def test_slow_receiver_keeps_the_newest(graph: Graph) -> None:
    """While a receiver is busy its queue holds the newest ``depth`` messages."""
    inbox, busy, go = Inbox(), threading.Event(), threading.Event()

    def slow(payload: bytes, stamp_ns: int) -> None:
        inbox(payload, stamp_ns)
        busy.set()
        go.wait()

    publisher = graph.node("talker").advertise("/chatter", STRING, RELIABLE)
    subscription = graph.node("listener").subscribe("/chatter", STRING, Qos(depth=2), slow)
    wait_for(lambda: publisher.matched and subscription.matched)
    publisher.write(string("0"))
    busy.wait()
    for number in range(1, 10):
        publisher.write(string(str(number)))
    if graph.kind == "dds":
        time.sleep(0.5)  # until all have arrived in the queue; no event tells
    go.set()
    wait_for(lambda: "9" in inbox)
    assert inbox == ["0", "8", "9"]


def test_failing_receiver_is_counted(graph: Graph, caplog: pytest.LogCaptureFixture) -> None:
    """An exception of the callback is logged once and counted; receiving goes on."""
    inbox = Inbox()

    def fail(payload: bytes, stamp_ns: int) -> None:
        inbox(payload, stamp_ns)
        raise RuntimeError("broken receiver")

    publisher = graph.node("talker").advertise("/chatter", STRING, Qos())
    subscription = graph.node("listener").subscribe("/chatter", STRING, Qos(), fail)
    wait_for(lambda: publisher.matched)
    for number in range(3):
        publisher.write(string(str(number)))
    wait_for(lambda: subscription.status().failed == 3)
    assert inbox == ["0", "1", "2"]
    assert caplog.text.count("RuntimeError: broken receiver") == 1


def test_subscription_closes_itself(graph: Graph) -> None:
    """A callback may close its own subscription; nothing more is delivered to it."""
    inbox = Inbox()
    publisher = graph.node("talker").advertise("/chatter", STRING, RELIABLE)
    node = graph.node("listener")

    def once(payload: bytes, stamp_ns: int) -> None:
        inbox(payload, stamp_ns)
        subscription.close()

    subscription = node.subscribe("/chatter", STRING, RELIABLE, once)
    wait_for(lambda: publisher.matched)
    for number in range(10):
        publisher.write(string(str(number)))
    wait_for(lambda: publisher.matched == 0)
    assert inbox == ["0"]
    assert node.status() == ()
    assert subscription.status().reason == "closed"


def test_no_callback_after_close(graph: Graph) -> None:
    """Once ``close`` has returned, no callback runs."""
    publisher = graph.node("talker").advertise("/chatter", STRING, SENSOR_DATA)
    node = graph.node("listener")
    stop = threading.Event()

    def flood() -> None:
        while not stop.is_set():
            publisher.write(string("x"))
            time.sleep(0)

    thread = threading.Thread(target=flood)
    thread.start()
    try:
        for _ in range(20):
            got = threading.Event()
            late: list[bytes] = []
            closed = threading.Event()

            def receive(
                payload: bytes,
                _: int,
                late: list[bytes] = late,
                got: threading.Event = got,
                closed: threading.Event = closed,
            ) -> None:
                got.set()
                time.sleep(0.001)
                if closed.is_set():
                    late.append(payload)

            subscription = node.subscribe("/chatter", STRING, SENSOR_DATA, receive)
            got.wait()
            subscription.close()
            closed.set()
            time.sleep(0.005)
            assert late == []
    finally:
        stop.set()
        thread.join()


def test_peer_that_leaves_is_missed(graph: Graph) -> None:
    """When a publisher closes, its subscribers notice."""
    talker = graph.node("talker")
    publisher = talker.advertise("/chatter", STRING, Qos())
    subscription = graph.node("listener").subscribe("/chatter", STRING, Qos(), Inbox())
    wait_for(lambda: subscription.matched == 1)
    publisher.close()
    wait_for(lambda: subscription.matched == 0)
    wait_for(lambda: subscription.status().reason == "no node publishes /chatter")
    talker.close()


def test_closed_things_say_so(graph: Graph) -> None:
    """Whatever is closed refuses further use, and closing twice is harmless."""
    node = graph.node("node")
    publisher = node.advertise("/chatter", STRING, Qos())
    publisher.close()
    publisher.close()
    with pytest.raises(RosplcError, match="ROS009"):
        publisher.write(string("x"))
    other = node.advertise("/other", STRING, Qos())
    node.close()
    node.close()
    with pytest.raises(RosplcError, match="ROS009"):
        other.write(string("x"))
    with pytest.raises(RosplcError, match="ROS009"):
        node.subscribe("/chatter", STRING, Qos(), Inbox())
    assert node.status() == ()


def test_closing_leaves_nothing_behind(graph: Graph) -> None:
    """Threads and file descriptors are given back, also by nodes that had been busy."""

    def cycle() -> None:
        inbox = Inbox()
        talker, listener = graph.node("talker"), graph.node("listener")
        publisher = talker.advertise("/chatter", STRING, Qos())
        listener.subscribe("/chatter", STRING, Qos(), inbox)
        wait_for(lambda: publisher.matched)
        publisher.write(string("x"))
        wait_for(lambda: inbox)
        talker.close()
        listener.close()

    def held() -> tuple[int, int]:
        return len(os.listdir("/proc/self/task")), len(os.listdir("/proc/self/fd"))

    cycle()  # the first one loads libraries
    before = held()
    for _ in range(5):
        cycle()
    # A thread that has been joined may stand in /proc for another moment.
    wait_for(lambda: all(now <= then for now, then in zip(held(), before, strict=True)))


def test_endpoints_may_be_used_from_many_threads(graph: Graph) -> None:
    """Writing, opening, closing and asking at the same time neither loses nor breaks anything."""
    talker, listener = graph.node("talker"), graph.node("listener")
    inboxes = [Inbox() for _ in range(4)]
    publishers = [talker.advertise(f"/topic{n}", STRING, RELIABLE) for n in range(4)]
    for number, inbox in enumerate(inboxes):
        listener.subscribe(f"/topic{number}", STRING, RELIABLE, inbox)
    wait_for(lambda: all(publisher.matched for publisher in publishers))
    failures: list[BaseException] = []
    done = threading.Event()

    def guarded(work: object) -> None:
        try:
            work()  # type: ignore[operator]
        except BaseException as error:
            failures.append(error)

    def write(half: int) -> None:
        for number in range(200):
            for publisher in publishers:
                publisher.write(string(f"{half}:{number}"))

    def come_and_go() -> None:
        while not done.is_set():
            publisher = talker.advertise("/short", STRING, Qos())
            subscription = listener.subscribe("/short", STRING, Qos(), Inbox())
            publisher.close()
            subscription.close()

    def ask() -> None:
        while not done.is_set():
            talker.status()
            listener.graph()
            time.sleep(0.001)

    writers = [threading.Thread(target=guarded, args=(lambda h=half: write(h),)) for half in (0, 1)]
    others = [threading.Thread(target=guarded, args=(work,)) for work in (come_and_go, ask)]
    for thread in writers + others:
        thread.start()
    for thread in writers:
        thread.join()
    wait_for(lambda: all(len(inbox) == 400 for inbox in inboxes) or failures)
    done.set()
    for thread in others:
        thread.join()
    assert failures == []
    for inbox in inboxes:
        for half in "01":
            assert [text for text in inbox if text[0] == half] == [f"{half}:{n}" for n in range(200)]


def test_graph_shows_the_others(graph: Graph) -> None:
    """Other nodes' names, topics, types and settings are seen; one's own are left out."""
    talker = graph.node("talker", namespace="/robot1")
    talker.advertise("/map", STRING, LATCHED)
    talker.subscribe("/cmd_vel", "geometry_msgs/msg/Twist", SENSOR_DATA, Inbox())
    listener = graph.node("listener")
    listener.advertise("/own", STRING, Qos())
    wait_for(lambda: len(listener.graph().endpoints) == 2 and all(e.node for e in listener.graph().endpoints))
    seen = listener.graph()
    assert seen.nodes == ("/robot1/talker",)
    assert seen.topics == {"/cmd_vel": ("geometry_msgs/msg/Twist",), "/map": (STRING,)}
    cmd_vel, chart = seen.endpoints
    assert (cmd_vel.topic, cmd_vel.direction, cmd_vel.node) == ("/cmd_vel", "in", "/robot1/talker")
    assert cmd_vel.qos == Qos(reliability="best_effort", durability="volatile", depth=cmd_vel.qos.depth)
    assert (chart.topic, chart.direction) == ("/map", "out")
    assert chart.qos.durability == "transient_local"
    assert chart.type_hash == graph.store.type_hash(STRING)


def test_every_distro_talks_to_itself(graph: Graph) -> None:
    """Nodes of each ROS 2 distribution exchange messages, and see each other's names."""
    for distro in ("humble", "jazzy", "kilted", "lyrical"):
        store, inbox = TypeStore.bundled(distro), Inbox()
        listener = graph.node(f"listener_{distro}", store)
        publisher = graph.node(f"talker_{distro}", store).advertise(f"/{distro}", STRING, Qos())
        listener.subscribe(f"/{distro}", STRING, Qos(), inbox)
        wait_for(lambda p=publisher: p.matched)
        publisher.write(string(distro))
        wait_for(lambda i=inbox: i)
        assert inbox == [distro]
        wait_for(lambda n=listener, d=distro: f"/talker_{d}" in n.graph().nodes)
        for backend in graph.backends():
            backend.close()
