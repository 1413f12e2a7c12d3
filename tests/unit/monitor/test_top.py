"""The terminal view, driven as a person drives it, on small screens."""

from __future__ import annotations

import asyncio
import time

import pytest

pytest.importorskip("textual")

from textual import events

from rosplc.monitor import Expected, Watch
from rosplc.monitor.terminal import TopApp
from rosplc.monitor.terminal.app import MessageScreen
from rosplc.shm import Direction
from tests.channels import Side, layout_of

SIZES = [(80, 24), (60, 20), (120, 40)]
_WATCHDOG = 60.0


def screen(app):
    """Return what is on the screen, line by line."""
    strips = app.screen._compositor.render_strips()
    return ["".join(segment.text for segment in line).rstrip() for line in strips]


async def until(app, pilot, condition):
    """Wait until the screen is as wanted; return its lines."""
    end = time.monotonic() + _WATCHDOG
    while not condition(screen(app)):
        assert time.monotonic() < end, "\n".join(screen(app))
        for side in app.bridge:
            side.beat()
        await pilot.pause(0.05)
    return screen(app)


def shows(*words):
    return lambda lines: all(any(word in line for line in lines) for word in words)


@pytest.fixture
def channels(shm_namespace):
    """Make channels of a bridge that beats while the test waits for something on the screen."""
    made = []

    def make(topic, type_name="geometry_msgs/msg/PoseStamped", *, bridge="cell", **limits):
        layout = layout_of(type_name, **limits)
        side = Side(shm_namespace, topic, layout, Direction.TO_PLC, bridge=bridge, beat_ms=10_000)
        made.append(side)
        return side

    make.made = made
    yield make
    for each in made:
        each.close()


@pytest.fixture
def top(shm_namespace, channels):
    """Run the view over the test's channels: ``top((80, 24), drive)``."""

    def run(size, drive):
        async def session():
            with Watch(shm_namespace.prefix, expected=Expected(stale_after_ns=0)) as watch:
                app = TopApp(watch, 0.1)
                app.bridge = channels.made
                async with app.run_test(size=size) as pilot:
                    await drive(app, pilot)

        asyncio.run(session())

    return run


@pytest.mark.parametrize("size", SIZES)
def test_every_figure_and_key_is_there_on_a_small_screen(channels, top, size):
    """State, rate, age, lost, refused and PLC of a channel, and the keys, on 80x24 and on 60x20."""
    side = channels("/turtle/pose")
    side.writer.refuse()

    async def drive(app, pilot):
        figures = ("state", "topic", "per s", "age", "lost", "refd", "PLC", "no PLC", "/turtle/pose")
        words = ("no PLC task reads it", "geometry_msgs/msg/PoseStamped", "cell alive")
        keys = ("Open", "Sort", "Filter", "Wrong", "Help", "Quit")
        lines = await until(app, pilot, shows(*figures, *words, *keys))
        row = next(line for line in lines if "! no PLC" in line).split()
        assert row[row.index("never") + 1 :][:3] == ["0", "1", "none"]
        assert all(len(line) <= size[0] for line in lines)

    top(size, drive)


def test_nothing_is_told_by_colour_alone(channels, top):
    """Without any style the mark and the word say what is wrong."""
    channels("/a")

    async def drive(app, pilot):
        await until(app, pilot, shows("! no PLC", "! 1 not OK"))

    top((80, 24), drive)


def test_sorting_and_filtering_by_keys(channels, top):
    """`s` and `r` change the order, `/` and words narrow the list, Esc shows all again, `w` what is wrong."""
    for number, topic in enumerate(("/a", "/robot10/b", "/robot2/c")):
        channels(topic).send()
        if number == 2:
            channels("/d").writer.refuse()

    async def drive(app, pilot):
        await until(app, pilot, shows("/robot10/b", "topic▼"))
        await pilot.press("r")
        lines = await until(app, pilot, shows("topic▲"))
        rows = [line for line in lines if "→ PLC" in line]
        assert [row.split("/", 1)[1].split()[0] for row in rows] == ["robot10/b", "robot2/c", "d", "a"]
        await pilot.press("slash", *"robot")
        await until(
            app, pilot, lambda lines: shows("2 of 4", "only: robot")(lines) and not shows("/d ")(lines)
        )
        await pilot.press("enter", "escape")
        await until(app, pilot, shows("4 channels", "/d "))
        await pilot.press(*"sssss")
        await until(app, pilot, shows("refd▼"))

    top((80, 24), drive)


def test_a_message_is_a_tree_with_live_values_and_a_course(channels, top):
    """Enter opens it; values change in place; a number under the cursor has its course."""
    side = channels("/turtle/pose")
    side.send(pose={"position": {"x": 1.5}})

    async def drive(app, pilot):
        await until(app, pilot, shows("/turtle/pose"))
        await pilot.press("enter")
        await until(app, pilot, shows("x 1.5", "frame_id ''", "min 1.5"))
        side.send(pose={"position": {"x": 2.5}}, header={"frame_id": "base"})
        await until(app, pilot, shows("x 2.5", "frame_id 'base'", "min 1.5  max 2.5", "message 2"))
        await pilot.press(*["down"] * 9)
        await until(app, pilot, shows("pose.position.y"))
        await pilot.press("escape")
        await until(app, pilot, shows("rosplc top"))

    top((80, 24), drive)


