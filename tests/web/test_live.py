"""What a page is shown over its WebSocket, and that no page costs others anything."""

from __future__ import annotations

import asyncio
import json
import os
import socket as sockets
from typing import Any

import pytest

from rosplc.shm import Direction
from tests.web.peers import layout_of, open_typed, page_socket

TWIST = "geometry_msgs/msg/Twist"


class Shown:
    """What a page knows after the frames that it took."""

    def __init__(self) -> None:
        self.channels: dict[str, dict[str, Any]] = {}
        self.events: list[dict[str, Any]] = []
        self.messages: dict[str, dict[str, Any]] = {}
        self.samples: list[tuple[float, float | None]] = []

    def take(self, frame: dict[str, Any], path: str = "") -> None:
        for name, members in frame.get("channels", {}).items():
            self.channels.setdefault(name, {}).update(members)
        for name in frame.get("gone", []):
            del self.channels[name]
        self.events += frame.get("events", [])
        self.messages.update(frame.get("messages", {}))
        for block in frame.get("samples", {}).values():
            self.samples += zip(block["t"], block[f"v:{path}"], strict=True)


async def until(socket: Any, shown: Shown, condition: Any, path: str = "") -> None:
    """Take frames until the condition holds; the test's watchdog ends what hangs."""
    while not condition(shown):
        shown.take(await socket.receive_json(), path)


def test_a_page_sees_channels_come_change_and_go(serving, shm_namespace) -> None:
    """The first frame has whole channels, later ones what differs; a vanished one is named."""
    name = f"{shm_namespace.prefix}.t.cmd"

    async def talk(client):
        shown = Shown()
        async with page_socket(client) as socket:
            shown.take(await socket.receive_json())  # what is there at the first look has not appeared
            with open_typed(shm_namespace, "/cmd", TWIST) as channel:
                writer = channel.writer()
                await until(socket, shown, lambda shown: name in shown.channels)
                assert shown.channels[name]["type_name"] == TWIST
                writer.publish(bytes(48))
                await until(socket, shown, lambda shown: shown.channels[name]["received"] == 1)
                frame = await socket.receive_json()
                assert "type_name" not in frame.get("channels", {}).get(name, {})
                channel.retire()
            await until(socket, shown, lambda shown: name not in shown.channels)
            kinds = [event["kind"] for event in shown.events if event["channel"] == name]
            assert kinds[0] == "appeared" and kinds[-1] == "vanished"
            assert [event["number"] for event in shown.events] == sorted(
                {event["number"] for event in shown.events}
            )

    serving(talk)


def test_a_page_sees_the_message_that_it_opened(serving, shm_namespace) -> None:
    """Its values change with the channel, and nothing comes of channels that nobody opened."""
    name, other = f"{shm_namespace.prefix}.t.cmd", f"{shm_namespace.prefix}.t.other"
    layout = layout_of(TWIST)

    async def talk(client):
        shown = Shown()
        with (
            open_typed(shm_namespace, "/cmd", TWIST) as channel,
            open_typed(shm_namespace, "/other", TWIST) as unseen,
        ):
            writer = channel.writer()
            unseen.writer().publish(bytes(48))
            async with page_socket(client, {"messages": [name]}) as socket:
                for number in (1.0, 2.0):
                    writer.publish(layout.pack({"linear": {"x": number}}))
                    await until(
                        socket,
                        shown,
                        lambda shown, number=number: (
                            shown.messages.get(name, {}).get("values", {}).get("linear", {}).get("x")
                            == number
                        ),
                    )
                assert other not in shown.messages

    serving(talk)


def test_a_page_sees_the_fields_that_it_plots(serving, shm_namespace) -> None:
    """Each sample has a time, and values come in the order in which they were written."""
    name, layout = f"{shm_namespace.prefix}.t.cmd", layout_of(TWIST)

    async def talk(client):
        shown = Shown()
        with open_typed(shm_namespace, "/cmd", TWIST) as channel:
            writer = channel.writer()
            async with page_socket(client, {"plots": {name: ["linear.x"]}}) as socket:
                number = 0
                while len(shown.samples) < 10:
                    number += 1
                    writer.publish(layout.pack({"linear": {"x": number}}))
                    await asyncio.sleep(0.02)
                    shown.take(await socket.receive_json(), "linear.x")
        times, values = zip(*shown.samples, strict=True)
        assert list(times) == sorted(times) and list(values) == sorted(values)

    serving(talk)


