"""A configuration becomes settings, or a list of errors with file, line and key."""

from __future__ import annotations

import pickle
import re
from pathlib import Path
from typing import Any

import jsonschema
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from rosplc.config import yaml_source
from rosplc.config.file import Config, json_schema, parse_config, read_config
from rosplc.config.yaml_source import LARGEST_FILE, ConfigErrors
from rosplc.errors import ConfigError

pytestmark = pytest.mark.verifies("configuration", own="rosplc alone")

ROOT = Path(__file__).parents[3]
GOOD = """\
bridge: cell1
prefix: cell-1
ros:
  backend: auto
  distro: humble
  domain: 7
  node_name: bridge
  namespace: /robot1
  remap: {/cmd_vel: /base/cmd_vel, "~/state": state}
  zenoh: {mode: client, connect: ["tcp/10.0.0.1:7447"], listen: ["tcp/0.0.0.0:0"], config: z.json5}
  rclpy: {ros_args: [--enclave, /cell], parameters: {site: north, lines: [a, b]}}
types: {paths: [./msg, /opt/msg]}
limits: {string: 40, sequence: 8}
shm: {mode: 0640, owner: root, group: 1000, directory: /dev/shm}
tick: 500us
beat: 50ms
diagnostics: {enabled: no, period: 2s}
tasks:
  Fast: {kind: cyclic, interval: 1ms, priority: 1, watchdog: 2ms, watchdog_sensitivity: 3}
  Slow: {interval: 0.1s}
topics:
  /cmd_vel: {type: geometry_msgs/msg/Twist, to: plc, stale_after: 200ms, task: Slow}
  /joints:
    type: sensor_msgs/JointState
    to: ros
    limits: {name: 6, "name[]": 20, string: 16}
    qos: {preset: sensor_data, reliability: reliable, depth: 3, deadline: 20Hz, lease: 1s}
    every: false
    slots: 9
    expected_rate: 100Hz
    rate_limit: 20ms
    on_change: true
    on_overflow: truncate
    stale_after: never
    on_stale: stop
    print: true
  /scan: {type: sensor_msgs/msg/LaserScan, to: plc, qos: sensor_data, rate_limit: 10Hz, latched: false}
  /old: {type: std_msgs/msg/Bool, to: ros, classic: {name: io, semaphore: lock, wait: 2ms, recover_after: 3s}}
  /older: {type: std_msgs/msg/Bool, to: ros, classic: true}
  /new: {type: std_msgs/msg/Bool, to: ros, classic: false}
"""
TOPIC = "topics: {/a: {type: std_msgs/msg/Bool, to: plc, "


def errors_of(text: str) -> list[tuple[str, str]]:
    """Return code and place of everything wrong with a text."""
    with pytest.raises(ConfigErrors) as caught:
        parse_config(text, name="c.yaml")
    return [(error.code, error.where) for error in caught.value.errors]