def test_a_long_array_is_shown_in_part(channels, top):
    """Its length is there, and its first elements when it is opened."""
    side = channels("/scan", "sensor_msgs/msg/LaserScan", sequence=500)
    side.send(ranges=[float(number) for number in range(500)])

    async def drive(app, pilot):
        await until(app, pilot, shows("/scan"))
        await pilot.press("enter")
        await until(app, pilot, shows("ranges (500) 0, 1, 2"))
        tree = app.screen.query_one("ValueTree")
        node = next(node for node in tree.root.children if node.data == "ranges")
        node.expand()
        end = time.monotonic() + _WATCHDOG
        while len(node.children) != 64:
            assert time.monotonic() < end
            await pilot.pause(0.05)

    top((80, 24), drive)


def test_channels_that_vanish_or_become_another_type_are_survived(channels, top, shm_namespace):
    """While its message is shown: the last values stay, and the new type is shown when it is there."""
    side = channels("/n", "std_msgs/msg/Float64")
    side.send(data=4.5)

    async def drive(app, pilot):
        await until(app, pilot, shows("/n"))
        await pilot.press("enter")
        await until(app, pilot, shows("data 4.5"))
        side.channel.retire()
        side.close()
        channels.made.remove(side)
        await until(app, pilot, shows("gone", "data 4.5"))
        channels("/n", "std_msgs/msg/String").send(data="new")
        await until(app, pilot, shows("std_msgs/msg/String", "data 'new'"))
        await pilot.press("escape")
        await until(app, pilot, shows("rosplc top", "appeared"))

    top((80, 24), drive)


def test_hostile_objects_neither_end_the_view_nor_reach_the_terminal(channels, top, shm_namespace):
    """Escape sequences and markup in names are written out; a scribbled header is a line in the table."""
    side = channels("/n", "std_msgs/msg/String", bridge="\x1b[31m[red]")
    side.send(data="\x1b[2J[red]markup[/red]\n\u202e")
    shm_namespace.path("/broken").write_bytes(b"\xff" * 4096)

    async def drive(app, pilot):
        lines = await until(app, pilot, shows("X unreadable", "/broken"))
        assert "\x1b" not in "".join(lines)
        await pilot.press("down", "enter")
        lines = await until(app, pilot, lambda _: isinstance(app.screen, MessageScreen))
        lines = await until(app, pilot, shows("\\x1b[2J[red]markup[/red]"))
        assert "\x1b" not in "".join(lines)
        assert "\u202e" not in "".join(lines)

    top((80, 24), drive)


def test_two_hundred_channels_scroll(channels, top):
    """The cursor moves through all of them, and the one under it is told below."""
    for number in range(200):
        channels(f"/line{number}/state", "std_msgs/msg/Bool")

    async def drive(app, pilot):
        await until(app, pilot, shows("200 channels", "/line0/state"))
        await pilot.press("end")
        lines = await until(app, pilot, shows("/line199/state  std_msgs/msg/Bool"))
        assert sum("/state" in line for line in lines) > 8
        await pilot.press("pageup", "home")
        await until(app, pilot, shows("/line0/state  std_msgs/msg/Bool"))

    top((60, 20), drive)


def test_an_empty_machine_says_what_to_start(top):
    """No channels is no error; the message goes when the first one comes."""

    async def drive(app, pilot):
        await until(app, pilot, shows("There are no channels", "rosplc demo"))
        await pilot.press("enter", "w", "question_mark")
        await until(app, pilot, shows("KEYS"))
        await pilot.press("escape", "p")
        await until(app, pilot, shows("PAUSED"))

    top((80, 24), drive)


def test_a_tiny_terminal_does_not_end_it(channels, top):
    """Even 20 columns and 6 rows, and a change of size while it runs."""
    channels("/n").send()

    async def drive(app, pilot):
        await pilot.pause(0.3)
        await pilot.press("enter")
        await pilot.pause(0.3)
        await pilot.resize_terminal(100, 30)
        await until(app, pilot, shows("pose"))
        await pilot.resize_terminal(10, 3)
        await pilot.press("escape")
        await pilot.pause(0.3)

    top((20, 6), drive)


def test_what_is_typed_in_one_piece_arrives(channels, top):
    """A slash and words that come at once, as over a slow line, filter; a slash among them is a letter."""
    channels("/robot1/pose")
    channels("/robot2/pose")

    async def drive(app, pilot):
        await until(app, pilot, shows("/robot1/pose"))
        for key in "/t2/pose":
            event = events.Key("slash" if key == "/" else key, key)
            app.post_message(event)
        await until(app, pilot, shows("1 of 2", "only: t2/pose"))

    top((80, 24), drive)
