"""Writing a test message: with the token, where nobody else writes, once."""

from __future__ import annotations

import asyncio
import os
import threading

import pytest
from typer.testing import CliRunner

from rosplc import attach
from rosplc.cli.app import app
from rosplc.shm import Direction, Writer
from rosplc.shm import attach as attach_object
from rosplc.shm.constants import WRITER_LINE
from tests.web.peers import TOKEN, layout_of, open_typed

TWIST = "geometry_msgs/msg/Twist"
ALLOWED = {"allow_write": True, "token": TOKEN}


async def known(client, name):
    """Wait until the server has seen a channel, and return its form."""
    while "form" not in (answer := await (await client.get("/api/form", params={"channel": name})).json()):
        assert answer["error"]["code"] == "WEB008"
    return answer


async def write(client, name, layout, message, token=TOKEN):
    """Ask for a message to be written; return the status and the answer."""
    body = {"channel": name, "layout": layout, "message": message}
    headers = {"Authorization": f"Bearer {token}"} if token else {}
    async with client.post("/api/write", json=body, headers=headers) as answer:
        return answer.status, await answer.json()


async def event(client, kind, topic):
    """Return the words of the event that the server noted."""
    from tests.web.peers import page_socket

    async with page_socket(client) as socket:
        while True:
            for each in (await socket.receive_json()).get("events", []):
                if (each["kind"], each["topic"]) == (kind, topic):
                    return each["words"]


def test_a_message_towards_ros_is_written_and_the_claim_given_back(serving, shm_namespace) -> None:
    """The bridge finds exactly what the form said, the rest at its initial value, and nobody as writer."""
    name = f"{shm_namespace.prefix}.t.cmd"

    async def talk(client):
        with open_typed(shm_namespace, "/cmd", TWIST, Direction.TO_ROS) as channel:
            reader = channel.reader()
            layout = (await known(client, name))["layout"]
            message = {"linear": {"x": "0.25"}, "angular": {"z": -1}}
            assert await write(client, name, layout, message) == (200, {"sequence": 1})
            record = bytearray(channel.identity.record_size)
            assert reader.next(record) is not None
            values = layout_of(TWIST).to_dict(record)
            assert (values["linear"]["x"], values["angular"]["z"], values["linear"]["y"]) == (0.25, -1.0, 0.0)
            assert channel.snapshot().writer.epoch == 0
            assert "wrote test message number 1" in await event(client, "written", "/cmd")

    serving(talk, **ALLOWED)


def test_a_message_towards_the_plc_is_written_while_no_bridge_runs(serving, shm_namespace) -> None:
    """A PLC program can be tried without its robot; the object stays the one that the bridge made."""
    name = f"{shm_namespace.prefix}.t.pose"

    async def talk(client):
        with open_typed(shm_namespace, "/pose", TWIST) as channel:
            generation = channel.generation
        with attach("/pose", prefix=shm_namespace.prefix) as plc:
            form = await known(client, name)
            status, answer = await write(client, name, form["layout"], {"linear": {"x": 1.5}})
            assert (status, answer) == (200, {"sequence": 1})
            message = plc.read()
            assert message is not None and message.linear.x == 1.5
            assert plc.info is not None and plc.info.stamp_ns > 0
            assert plc.snapshot().writer.epoch == 0
        with open_typed(shm_namespace, "/pose", TWIST) as channel:
            assert channel.adopted and channel.generation == generation

    serving(talk, **ALLOWED)


def test_a_running_bridge_is_not_talked_over(serving, shm_namespace) -> None:
    """Towards the PLC its lock refuses the page, with the reason, and nothing of the object changes."""
    name = f"{shm_namespace.prefix}.t.pose"

    async def talk(client):
        with open_typed(shm_namespace, "/pose", TWIST) as channel:
            form = await known(client, name)
            before = channel.path.read_bytes()
            status, answer = await write(client, name, form["layout"], {})
            assert (status, answer["error"]["code"]) == (409, "WEB010")
            assert "bridge" in answer["error"]["what"]
            assert channel.path.read_bytes() == before
            assert "cannot write" in await event(client, "write-refused", "/pose")

    serving(talk, **ALLOWED)


@pytest.mark.parametrize("direction", [Direction.TO_PLC, Direction.TO_ROS])
def test_another_writer_is_not_talked_over(serving, shm_namespace, direction) -> None:
    """A writer that lives keeps its claim even where it is silent, and is named."""
    name = f"{shm_namespace.prefix}.t.cmd"

    async def talk(client):
        with open_typed(shm_namespace, "/cmd", TWIST, direction) as channel:
            if direction is Direction.TO_ROS:
                other = attach("/cmd", prefix=shm_namespace.prefix, write=True)
                other.write({"linear": {"x": 7.0}})
            else:
                other = channel.writer()
            form = await known(client, name)
            epoch = channel.snapshot().writer.epoch
            status, answer = await write(client, name, form["layout"], {})
            assert (status, answer["error"]["code"]) == (409, "WEB010")
            assert f"process {os.getpid()}" in answer["error"]["what"]
            assert channel.snapshot().writer.epoch == epoch
            (other.close if direction is Direction.TO_ROS else other.release)()

    serving(talk, **ALLOWED)