def test_looking_changes_no_byte_of_a_channel(serving, shm_namespace) -> None:
    """An object that is watched, opened and plotted is the same as before, byte by byte."""
    name = f"{shm_namespace.prefix}.t.cmd"

    async def talk(client):
        with open_typed(shm_namespace, "/cmd", TWIST) as channel:
            channel.writer().publish(bytes(48))
            before = channel.path.read_bytes()
            shown = Shown()
            wants = {"messages": [name], "plots": {name: ["linear.x"]}}
            async with page_socket(client, wants) as socket:
                await until(
                    socket, shown, lambda shown: name in shown.messages and name in shown.channels, "linear.x"
                )
                assert (await (await client.get("/api/form", params={"channel": name})).json())["layout"]
            assert channel.path.read_bytes() == before

    serving(talk)


def test_damaged_objects_are_shown_as_such(serving, shm_namespace) -> None:
    """A scribbled header, a link and a short file are channels with an error, and others go on."""
    prefix = shm_namespace.prefix

    async def talk(client):
        shown = Shown()
        with open_typed(shm_namespace, "/good", TWIST), open_typed(shm_namespace, "/bad", TWIST) as bad:
            os.symlink("/etc/hostname", shm_namespace.path("/link"))
            shm_namespace.path("/short").write_bytes(b"short")
            with bad.path.open("r+b") as file:
                file.write(b"\xff" * 512)
            names = [f"{prefix}.t.{each}" for each in ("bad", "link", "short")]

            def named(shown):  # the first look may have come before the damage
                codes = [shown.channels.get(name, {}).get("code", "") for name in names]
                codes += [shown.messages.get(name, {}).get("error", {}).get("code", "") for name in names]
                return len(shown.channels) == 4 and all(code.startswith("SHM") for code in codes)

            async with page_socket(client, {"messages": names}) as socket:
                await until(socket, shown, named)
            assert shown.channels[f"{prefix}.t.good"]["code"] == ""

    serving(talk)


def test_an_object_that_is_replaced_is_followed(serving, shm_namespace) -> None:
    """A bridge that comes back with another type shows it, and its message is the new one's."""
    name = f"{shm_namespace.prefix}.t.cmd"

    async def talk(client):
        shown = Shown()
        async with page_socket(client, {"messages": [name]}) as socket:
            with open_typed(shm_namespace, "/cmd", TWIST) as channel:
                channel.writer().publish(bytes(48))
                await until(socket, shown, lambda shown: "values" in shown.messages.get(name, {}))
            with open_typed(shm_namespace, "/cmd", "std_msgs/msg/Float64") as channel:
                channel.writer().publish(layout_of("std_msgs/msg/Float64").pack({"data": 4.5}))
                await until(socket, shown, lambda shown: shown.messages[name].get("values") == {"data": 4.5})
                await until(
                    socket, shown, lambda shown: shown.channels[name]["type_name"].endswith("Float64")
                )

    serving(talk)


@pytest.mark.parametrize(
    "text", ["", "[]", "{", '"x"', "[" * 20000, '{"wants": 3}', '{"wants": {"messages": 1}}']
)
def test_a_page_that_talks_nonsense_is_told_so(serving, text: str) -> None:
    """It gets WEB009 and is left; the server serves the next one."""

    async def talk(client):
        async with page_socket(client) as socket:
            await socket.send_str(text)
            while "error" not in (frame := await socket.receive_json()):
                pass
            assert frame["error"]["code"] == "WEB009"
        async with page_socket(client):
            pass

    serving(talk)