def test_every_key_is_read() -> None:
    """Each key arrives under its name, durations and rates as nanoseconds."""
    settings = parse_config(GOOD).settings
    assert (settings.bridge, settings.prefix) == ("cell1", "cell-1")
    assert settings.ros.model_dump() == {
        "backend": "auto", "distro": "humble", "domain": 7, "node_name": "bridge", "namespace": "/robot1",
        "remap": {"/cmd_vel": "/base/cmd_vel", "~/state": "state"},
        "zenoh": {
            "mode": "client", "connect": ("tcp/10.0.0.1:7447",), "listen": ("tcp/0.0.0.0:0",),
            "config": "z.json5",
        },
        "rclpy": {"ros_args": ("--enclave", "/cell"), "parameters": {"site": "north", "lines": ["a", "b"]}},
    }  # fmt: skip
    assert settings.types.paths == ("./msg", "/opt/msg")
    assert (settings.limits.string, settings.limits.sequence) == (40, 8)
    assert (settings.shm.mode, settings.shm.owner, settings.shm.group) == (0o640, "root", 1000)
    assert (settings.tick_ns, settings.beat_ns) == (500_000, 50_000_000)
    assert (settings.diagnostics.enabled, settings.diagnostics.period_ns) == (False, 2_000_000_000)
    fast, slow = settings.tasks["Fast"], settings.tasks["Slow"]
    assert (fast.interval_ns, fast.priority) == (10**6, 1)
    assert (fast.watchdog_ns, fast.watchdog_sensitivity) == (2 * 10**6, 3)
    assert (slow.kind, slow.interval_ns, slow.watchdog_ns) == ("cyclic", 10**8, None)
    joints = settings.topics["/joints"]
    assert joints.model_dump(exclude={"qos"}) == {
        "type": "sensor_msgs/JointState", "to": "ros", "task": None, "latched": None, "every": False,
        "limits": {"name": 6, "name[]": 20, "string": 16}, "slots": 9, "expected_rate_ns": 10**7,
        "rate_limit_ns": 2 * 10**7, "on_change": True, "on_overflow": "truncate", "stale_after_ns": 0,
        "on_stale": "stop", "print": True, "classic": None,
    }  # fmt: skip
    assert joints.qos.model_dump() == {
        "preset": "sensor_data", "reliability": "reliable", "durability": None, "depth": 3,
        "deadline_ns": 5 * 10**7, "lease_ns": 10**9,
    }  # fmt: skip
    assert settings.topics["/cmd_vel"].stale_after_ns == 200_000_000
    assert settings.topics["/scan"].qos.preset == "sensor_data"
    assert settings.topics["/scan"].rate_limit_ns == 100_000_000
    old = settings.topics["/old"].classic
    assert old is not None
    assert old.model_dump() == {
        "name": "io", "semaphore": "lock", "wait_ns": 2 * 10**6, "recover_after_ns": 3 * 10**9,
    }  # fmt: skip
    older = settings.topics["/older"].classic
    assert older is not None and older.name is None and older.wait_ns == 5 * 10**6
    assert settings.topics["/new"].classic is None


