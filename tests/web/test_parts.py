"""The page's server in parts: paths, wants, forms, tokens."""

from __future__ import annotations

import json
import math

import pytest

from rosplc.errors import WebError
from rosplc.monitor import Picture
from rosplc.web import new_token, read_token
from rosplc.web.access import same_token
from rosplc.web.live import MAX_MESSAGES, MAX_PLOTS, Looker, Wants, number_at, parse_path
from rosplc.web.write import SAFE_INTEGER, form_of, from_form, shown
from tests.lib.clock import SteppedClock
from tests.web.peers import layout_of


@pytest.mark.parametrize(
    ("text", "steps"),
    [
        ("x", ("x",)),
        ("a.b_2.c", ("a", "b_2", "c")),
        ("a[3].b[0]", ("a", 3, "b", 0)),
        ("a[1][2]", ("a", 1, 2)),
    ],
)
def test_a_path_has_names_and_indices(text: str, steps: tuple[str | int, ...]) -> None:
    """Dots lead to members, brackets to elements."""
    assert parse_path(text) == steps


@pytest.mark.parametrize(
    "text", ["", ".", "a.", "a..b", "a[", "a[x]", "a[-1]", "a b", "a[999999999]", "a" * 301]
)
def test_what_is_no_path_is_refused(text: str) -> None:
    """Anything else is an error, and quickly."""
    with pytest.raises(ValueError, match="not a field path"):
        parse_path(text)


def test_only_finite_numbers_are_plotted() -> None:
    """A bool counts as 0 or 1; text, NaN, structs and what is not there are no point of a plot."""
    message = {"a": {"b": [1, 2.5]}, "t": True, "s": "1", "n": math.nan, "i": math.inf}
    assert number_at(message, "a.b[1]") == 2.5
    assert number_at(message, "t") == 1 and not isinstance(number_at(message, "t"), bool)
    assert [number_at(message, path) for path in ("a", "a.b[2]", "s", "n", "i", "x", "s[0].y")] == [None] * 7


@pytest.mark.parametrize(
    "data",
    [
        [],
        {"messages": "x"},
        {"messages": [1]},
        {"messages": ["x"] * (MAX_MESSAGES + 1)},
        {"plots": []},
        {"plots": {"x": "y"}},
        {"plots": {"x": ["y z"]}},
        {"plots": {"x": [f"y[{number}]" for number in range(MAX_PLOTS + 1)]}},
        {"messages": ["x" * 301]},
    ],
)
def test_a_page_may_not_want_everything(data: object) -> None:
    """What has another form, or is more than a page may want, is refused as WEB009."""
    with pytest.raises(WebError, match="WEB009"):
        Wants.of(data)


def test_a_page_that_wants_nothing_is_well() -> None:
    """No messages and no plots are an ordinary wish."""
    assert Wants.of({}) == Wants() == Wants.of({"messages": [], "plots": {"x": []}})


def test_values_are_made_fit_for_a_page() -> None:
    """Numbers that JavaScript cannot hold become text, long lists are cut and say so."""
    value = {"n": math.nan, "b": 2**63, "s": SAFE_INTEGER, "l": list(range(5)), "t": True, "x": "\udc80"}
    fit = shown(value, elements=3)
    assert fit == {
        "n": "nan",
        "b": str(2**63),
        "s": SAFE_INTEGER,
        "l": {"first": [0, 1, 2], "count": 5},
        "t": True,
        "x": "\udc80",
    }
    assert json.loads(json.dumps(fit, allow_nan=False)) == fit


def test_a_form_says_every_limit() -> None:
    """Ranges of integers, bytes of strings, capacities of lists."""
    form = form_of(layout_of("sensor_msgs/msg/JointState"))
    members = {member["name"]: member for member in form["members"]}
    assert members["name"]["kind"] == "list" and members["name"]["capacity"] == 16
    assert members["name"]["element"] == {"kind": "string", "type": "string", "capacity": 80}
    seconds = members["header"]["members"][0]["members"][0]
    assert (seconds["name"], seconds["kind"], seconds["low"], seconds["high"]) == (
        "sec",
        "integer",
        str(-(2**31)),
        str(2**31 - 1),
    )


