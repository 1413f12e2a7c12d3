"""The page as a browser shows it: Debian's Chromium, driven by playwright, looking at live channels."""

from __future__ import annotations

import re
import secrets
from collections.abc import Iterator
from contextlib import ExitStack
from typing import Any

import pytest

from rosplc.shm import Direction, Namespace
from tests.browser import WATCHDOG_MS, chromium
from tests.web.peers import Served, end, layout_of, open_typed, start_role

pytestmark = [
    pytest.mark.needs("chromium"),
    pytest.mark.xdist_group("chromium"),
    pytest.mark.timeout(600),
    pytest.mark.verifies("web", real="Chromium, axe"),
]

TABLET, WIDE, PHONE = (
    {"width": 820, "height": 1180},
    {"width": 1180, "height": 820},
    {"width": 390, "height": 844},
)
LONG = pytest.mark.verify(minutes=0.5)


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """Give a headless Chromium."""
    with chromium() as started:
        yield started


class Machine:
    """Processes in the bridge's and the PLC's place, and the page's server."""

    def __init__(self) -> None:
        self.namespace = Namespace(f"T{secrets.token_hex(6)}")
        self.bridge = start_role("bridge", self.namespace.prefix)
        self.plc = start_role("plc", self.namespace.prefix)
        self.server = Served(self.namespace.prefix, "--allow-write")

    def link(self, view: str, topic: str = "") -> str:
        """Return the address of a view, or of a channel."""
        name = f"/{self.namespace.object_name(topic)}" if topic else ""
        return f"{self.server.url}#/{view}{name}"

    def close(self) -> None:
        """End everything, and leave nothing."""
        for process in (self.server.process, self.plc, self.bridge):
            end(process)
        for path in self.namespace.path("/x").parent.glob(f"{self.namespace.prefix}.*"):
            path.unlink()


@pytest.fixture(scope="module")
def machine(browser: Any) -> Iterator[Machine]:
    """Give a machine that is looked at."""
    made = Machine()
    yield made
    made.close()


class Pages:
    """Opens pages, and remembers what they complained of and whom they asked."""

    def __init__(self, browser: Any, address: str) -> None:
        self._browser, self._address = browser, address
        self.complaints: list[str] = []
        self._contexts: list[Any] = []

    def open(self, url: str, **context: Any) -> Any:
        """Open a page in a browser profile of its own."""
        made = self._browser.new_context(**{"viewport": {"width": 1440, "height": 900}, **context})
        made.set_default_timeout(WATCHDOG_MS)
        self._contexts.append(made)
        page = made.new_page()
        page.on("console", lambda said: said.type == "error" and self.complaints.append(said.text))
        page.on("pageerror", lambda error: self.complaints.append(str(error)))
        page.on("request", lambda asked: self._own(asked.url))
        page.goto(url)
        return page

    def _own(self, url: str) -> None:
        if not url.startswith(self._address):
            self.complaints.append(f"asked {url}")

    def close(self) -> None:
        """Close all pages."""
        for context in self._contexts:
            context.close()


@pytest.fixture
def pages(browser: Any, machine: Machine) -> Iterator[Pages]:
    """Give a way to open pages; none may complain, or ask anybody but its own server."""
    made = Pages(browser, machine.server.url)
    yield made
    made.close()
    assert made.complaints == []


def expect(locator: Any) -> Any:
    from playwright.sync_api import expect

    return expect(locator)


def row(page: Any, topic: str) -> Any:
    """Return a channel's row."""
    return page.locator("tr.channel").filter(has=page.get_by_text(topic, exact=True))


def link(page: Any, topic: str) -> Any:
    """Return the link in a channel's row."""
    return page.locator("tr.channel a").filter(has=page.get_by_text(topic, exact=True))


def value_of(page: Any, field: str) -> Any:
    """Return where a field's value is in the open message."""
    return page.locator(".leaf").filter(has=page.get_by_text(field, exact=True)).locator(".field-value")