@pytest.mark.parametrize("direction", [Direction.TO_PLC, Direction.TO_ROS])
def test_a_claim_is_never_taken_however_silent_its_holder(serving, shm_namespace, direction) -> None:
    """Structured Text stores no process number: its claim holds for the page until a person releases it."""
    name = f"{shm_namespace.prefix}.t.cmd"

    async def talk(client):
        with open_typed(shm_namespace, "/cmd", TWIST, direction) as channel:
            form = await known(client, name)
            held = Writer(channel.region, 0, 1)  # promised a beat each millisecond: dead at once
            channel.region.store(WRITER_LINE["writer_pid"], 0)
        epoch = held.epoch
        status, answer = await write(client, name, form["layout"], {})
        assert (status, answer["error"]["code"]) == (409, "WEB010")
        assert "rosplc release /cmd" in answer["error"]["remedy"]
        with attach_object(shm_namespace, "/cmd") as attached:
            assert (attached.snapshot().writer.epoch, attached.snapshot().writer.head) == (epoch, 0)
        command = ["release", "/cmd", "--prefix", shm_namespace.prefix]
        assert CliRunner().invoke(app, command).exit_code == 2  # no terminal to ask
        done = await asyncio.to_thread(CliRunner().invoke, app, [*command, "--yes"])
        assert done.exit_code == 0, done.output
        assert (await write(client, name, form["layout"], {}))[0] == 200
        assert "is free" in CliRunner().invoke(app, command).output

    serving(talk, **ALLOWED)


def test_a_living_writer_is_not_released(shm_namespace) -> None:
    """A claim whose holder beats is not freed."""
    with open_typed(shm_namespace, "/cmd", TWIST, Direction.TO_ROS) as channel:
        held, ended = Writer(channel.region, 0, 1000), threading.Event()

        def beat() -> None:
            while not ended.wait(0.01):
                held.beat()

        thread = threading.Thread(target=beat)
        thread.start()
        try:
            done = CliRunner().invoke(app, ["release", "/cmd", "--prefix", shm_namespace.prefix, "--yes"])
        finally:
            ended.set()
            thread.join()
        assert done.exit_code == 1 and "SHM114" in done.stderr
        assert channel.snapshot().writer.epoch == held.epoch


@pytest.mark.parametrize(
    ("type_name", "text", "meant", "status"),
    [
        ("std_msgs/msg/Float64", "1e400", False, 422),
        ("std_msgs/msg/Float64", "1e400", True, 422),
        ("std_msgs/msg/Float32", "1e39", False, 422),
        ("std_msgs/msg/Float32", "-3.4e38", False, 200),
        ("std_msgs/msg/Float64", "nan", False, 422),
        ("std_msgs/msg/Float64", "-Inf", False, 422),
        ("std_msgs/msg/Float64", "nan", True, 200),
        ("std_msgs/msg/Float64", "inf", True, 200),
    ],
)
def test_numbers_that_are_not_finite_have_to_be_meant(
    serving, shm_namespace, type_name, text, meant, status
) -> None:
    """Too large a number is refused; NaN and infinities are written only with a confirmation."""
    name = f"{shm_namespace.prefix}.t.level"

    async def talk(client):
        with open_typed(shm_namespace, "/level", type_name, Direction.TO_ROS):
            form = await known(client, name)
            body = {"channel": name, "layout": form["layout"], "message": {"data": text}, "not_finite": meant}
            headers = {"Authorization": f"Bearer {TOKEN}"}
            async with client.post("/api/write", json=body, headers=headers) as answer:
                assert answer.status == status
                if status != 200:
                    error = (await answer.json())["error"]
                    assert (error["code"], error["where"]) == ("LAY006", "data")

    serving(talk, **ALLOWED)