def test_no_more_pages_than_allowed(serving) -> None:
    """One too many is told WEB007; when a page leaves, another may come."""

    async def talk(client):
        origin = str(client.make_url("/")).rstrip("/")
        async with page_socket(client), client.ws_connect("/api/live", headers={"Origin": origin}) as late:
            assert (await late.receive_json())["error"]["code"] == "WEB007"
        while True:
            async with client.ws_connect("/api/live", headers={"Origin": origin}) as socket:
                await socket.send_json({})
                if "hello" in await socket.receive_json():
                    return

    serving(talk, viewers=1)


def test_a_page_that_takes_nothing_keeps_nobody_waiting(serving, shm_namespace) -> None:
    """What is kept for it is bounded, however much there would be to send."""
    from rosplc.web import live

    name, layout = f"{shm_namespace.prefix}.t.scan", layout_of("sensor_msgs/msg/LaserScan")

    async def talk(client):
        url = client.make_url("/")
        with open_typed(shm_namespace, "/scan", "sensor_msgs/msg/LaserScan") as channel:
            writer = channel.writer()
            slow = sockets.create_connection((url.host, url.port))
            slow.setsockopt(sockets.SOL_SOCKET, sockets.SO_RCVBUF, 4096)
            try:
                slow.sendall(_upgrade(url) + _masked(json.dumps({"wants": {"messages": [name]}}).encode()))
                async with page_socket(client, {"messages": [name]}) as quick:
                    shown, number = Shown(), 0
                    while number < 40:
                        number += 1
                        writer.publish(layout.pack({"scan_time": float(number), "ranges": [0.1] * 16}))
                        await until(
                            quick,
                            shown,
                            lambda shown, number=number: (
                                shown.messages.get(name, {}).get("values", {}).get("scan_time") == number
                            ),
                        )
                kept = [_kept(each) for each in client.server.runner.server.connections]
                assert max(kept) < 256 * 1024
            finally:
                slow.close()

    assert live._STALLED_SECONDS < 60
    serving(talk)


def _kept(connection: Any) -> int:
    return 0 if connection.transport is None else connection.transport.get_write_buffer_size()


def _upgrade(url: Any) -> bytes:
    place = f"{url.host}:{url.port}"
    return (
        f"GET /api/live HTTP/1.1\r\nHost: {place}\r\nOrigin: http://{place}\r\nUpgrade: websocket\r\n"
        "Connection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
        "Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\r\n"
    ).encode()


def _masked(text: bytes) -> bytes:
    assert len(text) < 126
    return bytes([0x81, 0x80 | len(text)]) + bytes(4) + text


def test_nobody_looks_at_messages_that_no_page_shows(serving, shm_namespace, monkeypatch) -> None:
    """Without a page only the channels' counters are looked at."""
    from rosplc.monitor import Watch

    read: list[str] = []
    original = Watch.message
    monkeypatch.setattr(
        Watch, "message", lambda self, channel: read.append(channel) or original(self, channel)
    )
    name = f"{shm_namespace.prefix}.t.cmd"

    async def talk(client):
        with open_typed(shm_namespace, "/cmd", TWIST, Direction.TO_ROS):
            shown = Shown()
            async with page_socket(client) as socket:
                await until(socket, shown, lambda shown: name in shown.channels)
                assert read == []
                await socket.send_json({"wants": {"messages": [name]}})
                await until(socket, shown, lambda shown: name in shown.messages)
                await socket.send_json({"wants": {}})
                for _ in range(4):
                    before = len(read)
                    shown.take(await socket.receive_json())
                assert len(read) == before

    serving(talk)


def test_the_status_is_what_rosplc_status_prints(serving, shm_namespace) -> None:
    """The same objects, for one that asks once."""

    async def talk(client):
        with open_typed(shm_namespace, "/cmd", TWIST):
            while True:
                answer = await (await client.get("/api/status")).json()
                if answer["channels"]:
                    break
            assert set(answer) >= {"time_ns", "worst", "channels", "bridges", "events", "notes"}
            assert answer["channels"][0]["topic"] == "/cmd"

    serving(talk)