def test_channels_stand_there_with_word_and_numbers(pages: Pages, machine: Machine) -> None:
    """Each has its state in a word, its way and its rate; the bridge stands above."""
    page = pages.open(machine.link("channels"))
    pose = row(page, "/robot1/tcp_pose")
    expect(pose.locator(".chip")).to_have_text("ok")
    expect(pose).to_contain_text("ROS → PLC")
    expect(pose.locator(".col-rate")).to_have_text(re.compile(r"^[1-9]\d*(\.\d)?$"))
    expect(row(page, "/press/door_open").locator(".chip")).to_have_text("no PLC")
    expect(page.locator(".group")).to_contain_text("Bridge cell1")
    expect(page.locator("#link-text")).to_have_text("Live")


def test_values_of_a_message_change_before_ones_eyes(pages: Pages, machine: Machine) -> None:
    """The tree stays the same elements, so focus stays; only its texts change."""
    page = pages.open(machine.link("channels", "/robot1/tcp_pose"))
    nanoseconds = value_of(page, "nanosec")
    expect(nanoseconds).to_have_text(re.compile(r"^\d+$"))
    element, before = nanoseconds.element_handle(), nanoseconds.inner_text()
    expect(nanoseconds).not_to_have_text(before)
    assert nanoseconds.evaluate("(now, then) => now === then", element)
    expect(page.locator(".station")).to_have_count(3)
    expect(page.locator(".path")).to_contain_text("read by MainTask")


@LONG
def test_a_long_array_is_a_curve_and_opens_in_parts(pages: Pages, machine: Machine) -> None:
    """96 distances: a curve in the row, the first ones below it, all of them on demand."""
    page = pages.open(machine.link("channels", "/agv/scan"))
    ranges = page.locator(".message-body details").filter(has=page.get_by_text("ranges", exact=True))
    expect(ranges.locator(".profile-line")).to_have_attribute("d", re.compile("^M.*L"))
    ranges.locator("summary").click()
    expect(ranges.locator("li")).to_have_count(16)
    ranges.get_by_role("button", name="Show 96 of 96").click()
    expect(ranges.locator("li")).to_have_count(96)


def painted(page: Any) -> int:
    """Return how many pixels of the first plot have the first curve's colour, more or less."""
    return int(
        page.evaluate(
            """() => {
              const canvas = document.querySelector("canvas");
              if (!canvas?.width) return 0;
              const {data} = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
              let count = 0;
              for (let at = 0; at < data.length; at += 4) {
                if (data[at + 3] > 200 && data[at] < 60 && data[at + 2] > 140) count += 1;
              }
              return count;
            }"""
        )
    )


def test_several_fields_are_plotted_paused_and_merged(pages: Pages, machine: Machine) -> None:
    """Curves appear and grow, a pause holds them, one plot takes them all, and each can be removed."""
    page = pages.open(machine.link("channels", "/robot1/tcp_pose"))
    for field in ("pose.position.x", "pose.position.y"):
        page.get_by_role("button", name=f"Plot {field}").click()
    page.get_by_role("link", name=re.compile("^Plots")).click()
    expect(page.locator("canvas")).to_have_count(2)
    while painted(page) < 50:
        page.wait_for_timeout(100)
    now = page.locator(".legend-now").first
    text = now.inner_text()
    expect(now).not_to_have_text(text)
    page.get_by_role("button", name="Pause").click()
    held, drawn = now.inner_text(), painted(page)
    page.wait_for_timeout(400)
    assert (now.inner_text(), painted(page)) == (held, drawn)
    page.get_by_role("button", name="Resume").click()
    expect(now).not_to_have_text(held)
    page.get_by_label("Time window").select_option("10")
    page.get_by_role("button", name="In one plot").click()
    expect(page.locator("canvas")).to_have_count(1)
    expect(page.locator("canvas")).to_have_attribute("aria-label", re.compile("position.x.*position.y", re.S))
    page.get_by_role("button", name=re.compile("Remove .* pose.position.x")).click()
    expect(page.locator(".legend")).to_have_count(1)
    page.reload()
    expect(page.locator(".legend-path")).to_have_text("pose.position.y")