def test_defaults() -> None:
    """An empty file, and sections without content, stand for the defaults."""
    settings = parse_config("").settings
    assert settings == parse_config("ros:\ntopics:\ntasks:\n").settings
    assert (settings.bridge, settings.prefix, settings.topics) == ("rosplc", "rosplc", {})
    assert (settings.tick_ns, settings.beat_ns) == (1_000_000, 100_000_000)
    assert (settings.limits.string, settings.limits.sequence) == (80, 16)
    assert list(settings.tasks) == ["RosTask"]
    assert settings.tasks["RosTask"].interval_ns == 10_000_000
    assert settings.shm.mode == 0o660


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("bridge: [a", [("CFG002", "c.yaml:1")]),
        ("a: b: c\n", [("CFG002", "c.yaml:1")]),
        ("\x00", [("CFG002", "c.yaml")]),
        ("bridge: a\n---\nbridge: b\n", [("CFG002", "c.yaml:2")]),
        ("[" * 100, [("CFG002", "c.yaml:1")]),
        ("{a: b}: c\n", [("CFG002", "c.yaml:1")]),
        ("- a\n", [("CFG004", "c.yaml")]),
        ("text\n", [("CFG004", "c.yaml")]),
        ("bridge: a\nbrige: b\n", [("CFG003", "c.yaml:2: brige")]),
        ("bridge: a\n\nbridge: b\n", [("CFG010", "c.yaml:3: bridge")]),
        ("bridge: &x a\nprefix: *x\n", [("CFG009", "c.yaml:2")]),
        ("bridge: !!python/name:os.getcwd ''\n", [("CFG009", "c.yaml:1"), ("CFG004", "c.yaml:1: bridge")]),
        ("*x : a\n", [("CFG009", "c.yaml:1"), ("CFG003", "c.yaml:1: *x")]),
        ("bridge: !env HOME\n", [("CFG009", "c.yaml:1")]),
        ("bridge: 5\n", [("CFG004", "c.yaml:1: bridge")]),
        ("bridge: a/b\n", [("CFG004", "c.yaml:1: bridge")]),
        ("prefix: ../x\n", [("CFG004", "c.yaml:1: prefix")]),
        ("ros: {backend: ddss}\n", [("CFG004", "c.yaml:1: ros.backend")]),
        ("ros: {distro: foxy}\n", [("CFG004", "c.yaml:1: ros.distro")]),
        ("ros:\n  domain: 233\n", [("CFG004", "c.yaml:2: ros.domain")]),
        ("ros:\n  domain: true\n", [("CFG004", "c.yaml:2: ros.domain")]),
        ("ros: {namespace: robot1}\n", [("CFG004", "c.yaml:1: ros.namespace")]),
        ("types: {paths: msg}\n", [("CFG004", "c.yaml:1: types.paths")]),
        ("types:\n  paths:\n  - a\n  - 5\n", [("CFG004", "c.yaml:4: types.paths[1]")]),
        ("limits: {string: 0}\n", [("CFG004", "c.yaml:1: limits.string")]),
        ("limits: {sequence: 1.5}\n", [("CFG004", "c.yaml:1: limits.sequence")]),
        ("shm: {mode: 660}\n", [("CFG004", "c.yaml:1: shm.mode")]),
        ("shm: {mode: '0444'}\n", [("CFG004", "c.yaml:1: shm.mode")]),
        ("shm: {mode: '0777'}\n", [("CFG004", "c.yaml:1: shm.mode")]),
        ("shm: {directory: tmp}\n", [("CFG004", "c.yaml:1: shm.directory")]),
        ("tick: 1\n", [("CFG004", "c.yaml:1: tick")]),
        ("tick: 1ns\n", [("CFG004", "c.yaml:1: tick")]),
        ("tick: 5 parsecs\n", [("CFG004", "c.yaml:1: tick")]),
        ("beat: 99h\n", [("CFG004", "c.yaml:1: beat")]),
        ("diagnostics: {period: 0s}\n", [("CFG004", "c.yaml:1: diagnostics.period")]),
        ("tasks: {}\n", [("CFG004", "c.yaml:1: tasks")]),
        ("tasks: {1a: {}}\n", [("CFG004", "c.yaml:1: tasks.1a")]),
        ("tasks: {A: {priority: 32}}\n", [("CFG004", "c.yaml:1: tasks.A.priority")]),
        ("tasks: {A: {intervall: 1ms}}\n", [("CFG003", "c.yaml:1: tasks.A.intervall")]),
        ("topics: [/a]\n", [("CFG004", "c.yaml:1: topics")]),
        ("topics:\n  /a:\n", [("CFG004", "c.yaml:2: topics./a")]),
        ("topics:\n  /a: {to: plc}\n", [("CFG005", "c.yaml:2: topics./a.type")]),
        ("topics:\n  /a: {type: a/b}\n", [("CFG005", "c.yaml:2: topics./a.to")]),
        ("topics:\n  a b: {type: a/b, to: plc}\n", [("CFG004", "c.yaml:2: topics.a b")]),
        ("topics:\n  /a/: {type: a/b, to: plc}\n", [("CFG004", "c.yaml:2: topics./a/")]),
        (TOPIC + "},\n /a: {type: a/b, to: ros}}\n", [("CFG006", "c.yaml:2: topics./a")]),
        ("topics: {/a: {type: Bool, to: plc}}\n", [("CFG004", "c.yaml:1: topics./a.type")]),
        ("topics: {/a: {type: a/b, to: pcl}}\n", [("CFG004", "c.yaml:1: topics./a.to")]),
        (TOPIC + "limits: {data: x}}}\n", [("CFG004", "c.yaml:1: topics./a.limits.data")]),
        (TOPIC + "qos: best}}\n", [("CFG004", "c.yaml:1: topics./a.qos")]),
        (TOPIC + "qos: {depth: 0}}}\n", [("CFG004", "c.yaml:1: topics./a.qos.depth")]),
        (TOPIC + "qos: {history: keep_all}}}\n", [("CFG003", "c.yaml:1: topics./a.qos.history")]),
        (TOPIC + "slots: 2}}\n", [("CFG004", "c.yaml:1: topics./a.slots")]),
        (TOPIC + "expected_rate: 20ms}}\n", []),
        (TOPIC + "rate_limit: 10 Hertz}}\n", [("CFG004", "c.yaml:1: topics./a.rate_limit")]),
        (TOPIC + "rate_limit: 0Hz}}\n", [("CFG004", "c.yaml:1: topics./a.rate_limit")]),
        (TOPIC + "on_overflow: cut}}\n", [("CFG004", "c.yaml:1: topics./a.on_overflow")]),
        (TOPIC + "stale_after: soon}}\n", [("CFG004", "c.yaml:1: topics./a.stale_after")]),
        (TOPIC + "latched: maybe}}\n", [("CFG004", "c.yaml:1: topics./a.latched")]),
    ],
)  # fmt: skip
def test_errors(text: str, expected: list[tuple[str, str]]) -> None:
    """Each kind of mistake is reported with its code, line and key."""
    if not expected:
        assert parse_config(text, name="c.yaml")
        return
    assert errors_of(text) == expected


