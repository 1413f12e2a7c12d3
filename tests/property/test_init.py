"""Whatever is found on a robot, what ``rosplc init`` writes of it is a valid configuration."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rosplc.config import load_project
from rosplc.errors import RosplcError
from rosplc.init.found import Found, Length, Seen, Topic
from rosplc.init.learn import Definitions
from rosplc.init.propose import Wish, select
from rosplc.init.write import draft, save
from rosplc.layout.nodes import limit_paths
from rosplc.model import DISTROS
from rosplc.project import check
from rosplc.ros import LATCHED, SENSOR_DATA, Qos
from tests.codec_types import BOUNDED, HARD_TYPES

pytestmark = pytest.mark.verifies("init", own="random graphs")

FIELDS = "string string\nint8[] sequence\nstring[] true\nstring<=4[<=2] none\nfloat32[] n\n"
CUSTOM = {**HARD_TYPES, "odd_msgs/msg/Names": FIELDS, "hard_msgs/msg/Bounded": BOUNDED}
WILD = st.text(st.characters(codec="utf-8"), max_size=30)
NAMES = st.one_of(st.from_regex(r"(/[A-Za-z_][A-Za-z0-9_]{0,12}){1,4}", fullmatch=True), WILD)
NODES = st.lists(st.one_of(WILD, st.just("/robot"), st.just("?")), max_size=4).map(tuple)
LENGTHS = st.one_of(st.integers(0, 40), st.integers(0, 1 << 32))


class Made:
    """A source whose robot was made up; lengths are drawn for the paths that its types have."""

    def __init__(self, distro: str, topics: Mapping[str, Topic], data: st.DataObject) -> None:
        self.definitions = Definitions(distro, environment={})
        self.found = Found(
            topics, data.draw(WILD), {"backend": "memory", "distro": distro}, {"distro": data.draw(WILD)}
        )
        self._data = data

    def learn(self, topic: str, type_name: str) -> None:
        if type_name in CUSTOM and type_name not in self.definitions.store:
            needed = "".join(
                f"{'=' * 80}\nMSG: {name.replace('/msg/', '/')}\n{text}"
                for name, text in HARD_TYPES.items()
                if name != type_name
            )
            self.definitions.learn(type_name, CUSTOM[type_name] + needed, "a test")
        _ = self.definitions.store[type_name]

    def listen(
        self, wanted: Mapping[str, str], seconds: float, progress: Callable[[str], None]
    ) -> dict[str, Seen]:
        draw = self._data.draw
        result = {}
        for topic, type_name in wanted.items():
            paths = limit_paths(self.definitions.store, type_name)
            pairs = {path: sorted((draw(LENGTHS), draw(LENGTHS))) for path in paths if draw(st.booleans())}
            result[topic] = Seen(
                messages=draw(st.integers(0, 200)),
                unreadable=draw(st.integers(0, 3)),
                seconds=seconds,
                rate_hz=draw(st.floats(0, 1e12)),
                longest_gap_s=draw(st.floats(0, 1e9)),
                lengths={path: Length(*pair) for path, pair in pairs.items()},
                trouble=draw(WILD),
            )
        return result

    def close(self) -> None:
        """Nothing is open."""


@st.composite
def robots(draw: st.DrawFn) -> tuple[str, dict[str, Topic]]:
    """Draw a distribution and topics: good ones, and ones with every kind of nonsense."""
    distro = draw(st.sampled_from(DISTROS))
    known = [
        *Definitions(distro).store.names(),
        *(name for name in CUSTOM if distro != "noetic" or "Bounded" not in name),
    ]
    types = st.lists(st.one_of(st.sampled_from(known), WILD), max_size=2, unique=True).map(tuple)
    qos = st.lists(st.sampled_from([Qos(), SENSOR_DATA, LATCHED]), max_size=2).map(tuple)
    topics = draw(st.lists(st.builds(Topic, NAMES, types, NODES, NODES, qos), max_size=6))
    return distro, {topic.name: topic for topic in topics}


@settings(deadline=None, max_examples=50)
@given(robot=robots(), to=st.sampled_from(["plc", "ros", None]), data=st.data())
def test_whatever_is_found_the_file_loads_and_checks_clean(robot, to, data) -> None:
    """Hostile names, strange types and absurd lengths never break the file, nor bring a line of their own."""
    distro, topics = robot
    source = Made(distro, topics, data)
    wishes = [Wish(name, None, to, firm=False) for name in topics if not set(name) & set("*?[")]
    chosen, _ = select(topics, wishes, everything=True)
    made = draft(source, chosen, seconds=5.0)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "rosplc.yaml"
        save(source, made, path, bridge="cell1")
        project = load_project(path)
        assert [plan.topic for plan in project.topics] == [entry.topic for entry in made.entries]
        for plan, entry in zip(project.topics, made.entries, strict=True):
            assert (plan.layout.size, plan.type_name) == (entry.record_bytes, entry.type_name)
            assert dict(plan.layout.limits.fields) == {path: most for path, (most, _) in entry.limits.items()}
            assert set(entry.settings) or not plan.latched or entry.to == "ros"
        wrong = [text for text in check(project)["warnings"] if "a record is" not in text]
        assert [
            text for text in wrong if "all topics together" not in text and "has no topics" not in text
        ] == []
        # The comments hold no line of their own: what is no comment is what was meant.
        keys = [line for line in path.read_text().split("\n") if line.startswith("  /")]
        assert keys == [f"  {entry.topic}:" for entry in made.entries]


@settings(deadline=None, max_examples=50)
@given(text=WILD)
def test_any_bridge_name_is_refused_or_right(text: str) -> None:
    """A name that is none is an error, and leaves no file."""
    source = Found({}, "nowhere", {"backend": "memory", "distro": "jazzy"})
    made = type("Nothing", (), {"found": source, "definitions": Definitions("jazzy", environment={})})()
    nothing = draft(made, {}, seconds=0.0)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "rosplc.yaml"
        try:
            save(made, nothing, path, bridge=text)
        except RosplcError:
            assert list(Path(folder).iterdir()) == []
        else:
            assert load_project(path).config.settings.bridge == text