def test_killed_processes_are_events_and_come_back(pages: Pages, machine: Machine) -> None:
    """A PLC and a bridge that die are seen within seconds, told in words, and found again."""
    page = pages.open(machine.link("channels"))
    expect(row(page, "/robot1/wrench").locator(".chip")).to_have_text("ok")
    end(machine.plc)
    expect(page.locator('.side [data-kind="plc-gone"]').first).to_contain_text("no PLC task")
    expect(row(page, "/robot1/wrench").locator(".chip")).to_have_text("dead")
    expect(page.locator("#event-count")).to_be_visible()
    machine.plc = start_role("plc", machine.namespace.prefix)
    expect(page.locator('.side [data-kind="plc-back"]').first).to_be_visible()
    end(machine.bridge)
    expect(page.locator('.side [data-kind="bridge-gone"]')).to_contain_text("has no heartbeat")
    expect(page.locator(".group .chip")).to_have_text("dead")
    page.get_by_role("link", name=re.compile("^Events")).click()
    expect(page.locator('[data-kind="bridge-gone"]')).to_be_visible()
    machine.bridge = start_role("bridge", machine.namespace.prefix)
    expect(page.locator('[data-kind="bridge-back"]')).to_be_visible()
    page.get_by_role("button", name="Problems only").click()
    expect(page.locator('[data-kind="bridge-back"]')).to_have_count(0)


def test_two_hundred_channels(pages: Pages, machine: Machine) -> None:
    """All are there and alive, one is found by its name, and the list can be filtered by state."""
    layout = layout_of("std_msgs/msg/Float64")
    with ExitStack() as stack:
        topics = [f"/line/sensor_{number:03}" for number in range(200)]
        channels = [
            stack.enter_context(open_typed(machine.namespace, topic, "std_msgs/msg/Float64"))
            for topic in topics
        ]
        writers = [channel.writer() for channel in channels]
        page = pages.open(machine.link("channels"))
        expect(page.locator("tr.channel").filter(has_text="/line/sensor_")).to_have_count(200)
        for writer in writers:
            writer.publish(layout.pack({"data": 1.5}))
        page.get_by_role("searchbox").fill("sensor_117")
        expect(page.locator("tr.channel")).to_have_count(1)
        link(page, "/line/sensor_117").click()
        expect(value_of(page, "data")).to_have_text("1.5")
        writers[117].publish(layout.pack({"data": 2.5}))
        expect(value_of(page, "data")).to_have_text("2.5")
        page.get_by_role("searchbox").fill("")
        page.get_by_role("button", name=re.compile("OK")).click()
        expect(link(page, "/robot1/tcp_pose")).to_be_visible()
        for channel in channels:
            channel.retire()
    expect(page.get_by_role("heading", name="This channel is gone")).to_be_visible()


def lightness(page: Any) -> float:
    """Return how light the page's background is, from 0 to 1."""
    colour = page.evaluate("getComputedStyle(document.body).backgroundColor")
    return sum(int(each) for each in re.findall(r"\d+", colour)[:3]) / 765


def test_dark_and_light_follow_the_system_or_the_switch(pages: Pages, machine: Machine) -> None:
    """The system decides until the switch is used, which is remembered."""
    page = pages.open(machine.link("channels"), color_scheme="dark")
    assert lightness(page) < 0.2
    page.emulate_media(color_scheme="light")
    assert lightness(page) > 0.8
    switch = page.get_by_role("button", name=re.compile("Colours"))
    switch.click()
    switch.click()
    expect(switch).to_have_text("Dark")
    assert lightness(page) < 0.2
    page.reload()
    expect(page.get_by_role("button", name="Colours: Dark")).to_be_visible()
    assert lightness(page) < 0.2


@LONG
def test_nothing_moves_where_less_motion_is_wanted(pages: Pages, machine: Machine) -> None:
    """No animation runs; values still change."""
    page = pages.open(machine.link("channels", "/robot1/tcp_pose"), reduced_motion="reduce")
    nanoseconds = value_of(page, "nanosec")
    expect(nanoseconds).to_have_text(re.compile(r"^\d+$"))
    expect(nanoseconds).not_to_have_text(nanoseconds.inner_text())
    assert page.evaluate("document.getAnimations().length") == 0


