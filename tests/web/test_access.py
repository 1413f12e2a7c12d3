"""Who may ask the page's server: Host, Origin, token."""

from __future__ import annotations

import json

import pytest

from rosplc.web.access import SECURITY_HEADERS, is_loopback, wrong_host, wrong_origin
from tests.web.peers import TOKEN

pytestmark = pytest.mark.verifies("web", own="rosplc alone")


@pytest.mark.parametrize(
    "host",
    [
        "localhost",
        "LOCALHOST:8480",
        "127.0.0.1:8480",
        "[::1]:8480",
        "192.168.1.5",
        "cell1.plant:80",
        "Cell1.Plant",
    ],
)
def test_an_address_or_a_known_name_is_a_host_of_ours(host: str) -> None:
    """A name cannot be rebound if it is an address, localhost, or one that the user gave."""
    assert not wrong_host(host, ["cell1.plant"])


@pytest.mark.parametrize(
    "host",
    [
        "",
        "evil.example",
        "localhost.evil.example",
        "127.0.0.1.evil.example",
        "cell1",
        "[::1",
        "@localhost@evil",
    ],
)
def test_another_name_is_no_host_of_ours(host: str) -> None:
    """Whatever else is in Host was chosen by somebody else."""
    assert wrong_host(host, ["cell1.plant"])


@pytest.mark.parametrize(
    ("origin", "wrong"),
    [
        ("http://localhost:8480", False),
        ("https://localhost:8480", False),
        ("http://localhost:8481", True),
        ("http://localhost", True),
        ("http://evil.example", True),
        ("null", True),
        ("", True),
        ("file://localhost:8480", True),
        ("http://[", True),
    ],
)
def test_an_origin_is_ours_if_host_and_port_are(origin: str, wrong: bool) -> None:
    """Another port of this machine is another site."""
    assert wrong_origin(origin, "localhost:8480") is wrong


def test_addresses_of_this_machine_alone_are_told_apart() -> None:
    """Loopback is what no other machine reaches."""
    assert all(is_loopback(each) for each in ("127.0.0.1", "127.1.2.3", "::1", "localhost"))
    assert not any(is_loopback(each) for each in ("0.0.0.0", "::", "192.168.1.5", "machine"))


@pytest.mark.parametrize(
    "path", ["/", "/static/app.js", "/api/status", "/nothing", "/api/form", "/static/%2e%2e/web"]
)
def test_every_answer_has_the_security_headers(serving, path: str) -> None:
    """Pages, data and errors alike forbid foreign content, sniffing and frames."""

    async def talk(client):
        async with client.get(path) as answer:
            for name, value in SECURITY_HEADERS.items():
                assert answer.headers[name] == value
            assert answer.headers["Server"] == "rosplc"

    serving(talk)


def test_the_page_allows_no_inline_and_no_foreign_content() -> None:
    """The policy names nothing but this server, and neither inline code nor eval."""
    policy = SECURITY_HEADERS["Content-Security-Policy"]
    assert "default-src 'none'" in policy and "require-trusted-types-for 'script'" in policy
    assert "unsafe" not in policy and "http" not in policy and "*" not in policy


@pytest.mark.parametrize("path", ["/", "/api/status", "/api/live", "/static/app.js"])
def test_a_foreign_host_is_refused_everywhere(serving, path: str) -> None:
    """A name that somebody made lead here gets nothing, not even the page."""

    async def talk(client):
        async with client.get(path, headers={"Host": "evil.example"}) as answer:
            assert answer.status == 421
            assert (await answer.json())["error"]["code"] == "WEB003"

    serving(talk)


def test_a_name_that_the_user_gave_is_answered(serving) -> None:
    """--name lets a browser ask by it."""

    async def talk(client):
        async with client.get("/api/status", headers={"Host": "cell1.plant"}) as answer:
            assert answer.status == 200

    serving(talk, names=("cell1.plant",))


@pytest.mark.parametrize(
    "headers",
    [
        {"Origin": "http://evil.example"},
        {"Origin": "null"},
        {"Sec-Fetch-Site": "cross-site"},
        {"Sec-Fetch-Site": "same-site"},
    ],
)
def test_another_sites_request_is_refused(serving, headers: dict[str, str]) -> None:
    """Neither data nor a WebSocket goes to the page of another site, which a browser names."""

    async def talk(client):
        for path in ("/api/status", "/api/live"):
            async with client.get(path, headers=headers) as answer:
                assert answer.status == 403
                assert (await answer.json())["error"]["code"] == "WEB004"

    serving(talk)


def test_a_link_from_another_site_opens_the_page(serving) -> None:
    """The page itself says nothing, so a link to it may stand anywhere."""

    async def talk(client):
        async with client.get("/", headers={"Sec-Fetch-Site": "cross-site"}) as answer:
            assert answer.status == 200

    serving(talk)


def test_a_websocket_without_origin_is_refused(serving) -> None:
    """Every browser names the page that opens a WebSocket; what does not is no page."""

    async def talk(client):
        async with client.get("/api/live") as answer:
            assert (await answer.json())["error"]["code"] == "WEB004"

    serving(talk)


def test_looking_needs_the_token_where_it_is_asked_for(serving) -> None:
    """Without it data is refused, with another one too; the page itself, which says nothing, is not."""

    async def talk(client):
        for headers in ({}, {"Authorization": "Bearer wrong"}, {"Authorization": f"Basic {TOKEN}"}):
            async with client.get("/api/status", headers=headers) as answer:
                assert answer.status == 401
                assert (await answer.json())["error"]["code"] == "WEB005"
        async with client.get("/") as answer:
            assert answer.status == 200
        async with client.get("/api/status", headers={"Authorization": f"Bearer {TOKEN}"}) as answer:
            assert answer.status == 200

    serving(talk, token=TOKEN, token_to_view=True)


@pytest.mark.parametrize("given", [None, "", "wrong", 7])
def test_a_websocket_shows_nothing_before_the_token(serving, given: object) -> None:
    """The first message brings it; after a wrong one nothing follows but the refusal."""

    async def talk(client):
        origin = str(client.make_url("/")).rstrip("/")
        async with client.ws_connect("/api/live", headers={"Origin": origin}) as socket:
            await socket.send_str(json.dumps({"wants": {}} | ({} if given is None else {"token": given})))
            assert (await socket.receive_json())["error"]["code"] == "WEB005"
            assert (await socket.receive()).data == 1008

    serving(talk, token=TOKEN, token_to_view=True)


def test_a_websocket_with_the_token_is_served(serving) -> None:
    """With the right token the picture comes."""

    async def talk(client):
        origin = str(client.make_url("/")).rstrip("/")
        async with client.ws_connect("/api/live", headers={"Origin": origin}) as socket:
            await socket.send_json({"token": TOKEN})
            assert (await socket.receive_json())["hello"]["machine"] == "machine"
            assert "time_ms" in await socket.receive_json()

    serving(talk, token=TOKEN, token_to_view=True)