def test_a_form_has_the_types_constants() -> None:
    """They are what a technician would otherwise have to look up."""
    form = form_of(layout_of("sensor_msgs/msg/BatteryState"))
    names = {constant["name"]: constant["value"] for constant in form["constants"]}
    assert names["POWER_SUPPLY_STATUS_CHARGING"] == 1


def test_text_of_a_form_becomes_the_number_that_it_is() -> None:
    """Whole numbers beyond JavaScript's come back exactly, others as the page wrote them."""
    layout = layout_of("std_msgs/msg/UInt64")
    record = layout.pack(from_form(form_of(layout), {"data": str(2**64 - 1)}))
    assert layout.to_dict(record) == {"data": 2**64 - 1}
    floats = form_of(layout_of("std_msgs/msg/Float64"))
    assert math.isnan(from_form(floats, {"data": "nan"})["data"])
    assert from_form(floats, {"data": "zero", "other": 1}) == {"data": "zero", "other": 1}


def test_a_token_is_long_and_new_each_time() -> None:
    """144 random bits: nobody guesses it."""
    assert len(new_token()) == 24 and new_token() != new_token()


def test_tokens_are_compared_whole() -> None:
    """An empty one is never right, also where none is set."""
    assert same_token("abc", "abc")
    assert not any(
        same_token(*pair) for pair in (("abc", "ab"), ("abc", "abcd"), ("abc", ""), ("", ""), ("abc", "äbc"))
    )


def test_a_token_file_gives_its_token(tmp_path) -> None:
    """Blanks and the line's end around it do not count."""
    file = tmp_path / "token"
    file.write_text("  0123456789abcdef\n")
    file.chmod(0o600)
    assert read_token(file) == "0123456789abcdef"


@pytest.mark.parametrize(
    ("content", "mode", "what"),
    [
        ("0123456789abcdef", 0o640, "other than the owner"),
        ("0123456789abcdef", 0o604, "other than the owner"),
        ("short", 0o600, "has no token"),
        ("0123456789 abcdef", 0o600, "has no token"),
        ("0123456789abcdef\nsecond", 0o600, "has no token"),
        ("ä" * 20, 0o600, "has no token"),
        ("x" * 1000, 0o600, "has no token"),
    ],
)
def test_a_token_file_that_is_not_safe_is_refused(tmp_path, content: str, mode: int, what: str) -> None:
    """One that others may read, or that holds what can be guessed or mistyped."""
    file = tmp_path / "token"
    file.write_text(content)
    file.chmod(mode)
    with pytest.raises(WebError, match=what):
        read_token(file)


def test_a_missing_token_file_is_an_error(tmp_path) -> None:
    """It is named, with the system's reason."""
    with pytest.raises(WebError, match=r"WEB002.*") as caught:
        read_token(tmp_path / "none")
    assert "No such file" in str(caught.value)


class Counting:
    """A watch whose clock a test steps, and that counts its looks."""

    def __init__(self) -> None:
        self.clock, self.looks = SteppedClock(), 0

    def look(self) -> Picture:
        self.looks += 1
        self.clock.advance(0.1)  # what a look costs
        return Picture(self.clock.time_ns(), ())


def test_channels_are_looked_at_seldom_while_no_page_is_open() -> None:
    """A picture is due after a second, or after half a second while a page watches."""
    watch = Counting()
    looker = Looker(watch)  # type: ignore[arg-type]
    assert looker.look([]).picture is not None
    assert looker.look([]).picture is None
    watch.clock.advance(0.69)
    assert looker.look([]).picture is None
    watch.clock.advance(0.02)
    assert looker.look([Wants()]).picture is not None
    watch.clock.advance(0.39)
    assert looker.look([Wants()]).picture is None
    watch.clock.advance(0.02)
    assert looker.look([Wants()]).picture is not None and watch.looks == 3