@pytest.mark.parametrize("size", [TABLET, pytest.param(WIDE, marks=LONG), pytest.param(PHONE, marks=LONG)])
def test_it_is_usable_by_touch(pages: Pages, machine: Machine, size: dict[str, int]) -> None:
    """On tablet and phone nothing lies beside the screen, and what is touched is 44 pixels high."""
    page = pages.open(machine.link("channels"), viewport=size, has_touch=True, is_mobile=True)
    link(page, "/robot1/tcp_pose").tap()
    expect(value_of(page, "nanosec")).to_have_text(re.compile(r"^\d+$"))
    page.get_by_role("button", name="Plot pose.position.x").tap()
    low = page.evaluate(
        """() => [...document.querySelectorAll("button, .views a, .row-link, .input, a.button")]
          .filter((each) => each.offsetParent && !each.closest("details:not([open])"))
          .map((each) => [(each.closest("tr") ?? each).getBoundingClientRect().height, each.outerHTML])
          .filter(([height]) => height < 44)"""
    )
    assert low == []
    for view in ("channels", "plots", "events"):
        page.goto(machine.link(view))
        page.wait_for_timeout(200)
        assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
    page.goto(machine.link("channels", "/robot1/tcp_pose"))
    if size["width"] < 1180:
        page.get_by_role("link", name="‹ All channels").tap()
        expect(page.locator("table.channels")).to_be_visible()


def test_the_keyboard_reaches_everything(pages: Pages, machine: Machine) -> None:
    """Skip link, channels, tree and plots, with a focus that can be seen and that moves along."""
    page = pages.open(machine.link("channels"))
    expect(link(page, "/agv/battery")).to_be_visible()
    page.keyboard.press("Tab")
    assert page.evaluate("document.activeElement.id") == "skip"
    page.keyboard.press("Enter")
    assert page.evaluate("document.activeElement.id") == "main"
    link(page, "/agv/battery").focus()
    page.keyboard.press("Enter")
    expect(page.get_by_role("heading", name="/agv/battery")).to_be_focused()
    button = page.get_by_role("button", name="Plot voltage")
    button.focus()
    page.keyboard.press("Space")
    expect(button).to_have_attribute("aria-pressed", "true")
    expect(button).to_be_focused()
    page.go_back()
    expect(link(page, "/agv/battery")).to_be_focused()


@pytest.mark.parametrize("scheme", ["light", pytest.param("dark", marks=LONG)])
def test_axe_finds_nothing(pages: Pages, machine: Machine, scheme: str) -> None:
    """Every view, with the form of a test message open, passes axe's rules in both colours."""
    from axe_playwright_python.sync_playwright import Axe

    page = pages.open(machine.link("channels"), color_scheme=scheme, reduced_motion="reduce")
    expect(link(page, "/agv/battery")).to_be_visible()
    found = {}
    for view, topic in (
        ("channels", ""),
        ("channels", "/cell/test"),
        ("channels", "/agv/scan"),
        ("plots", ""),
        ("events", ""),
    ):
        page.goto(machine.link(view, topic))
        if topic:
            expect(page.get_by_role("heading", name=topic)).to_be_visible()
            page.get_by_text("Write a test message", exact=True).click()
            expect(page.get_by_role("button", name="Write the test message", exact=False)).to_be_visible()
        if topic == "/agv/scan":
            page.get_by_role("button", name="Plot angle_min").click()
        report = Axe().run(page)
        if report.violations_count:
            found[f"{view} {topic}"] = report.generate_report()
    assert found == {}


