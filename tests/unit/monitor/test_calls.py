"""What views show of services and actions: from the objects alone, without a configuration or a bridge."""

from __future__ import annotations

import json
from contextlib import ExitStack
from functools import partial

import pytest

from rosplc.described import description_of
from rosplc.errors import ChannelError
from rosplc.monitor import Expected, State
from rosplc.monitor.message import status_words
from rosplc.reasons import Reason
from rosplc.shm import ACTION, SERVICE, Caller, OwnedChannel, Part, attach
from rosplc.shm import constants as spec
from rosplc.shm.calls import WORDS
from tests.channels import layout_of
from tests.command import rosplc
from tests.lib.channels import acting_reader

TYPES = {
    Part.REQUEST: "std_srvs/srv/SetBool_Request",
    Part.RESPONSE: "std_srvs/srv/SetBool_Response",
    Part.GOAL: "std_msgs/msg/Int32",
    Part.RESULT: "std_msgs/msg/Int32",
    Part.FEEDBACK: "std_msgs/msg/Float64",
}


class Use:
    """Both sides of one use, one step at a time."""

    def __init__(self, cell, server, parts, client=""):
        self.cell, self.parts, self.stack = cell, parts, ExitStack()
        self.layouts = {part: layout_of(TYPES[part]) for part in parts}
        about = {"bridge": "cell", "client": client}
        opened = OwnedChannel.open_together(
            cell.namespace,
            [
                (description_of(layout, "/s", part.direction(server), part=part, **about), layout.size)
                for part, layout in self.layouts.items()
            ],
        )
        self.users, self.writers, maps = [], {}, {}
        for part, channel in zip(parts, opened, strict=True):
            plc = self.stack.enter_context(attach(cell.namespace, "/s", write=True, part=part, client=client))
            self.stack.enter_context(channel)
            bridge_writes = part.direction(server) == 1
            writer = channel.writer(100) if bridge_writes else plc.writer(100)
            reader = acting_reader(plc, "Task", beat_ms=100) if bridge_writes else channel.reader(100)
            maps[part] = channel if bridge_writes else plc
            self.writers[part] = writer
            self.users += [writer, reader]
        self.bridge = [
            user for user, part in zip(self.users[::2], parts, strict=True) if part.direction(server) == 1
        ]
        self.caller = Caller(maps[parts[0]], self.writers[parts[0]], follows_claim=False)

    def ask(self, **fields):
        part = self.parts[0]
        return self.caller.call(partial(self.writers[part].publish, self.layouts[part].pack(fields)))

    def answer(self, status, reason=0, part=None, **fields):
        part = part or self.parts[1]
        record = self.layouts[part].pack(fields)
        self.writers[part].publish(record, correlation=self.caller.correlation, status=status, reason=reason)
        if status not in (spec.ANSWER_ACCEPTED,):
            self.caller.correlation = 0

    def look(self, watch, looks=2):
        for _ in range(looks):
            for user in self.users:
                user.beat()
            self.cell.pass_time(0.25)
            picture = watch.look()
        return picture, {view.part: view for view in picture.channels}


@pytest.fixture
def use(cell):
    with ExitStack() as stack:

        def make(server="plc", parts=SERVICE, client=""):
            made = Use(cell, server, parts, client)
            stack.enter_context(made.stack)
            return made

        yield make


@pytest.mark.parametrize("server", ["plc", "ros"])
def test_a_call_is_open_until_it_is_answered_and_its_end_is_in_words(cell, use, server):
    """Either way round: number, outcome with its reason, and who is alive."""
    made, watch = use(server, client="left" if server == "ros" else ""), cell.watch(calls=True)
    _, seen = made.look(watch)
    request = seen["request"]
    assert (request.state, request.words, request.kind) == (State.OK, "no call yet", "service")
    assert request.label == ("/s request left" if server == "ros" else "/s request")
    assert (request.bridge_alive, request.plc_alive, request.call.server) == (True, True, server)
    made.ask(data=True)
    _, seen = made.look(watch)
    assert (seen["request"].call.open, seen["request"].words) == (True, "call 1 is open: called")
    made.answer(spec.ANSWER_DONE, success=True)
    _, seen = made.look(watch)
    assert (seen["request"].call.open, seen["request"].words) == (False, "call 1 has ended: done")
    made.ask(data=True)
    made.answer(spec.ANSWER_NOT_EXECUTED, Reason.TIME_OUT)
    _, seen = made.look(watch)
    ended = {"done": 1, "not executed: no answer arrived within the time limit": 1}
    assert seen["request"].call.ended == seen["response"].call.ended == ended
    assert seen["request"].call.correlation == seen["response"].call.correlation
    message = watch.message(seen["response"])
    assert message.marks[-2:] == ("call 2", "not executed: no answer arrived within the time limit")
    assert message.values == {"success": False, "message": ""}


def test_ends_between_two_looks_are_counted_once(cell, use):
    """Several calls may end between two looks; what the slots still hold is counted, each once."""
    made, watch = use(), cell.watch(calls=True)
    for _ in range(3):
        made.ask()
        made.answer(spec.ANSWER_DONE)
    for _ in range(2):
        _, seen = made.look(watch)
        assert seen["response"].call.ended == {"done": 3}