@pytest.mark.parametrize(
    ("text", "hint"),
    [
        ("topcis: {}\n", "did you mean 'topics'?"),
        ("tasks: {A: {intervall: 1ms}}\n", "did you mean 'interval'?"),
        (TOPIC + "qos: {relibility: reliable}}}", "did you mean 'reliability'?"),
        (TOPIC + "stale_afte: 1s}}", "did you mean 'stale_after'?"),
        ("topics: {/a: {type: a/b, to: rso}}", "did you mean 'ros'?"),
        ("topics: {cmd vel: {type: a/b, to: ros}}", "such as '/cmd_vel'"),
        ("tick: 10", "such as 10ms"),
        ("shm: {mode: 660}", '"0660"'),
        ("topics: {/a: {type: a/b}}", "to: plc"),
        ("ros: {distro: foxy}", "humble, jazzy, kilted"),
    ],
)
def test_errors_say_what_would_be_right(text: str, hint: str) -> None:
    """The text of an error holds the correction."""
    with pytest.raises(ConfigErrors) as caught:
        parse_config(text)
    assert hint in str(caught.value)


def test_all_errors_come_together_in_the_order_of_their_lines() -> None:
    """One run shows everything, each on a line of its own, and survives pickling."""
    text = "tick: 1\nbridge: 5\ntopics:\n  /a: {type: a/b, to: plc}\n  /a: {type: x, to: plc}\nbeat: 1\n"
    assert errors_of(text) == [
        ("CFG004", "c.yaml:1: tick"),
        ("CFG004", "c.yaml:2: bridge"),
        ("CFG006", "c.yaml:5: topics./a"),
        ("CFG004", "c.yaml:6: beat"),
    ]
    with pytest.raises(ConfigError) as caught:
        parse_config(text)
    assert len(str(caught.value).splitlines()) == 4
    assert caught.value.code == "CFG004"
    again = pickle.loads(pickle.dumps(caught.value))
    assert str(again) == str(caught.value)


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    """Missing, oversized and non-text files are errors of the configuration, never a traceback."""
    for name, content, code in [
        ("missing.yaml", None, "CFG001"),
        ("large.yaml", b"# " + b"x" * LARGEST_FILE, "CFG001"),
        ("binary.yaml", b"bridge: a\nprefix: \xff\n", "CFG002"),
    ]:
        path = tmp_path / name
        if content is not None:
            path.write_bytes(content)
        with pytest.raises(ConfigErrors) as caught:
            read_config(path)
        assert caught.value.code == code
        assert caught.value.where.startswith(str(path))
    with pytest.raises(ConfigErrors, match="CFG001"):
        read_config(tmp_path)


def test_a_byte_order_mark_is_no_key(tmp_path: Path) -> None:
    """A file saved by a Windows editor reads the same."""
    path = tmp_path / "c.yaml"
    path.write_bytes(b"\xef\xbb\xbfbridge: cell1\r\ntick: 2ms\r\n")
    assert read_config(path).settings.bridge == "cell1"