def test_a_test_message_is_written_by_the_form(pages: Pages, machine: Machine) -> None:
    """Values are checked at their field, the question comes in between, and the channel has the message."""
    page = pages.open(f"{machine.server.url}#token={machine.server.token}")
    expect(page).to_have_url(re.compile("#/channels$"))
    page.goto(machine.link("channels", "/cell/test"))
    page.get_by_text("Write a test message", exact=True).click()
    fields = page.get_by_role("group", name="linear")
    fields.get_by_label("x").fill("fast")
    page.get_by_role("button", name="Write the test message", exact=False).click()
    expect(fields.get_by_label("x")).to_be_focused()
    expect(fields.locator(".field-error").first).to_have_text("a number is expected, such as 0.25 or 1e-3")
    fields.get_by_label("x").fill("1e400")
    expect(fields.locator(".field-error").first).to_have_text("too large for float64")
    fields.get_by_label("x").fill("0.75")
    page.get_by_role("button", name="Write the test message", exact=False).click()
    expect(page.get_by_role("dialog")).to_contain_text("Write to /cell/test, PLC → ROS?")
    expect(page.get_by_role("dialog")).to_contain_text("linear.x = 0.75")
    expect(page.get_by_role("dialog").get_by_text("not finite")).to_be_hidden()
    page.get_by_role("button", name="Do not write").click()
    expect(page.get_by_role("dialog")).to_be_hidden()
    page.get_by_role("button", name="Write the test message", exact=False).click()
    page.get_by_role("button", name="Write now").click()
    expect(page.locator(".result")).to_have_text(re.compile("^Written as message number"))
    expect(page.locator(".tree .leaf").first.locator(".field-value")).to_have_text("0.75")
    expect(page.locator('[data-kind="written"]')).to_contain_text("wrote test message")


@LONG
def test_a_refused_test_message_says_why(pages: Pages, machine: Machine) -> None:
    """A channel with a writer, and a wrong token, are refused in words."""
    page = pages.open(machine.link("channels", "/cell/state"))
    page.get_by_text("Write a test message", exact=True).click()
    for token, words in (("wrong", "WEB005"), (machine.server.token, f"process {machine.plc.pid}")):
        page.locator("#write-token").fill(token)
        page.get_by_role("button", name="Write the test message", exact=False).click()
        page.get_by_role("button", name="Write now").click()
        expect(page.locator(".result")).to_contain_text(words)
    assert [each for each in pages.complaints if "401" not in each and "409" not in each] == []
    pages.complaints.clear()


def test_the_page_comes_back_with_its_server(pages: Pages, machine: Machine) -> None:
    """While it is away the page says so; after a restart everything is live again, the open channel too."""
    page = pages.open(machine.link("channels", "/robot1/tcp_pose"))
    nanoseconds = value_of(page, "nanosec")
    expect(nanoseconds).to_have_text(re.compile(r"^\d+$"))
    end(machine.server.process)
    expect(page.locator("#link-text")).to_have_text("No connection")
    expect(page.locator("#banner")).to_contain_text("The server is not responding")
    machine.server.restart()
    expect(page.locator("#link-text")).to_have_text("Live")
    expect(page.locator("#banner")).to_be_hidden()
    expect(nanoseconds).not_to_have_text(nanoseconds.inner_text())
    assert [each for each in pages.complaints if "ERR_CONNECTION" not in each] == []
    pages.complaints.clear()


def test_names_from_memory_never_become_markup(pages: Pages, machine: Machine) -> None:
    """What somebody wrote into an object is shown as the text that it is."""
    text = '<img src="/x" onerror="alert(1)"><b>bold</b>'
    layout = layout_of("std_msgs/msg/String")
    with open_typed(machine.namespace, "/hostile", "std_msgs/msg/String", Direction.TO_PLC, text) as channel:
        channel.writer().publish(layout.pack({"data": text[:80]}))
        page = pages.open(machine.link("channels", "/hostile"))
        expect(value_of(page, "data")).to_have_text(f"“{text}”")
        expect(page.locator(".group").filter(has_text=text)).to_be_visible()
        assert page.locator("main img, main b").count() == 0
        channel.retire()


@LONG
def test_the_page_asks_for_the_token_where_looking_needs_it(browser: Any, machine: Machine) -> None:
    """It is asked for, a wrong one is refused, the right one opens the page."""
    server = Served(machine.namespace.prefix, "--token-to-view")
    made = Pages(browser, server.url)
    try:
        page = made.open(server.url)
        expect(page.get_by_role("heading", name="A token is needed")).to_be_visible()
        assert page.locator("tr.channel").count() == 0
        expect(page.get_by_text("token is needed")).to_have_count(1)
        for token in ("wrong", server.token):
            page.get_by_label("Token").fill(token)
            page.get_by_role("button", name="Open").click()
            if token == "wrong":
                expect(page.get_by_text("the token is wrong")).to_be_visible()
        expect(link(page, "/agv/battery")).to_be_visible()
    finally:
        made.close()
        end(server.process)