def test_a_goal_is_followed_to_its_end(cell, use):
    """Accepted is no end; a request to cancel and its answer show, and the result ends it."""
    made, watch = use("plc", ACTION), cell.watch(calls=True)
    made.ask(data=3)
    made.answer(spec.ANSWER_ACCEPTED)
    made.answer(spec.ANSWER_ACCEPTED, part=Part.FEEDBACK, data=0.5)
    picture, seen = made.look(watch)
    assert (seen["goal"].call.open, seen["goal"].words) == (True, "call 1 is open: accepted")
    assert watch.message(seen["feedback"]).values == {"data": 0.5}
    goal = made.writers[Part.GOAL]
    made.caller.again(partial(goal.publish, made.layouts[Part.GOAL].pack({"data": 3})), spec.ASK_CANCEL)
    made.answer(spec.ANSWER_CANCELED, data=2)
    _, seen = made.look(watch)
    assert watch.message(seen["goal"]).marks[-1] == "cancel requested"
    assert seen["goal"].words == "call 1 has ended: canceled"
    assert {view.kind for view in picture.channels} == {"action"}


def test_a_plc_that_is_not_there_and_a_server_that_is_not_ready(cell, use):
    """What the PLC calls without a server is a warning, as in /diagnostics."""
    made, watch = use("ros"), cell.watch(calls=True)
    made.users[1].set_sinks(0)
    _, seen = made.look(watch)
    assert (seen["request"].state, seen["response"].state) == (State.NO_SERVER, State.OK)
    made.users[1].set_sinks(1)
    _, seen = made.look(watch)
    assert seen["request"].state is State.OK


def test_what_is_configured_and_missing_is_named(cell):
    """Each object of a use that no bridge has made is missing."""
    wanted = tuple((cell.namespace.prefix, "/s", part, "left") for part in SERVICE)
    picture = cell.watch(calls=True, expected=Expected(calls=wanted)).look()
    assert [view.label for view in picture.channels] == ["/s request left", "/s response left"]
    assert {view.state for view in picture.channels} == {State.MISSING}


def test_views_that_were_made_for_topics_see_no_calls(cell, use):
    """The recorder and the list of topics look at topics alone; one name may be both."""
    use()
    cell.side("/s")
    assert [view.kind for view in cell.watch().look().channels] == ["topic"]
    assert len(cell.watch(calls=True, topic="/s").look().channels) == 3


def test_a_damaged_object_of_a_service_is_unreadable(cell, use):
    """Nothing of it is believed, and it keeps its name."""
    use()
    path = cell.namespace.path("/s", Part.REQUEST)
    with path.open("r+b") as file:
        file.write(b"\xff" * 64)
    watch = cell.watch(calls=True)
    (view,) = (view for view in watch.look().channels if view.part == "request")
    assert (view.state, view.label, view.call) == (State.UNREADABLE, "/s request", None)
    with pytest.raises(ChannelError):
        watch.message(view)


def test_every_status_and_reason_has_words():
    """Unknown ones are shown as numbers, and hide nothing."""
    answers = [status_words(Part.RESPONSE, status, 0) for status in range(1, 9)]
    assert len(set(answers)) == 8
    assert not [words for words in answers if words.startswith("status")]
    assert status_words(Part.RESULT, 9 | spec.ANSWER_CANCEL_REJECTED, 99) == "status 9, cancel rejected"
    assert set(WORDS) == set(Reason)
    assert status_words(Part.GOAL, spec.ASK_CALL | spec.ASK_WITHDRAWN, 0) == "withdrawn"


def shown(*arguments):
    return rosplc("show", *arguments).output


def test_show_decodes_each_object_with_its_call(cell, use):
    """In words and as JSON; with --header the rest, and another prefix is named."""
    made, prefix = use("ros", client="left"), cell.namespace.prefix
    made.ask(data=True)
    made.answer(spec.ANSWER_NOT_EXECUTED, Reason.REJECTED)
    text = shown("/s", "--prefix", prefix, "--header")
    assert "/s request left  std_srvs/srv/SetBool_Request  message 1 (first, call 1, called)" in text
    answer = "message 1 (first, call 1, not executed: the request was refused)"
    assert f"/s response left  std_srvs/srv/SetBool_Response  {answer}" in text
    assert "data: true" in text
    assert "1 not executed: the request was refused" in text
    request, response = json.loads(shown("/s", "--prefix", prefix, "--json", "--header"))
    assert (request["part"], request["client"], request["message"]) == ("request", "left", {"data": True})
    assert response["call"]["status"] == "not executed: the request was refused"
    assert response["object"]["layout_id"] == made.layouts[Part.RESPONSE].layout_id
    listed = {(each["kind"], each["part"]) for each in json.loads(shown("--prefix", prefix, "--json"))}
    assert listed == {("service", "request"), ("service", "response")}
    assert f"add --prefix {prefix}" in rosplc("show", "/s", "--prefix", f"{prefix}x", code=1).output


def test_show_follows_messages_and_gives_up_in_time(cell, use):
    """--count ends with a failure where fewer come; what was there before is not printed."""
    made, prefix = use(), cell.namespace.prefix
    made.ask(data=True)
    done = rosplc("show", "/s", "--prefix", prefix, "--count", "1", "--timeout", "0.05", code=1).output
    assert "0 of 1 messages arrived" in done


def test_status_has_a_line_for_each_use(cell, use):
    """Counts, the newest call and its end in words; who does not live is wrong."""
    made, prefix = use("plc"), cell.namespace.prefix
    made.ask(data=True)
    made.answer(spec.ANSWER_FATE_UNKNOWN, Reason.SERVER_GONE)
    text = rosplc("status", "--prefix", prefix, code=1).output
    (line,) = [line for line in text.splitlines() if "ROS calls PLC" in line]
    assert "fate unknown: the server went offline before it answered" in line
    assert "1 fate unknown" in line
    # Who is named first, bridge or PLC, depends on the age of this process: a young bridge may be starting.
    wrong = text.split("ROS calls PLC")[1]
    assert "/s request" in wrong and ": dead: " in wrong