def test_settings_from_python_data() -> None:
    """A dict of the file's form gives the same settings, and the same errors with key paths."""
    config = Config.from_dict({"bridge": "cell1", "tick": "2ms"})
    assert (config.settings.bridge, config.settings.tick_ns, config.path) == ("cell1", 2_000_000, None)
    with pytest.raises(ConfigErrors, match=r"topics\./a\.to"):
        Config.from_dict({"topics": {"/a": {"type": "a/b", "to": "x"}}})


def _plain(text: str) -> Any:
    return parse_config(text).source.data


@pytest.mark.parametrize("text", [GOOD.replace("enabled: no", "enabled: false"), "topics:\n", "tick: 1s\n"])
def test_schema_accepts_what_the_reader_accepts(text: str) -> None:
    """Valid configurations satisfy the JSON Schema that editors use."""
    schema = json_schema()
    jsonschema.Draft202012Validator.check_schema(schema)
    jsonschema.Draft202012Validator(schema).validate(_plain(text))


@pytest.mark.parametrize(
    "data",
    [
        {"brigde": "a"},
        {"tick": 5},
        {"tick": "5"},
        {"ros": {"distro": "foxy"}},
        {"topics": {"/a": {"type": "a/b"}}},
        {"topics": {"/a": {"type": "a/b", "to": "x"}}},
        {"topics": {"a": {"type": "a/b", "to": "plc"}}},
        {"topics": {"/a": {"type": "a/b", "to": "plc", "qos": "best"}}},
        {"topics": {"/a": {"type": "a/b", "to": "plc", "slots": 3}}},
        {"shm": {"mode": 432}},
    ],
)
def test_schema_refuses_what_the_reader_refuses(data: dict[str, Any]) -> None:
    """What an editor underlines is wrong for the bridge too."""
    assert not jsonschema.Draft202012Validator(json_schema()).is_valid(data)
    with pytest.raises(ConfigErrors):
        Config.from_dict(data)


@settings(max_examples=300, deadline=None)
@given(
    st.one_of(
        st.text(max_size=60), st.tuples(st.integers(0, len(GOOD)), st.integers(0, 9), st.text(max_size=5))
    )
)
def test_any_text_is_settings_or_errors(change: str | tuple[int, int, str]) -> None:
    """Whatever a file holds, reading it ends in settings or in errors with places, never in a traceback."""
    if isinstance(change, str):
        text = change
    else:
        at, cut, put = change
        text = GOOD[:at] + put + GOOD[at + cut :]
    try:
        parse_config(text, name="c.yaml")
    except ConfigErrors as errors:
        assert all(error.where.startswith("c.yaml") for error in errors.errors)


def test_yaml_without_its_c_library(monkeypatch: pytest.MonkeyPatch) -> None:
    """PyYAML in pure Python gives the same settings and codes."""
    expected = parse_config(GOOD).settings
    monkeypatch.setattr(yaml_source, "_Loader", yaml.SafeLoader)
    assert parse_config(GOOD).settings == expected
    for text, code in [
        ("bridge: [a", "CFG002"),
        ("\x00", "CFG002"),
        ("[" * 5000, "CFG002"),
        ("a: *b", "CFG009"),
    ]:
        with pytest.raises(ConfigErrors) as caught:
            parse_config(text)
        assert caught.value.code == code


def documented() -> list[tuple[str, str]]:
    """Return every configuration that documentation and examples show."""
    root = ROOT
    found = [(str(path.relative_to(root)), path.read_text()) for path in root.glob("examples/**/*.yaml")]
    for page in [root / "README.md", *root.glob("docs/**/*.md")]:
        blocks = re.findall(r"^```yaml\n(.*?)^```", page.read_text() if page.exists() else "", re.M | re.S)
        found += [(f"{page.relative_to(root)} {number}", text) for number, text in enumerate(blocks)]
    return [(name, text) for name, text in found if re.search(r"^topics:", text, re.M)]


@pytest.mark.parametrize(("name", "text"), documented(), ids=lambda value: value if len(value) < 60 else "")
def test_documented_configurations_are_valid(name: str, text: str) -> None:
    """What the documentation shows satisfies the schema and the reader."""
    jsonschema.Draft202012Validator(json_schema()).validate(parse_config(text, name=name).source.data)