@pytest.mark.parametrize(
    ("type_name", "message", "where", "what"),
    [
        (TWIST, {"linear": {"x": "fast"}}, "linear.x", "float64"),
        (TWIST, {"linear": {"q": 1}}, "linear", "no field"),
        (TWIST, {"linear": 1}, "linear", "Vector3"),
        ("std_msgs/msg/UInt8", {"data": 256}, "data", "uint8"),
        ("std_msgs/msg/UInt8", {"data": "-1"}, "data", "uint8"),
        ("std_msgs/msg/UInt8", {"data": 1.5}, "data", "uint8"),
        ("std_msgs/msg/Bool", {"data": "yes"}, "data", "bool"),
        ("std_msgs/msg/String", {"data": "x" * 81}, "data", "limit is 80"),
        ("std_msgs/msg/String", {"data": 5}, "data", "not a valid string"),
        ("sensor_msgs/msg/JointState", {"position": ["1"] * 17}, "position", "limit is 16"),
        ("sensor_msgs/msg/JointState", {"position": ["1", "x"]}, "position[1]", "float64"),
        ("std_msgs/msg/Header", {"stamp": {"sec": str(2**31)}}, "stamp.sec", "int32"),
    ],
)
def test_what_does_not_fit_is_refused_with_its_field(serving, shm_namespace, type_name, message, where, what):
    """The error names the field and the limit, and nothing is written."""
    name = f"{shm_namespace.prefix}.t.cmd"

    async def talk(client):
        with open_typed(shm_namespace, "/cmd", type_name, Direction.TO_ROS) as channel:
            form = await known(client, name)
            status, answer = await write(client, name, form["layout"], message)
            error = answer["error"]
            assert (status, error["code"], error["where"]) == (422, "LAY006", where)
            assert what in error["what"]
            assert channel.snapshot().writer.head == 0

    serving(talk, **ALLOWED)


def test_a_form_of_yesterday_is_refused(serving, shm_namespace) -> None:
    """A channel that has another layout by now is not written with the old form's values."""
    name = f"{shm_namespace.prefix}.t.cmd"

    async def talk(client):
        with open_typed(shm_namespace, "/cmd", TWIST, Direction.TO_ROS):
            await known(client, name)
            status, answer = await write(client, name, "0123456789abcdef", {})
            assert (status, answer["error"]["code"]) == (409, "WEB010")
            assert "layout" in answer["error"]["what"]

    serving(talk, **ALLOWED)


def test_without_the_switch_nothing_is_written(serving, shm_namespace) -> None:
    """A server that was started for looking refuses, whatever token comes."""
    name = f"{shm_namespace.prefix}.t.cmd"

    async def talk(client):
        with open_typed(shm_namespace, "/cmd", TWIST, Direction.TO_ROS) as channel:
            form = await known(client, name)
            for token in ("", TOKEN):
                status, answer = await write(client, name, form["layout"], {}, token)
                assert (status, answer["error"]["code"]) == (403, "WEB006")
            assert channel.snapshot().writer.head == 0

    serving(talk, token=TOKEN)


@pytest.mark.parametrize("token", ["", TOKEN[:-1]])
def test_without_the_token_nothing_is_written(serving, shm_namespace, token: str) -> None:
    """No token and another token are refused alike."""
    name = f"{shm_namespace.prefix}.t.cmd"

    async def talk(client):
        with open_typed(shm_namespace, "/cmd", TWIST, Direction.TO_ROS) as channel:
            form = await known(client, name)
            status, answer = await write(client, name, form["layout"], {}, token)
            assert (status, answer["error"]["code"]) == (401, "WEB005")
            assert channel.snapshot().writer.head == 0

    serving(talk, **ALLOWED)


@pytest.mark.parametrize(
    ("body", "kind", "status", "code"),
    [
        (b"{}", "application/json", 400, "WEB009"),
        (b"[", "application/json", 400, "WEB009"),
        (b"[" * 9999, "application/json", 400, "WEB009"),
        (b'{"channel": "x", "layout": "y", "message": {}}', "text/plain", 400, "WEB009"),
        (b'{"channel": "x", "layout": "y", "message": {}}', "application/json", 404, "WEB008"),
        (b'{"channel": "x", "layout": "y", "message": []}', "application/json", 400, "WEB009"),
        (b"\xff\xfe", "application/json", 400, "WEB009"),
        (b"[]", "application/json; charset=nonsense", 400, "WEB009"),
        (b'{"channel": "x", "layout": "y", "message": {"data": NaN}}', "application/json", 400, "WEB009"),
    ],
)
def test_a_malformed_wish_is_an_error_and_no_traceback(serving, body, kind, status, code) -> None:
    """Whatever the bytes are, the answer is an error with a code."""

    async def talk(client):
        headers = {"Authorization": f"Bearer {TOKEN}", "Content-Type": kind}
        async with client.post("/api/write", data=body, headers=headers) as answer:
            assert (answer.status, (await answer.json())["error"]["code"]) == (status, code)

    serving(talk, **ALLOWED)


def test_a_foreign_page_cannot_write_even_with_the_token(serving) -> None:
    """The Origin is looked at before the token."""

    async def talk(client):
        headers = {"Authorization": f"Bearer {TOKEN}", "Origin": "http://evil.example"}
        async with client.post("/api/write", json={}, headers=headers) as answer:
            assert (await answer.json())["error"]["code"] == "WEB004"

    serving(talk, **ALLOWED)
