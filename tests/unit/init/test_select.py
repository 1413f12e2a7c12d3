"""Which topics are taken, and which way."""

from __future__ import annotations

import pytest

from rosplc.init.found import Topic
from rosplc.init.propose import direction, parse_wish, select

TWIST, STRING = "geometry_msgs/msg/Twist", "std_msgs/msg/String"
TOPICS = {
    topic.name: topic
    for topic in (
        Topic("/cmd_vel", (TWIST,), (), ("/base",)),
        Topic("/mode", (STRING,), ("/base",), ("/panel",)),
        Topic("/odd", (STRING, TWIST), ("/a", "/b")),
        Topic("/robot1/pose", (TWIST,), ("/r1",)),
        Topic("/robot1/_action/feedback", (TWIST,), ("/r1",)),
        Topic("/rosout", ("rcl_interfaces/msg/Log",), ("/base",)),
        Topic("/untold", (), (), ("/base",)),
        Topic("/bad-name", (STRING,), ("/base",)),
        Topic("/bad_type", ("a type\nwith: yaml",), ("/base",)),
    )
}


def chosen(*wishes: str, everything: bool = False, to=None):
    found, left_out = select(TOPICS, [parse_wish(text, to) for text in wishes], everything=everything)
    return {name: (each.type_name, each.to) for name, each in found.items()}, left_out


def test_everything_leaves_out_what_is_of_ros_itself_or_cannot_be_carried() -> None:
    """Topics of ROS's household are not meant; what is meant and impossible is named with its reason."""
    found, left_out = chosen(everything=True)
    assert found == {"/cmd_vel": (TWIST, "ros"), "/mode": (STRING, "plc"), "/robot1/pose": (TWIST, "plc")}
    assert set(left_out) == {"/odd", "/untold", "/bad-name", "/bad_type"}
    assert "several types" in left_out["/odd"]
    assert "its type is unknown" in left_out["/untold"]


def test_a_pattern_takes_what_matches_and_a_name_what_it_names() -> None:
    """Patterns pass over ROS's own topics; a name does not."""
    assert chosen("/robot1/*")[0] == {"/robot1/pose": (TWIST, "plc")}
    assert chosen("rosout")[0] == {"/rosout": ("rcl_interfaces/msg/Log", "plc")}


def test_type_and_direction_can_be_said() -> None:
    """TOPIC=TYPE decides between several types, and names a topic that nobody has yet."""
    assert chosen(f"/odd={STRING}")[0] == {"/odd": (STRING, "plc")}
    assert chosen("/plc/state=std_msgs/String", to="ros")[0] == {"/plc/state": (STRING, "ros")}
    assert chosen("/mode", to="ros")[0] == {"/mode": (STRING, "ros")}


def test_a_later_wish_refines_an_earlier_one() -> None:
    """--all together with --to-ros turns one topic round and keeps the others."""
    found, _ = select(TOPICS, [parse_wish("/mode", "ros")], everything=True)
    assert (found["/mode"].to, found["/robot1/pose"].to) == ("ros", "plc")


@pytest.mark.parametrize(
    ("wish", "words"),
    [
        ("/cmd_vell", "did you mean /cmd_vel"),
        ("/zzz", "specify /zzz=PACKAGE/TYPE to carry it"),
        ("/nothing/*", "no topic matches"),
        ("/odd", "several types"),
        ("/bad-name", "may contain only letters"),
    ],
)
def test_a_wish_that_cannot_be_met_is_an_error(wish: str, words: str) -> None:
    """Who names a topic is told why it cannot be carried."""
    with pytest.raises(ValueError, match=words):
        chosen(wish)


@pytest.mark.parametrize("text", ["", "=std_msgs/String", "/a=b", "/a=std_msgs/"])
def test_a_wish_that_is_none_is_an_error(text: str) -> None:
    """The form is TOPIC or TOPIC=TYPE."""
    with pytest.raises(ValueError):
        parse_wish(text)


def test_direction_comes_from_who_is_there() -> None:
    """Published goes to the PLC, also if somebody subscribes; what is only subscribed to comes from it."""
    assert direction(TOPICS["/cmd_vel"]) == ("ros", "it has subscribers (/base) but no publisher")
    words = "it is published by /base for /panel; the PLC subscribes, too"
    assert direction(TOPICS["/mode"]) == ("plc", words)
