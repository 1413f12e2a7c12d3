"""The command line through typer's runner: output for people, JSON, and bad input."""

from __future__ import annotations

import json
import os
import re
import shlex
import sys
from pathlib import Path
from unittest.mock import Mock

import pytest
import typer
import yaml
from packaging.requirements import Requirement
from typer.testing import CliRunner

from rosplc._version import __version__
from rosplc.cli.app import app
from rosplc.cli.demo import parse_duration
from rosplc.cli.text import columns
from rosplc.described import description_of
from rosplc.harmless import nearest
from rosplc.layout import Limits, compute_layout
from rosplc.model import TypeStore
from rosplc.ros import BACKENDS, INSTALL
from rosplc.shm import Direction, OwnedChannel
from tests.command import rosplc

STORE = TypeStore.bundled("jazzy")
TWIST = "geometry_msgs/msg/Twist"


@pytest.fixture
def channel(shm_namespace):
    made = []

    def make(topic, type_name=TWIST, limits=None):
        layout = compute_layout(STORE, type_name, limits or Limits())
        description = description_of(layout, topic, Direction.TO_PLC, bridge="cell")
        owned = OwnedChannel.open(shm_namespace, description, record_size=layout.size, slots=16)
        made.append(owned)
        return owned.writer(), layout

    yield make
    for each in made:
        each.close()


@pytest.fixture
def config(tmp_path):
    def write(**changes):
        path = tmp_path / "rosplc.yaml"
        content = {
            "bridge": "cell1",
            "prefix": "celltest",
            "topics": {
                "/cmd_vel": {"type": TWIST, "to": "plc", "stale_after": "200ms"},
                "/joint_states": {"type": "sensor_msgs/msg/JointState", "to": "ros", "limits": {"name": 6}},
            },
        }
        path.write_text(yaml.safe_dump({**content, **changes}))
        return path

    return write


def test_help_names_every_verb_with_examples():
    """A newcomer finds the verbs and an example of each."""
    output = rosplc("--help").output
    for verb in ("run", "check", "status", "generate", "demo"):
        assert f"rosplc {verb}" in output
        own = rosplc(verb, "--help").output
        assert f"rosplc {verb}" in own[own.index("Examples:") :]


def test_version():
    """--version and version print the package's version, and the specification's newest."""
    assert rosplc("--version").output == f"rosplc {__version__}\n"
    changes = Path(__file__).parents[3] / "spec/CHANGES.md"
    newest = re.findall(r"(?m)^## (\S+)$", changes.read_text("utf-8"))[0]
    assert rosplc("version").output == f"rosplc {__version__}, shared-memory format {newest}\n"


def test_types_lists_all():
    """Without a type all names are listed, one a line."""
    names = sorted((*STORE.names(), *STORE.services(), *STORE.actions()))
    assert rosplc("types").output.split() == names
    assert json.loads(rosplc("types", "--json").output) == names


def test_types_lists_the_distributions():
    """--distros names what can be given to --distro."""
    assert set(json.loads(rosplc("types", "--distros", "--json").output)) >= {"humble", "jazzy", "noetic"}
    assert "jazzy" in rosplc("types", "--distros").output


def test_types_shows_one():
    """Fields come with offset, size, ROS and IEC type; layout id and definition follow."""
    output = rosplc("types", "sensor_msgs/JointState", "--limits", "name=6").output
    layout = compute_layout(STORE, "sensor_msgs/msg/JointState", Limits(fields={"name": 6}))
    assert layout.layout_id in output
    assert "ARRAY[0..5] OF STRING(80)" in output
    assert "LREAL" in output
    facts = json.loads(rosplc("types", "sensor_msgs/JointState", "--limits", "name=6", "--json").output)
    assert facts["size"] == layout.size
    assert [field["path"] for field in facts["fields"]] == [path for path, _, _ in layout.fields()]


def test_types_shows_a_service():
    """Both parts are shown as messages are, with the service's hash; `request.FIELD` limits a field."""
    arguments = ("std_srvs/SetBool", "--limits", "response.message=20")
    output = rosplc("types", *arguments).output
    digest = STORE.service_hash("std_srvs/SetBool")
    assert output.startswith(f"std_srvs/srv/SetBool (jazzy): service, hash {digest}\n")
    assert "std_srvs/srv/SetBool_Request (jazzy): 1 byte per record" in output
    assert "STRING(20)" in output
    facts = json.loads(rosplc("types", *arguments, "--json").output)
    assert (facts["kind"], facts["hash"], facts["response"]["size"]) == ("service", digest, 22)


def test_types_shows_an_action():
    """An action has three parts, and a hash in ROS 2 alone; a service of ROS 1 has its MD5 sum."""
    facts = json.loads(rosplc("types", "example_interfaces/Fibonacci", "--json").output)
    assert facts["hash"] == STORE.action_hash("example_interfaces/Fibonacci")
    assert [facts[part]["size"] for part in ("goal", "result", "feedback")] == [4, 68, 68]
    facts = json.loads(rosplc("types", "actionlib/TwoInts", "--distro", "noetic", "--json").output)
    assert "hash" not in facts and "md5" not in facts
    service = rosplc("types", "std_srvs/SetBool", "--distro", "noetic").output
    assert "md5 09fb03525b03e7ea1fd3992bafd87e16\n" in service


def test_types_shows_constants_and_defaults(tmp_path):
    """A custom type's constants and default values are shown."""
    (tmp_path / "my_msgs" / "msg").mkdir(parents=True)
    (tmp_path / "my_msgs" / "msg" / "Part.msg").write_text("uint8 GOOD=7\nuint16 width 25\n")
    output = rosplc("types", "my_msgs/Part", "--path", tmp_path).output
    assert "GOOD" in output
    assert "width  25" in output


def test_check_explains(config):
    """Direction, type, sizes and memory of every topic are told, and which defaults apply."""
    output = rosplc("check", "--verbose", config()).output
    assert "is valid" in output
    assert "/cmd_vel  ROS → PLC  geometry_msgs/msg/Twist" in output
    assert "/joint_states  PLC → ROS" in output
    assert "200 ms" in output
    assert "depth 1000 (default)" in output
    facts = json.loads(rosplc("check", config(), "--json").output)
    assert facts["topics"]["/cmd_vel"]["record_bytes"] == 48
    assert facts["topics"]["/cmd_vel"]["object"] == "celltest.t.cmd_vel"


def test_the_stated_memory_is_what_an_object_takes(config, tmp_path):
    """What check says about memory is to the byte what the bridge then allocates, and adds up."""
    from rosplc.bridge.engine import Bridge
    from rosplc.config.resolve import load_project

    path = config(shm={"directory": str(tmp_path)}, ros={"backend": "memory"})
    facts = json.loads(rosplc("check", path, "--json").output)
    with Bridge(load_project(path)):
        for topic in facts["topics"].values():
            size = os.stat(tmp_path / topic["object"]).st_size
            parts = topic["memory"]
            assert parts["object_bytes"] == size <= topic["memory_bytes"] < size + os.sysconf("SC_PAGESIZE")
            slots = parts["slots"] * parts["slot_bytes"]
            assert parts["header_bytes"] + parts["description_bytes"] + slots == size
    assert facts["memory_bytes"] == sum(topic["memory_bytes"] for topic in facts["topics"].values())


def test_check_warns_of_what_is_probably_not_meant(config):
    """Large records and truncation are pointed out."""
    topics = {
        "/image": {"type": "sensor_msgs/msg/Image", "to": "plc", "limits": {"data": 921600}},
        "/text": {"type": "std_msgs/msg/String", "to": "plc", "on_overflow": "truncate"},
    }
    output = rosplc("check", config(topics=topics)).output
    assert "Warning: /image: a record is" in output
    assert "Warning: /text: on_overflow" in output
    assert "Warning: the file has no topics" in rosplc("check", config(topics={})).output


def test_check_warns_of_a_backend_that_is_not_installed(config, monkeypatch):
    """A backend that this machine cannot import is told before a bridge starts, with what installs it."""
    monkeypatch.setitem(BACKENDS, "rclpy", "rosplc.ros.nothing")
    path = config(ros={"backend": "rclpy"})
    output = " ".join(rosplc("check", path).output.split())
    assert "the bridge would not start on this machine: the package for the rclpy backend" in output
    assert INSTALL["rclpy"] in output
    (warning,) = json.loads(rosplc("check", path, "--json").output)["warnings"]
    assert "rclpy" in warning
    assert json.loads(rosplc("check", config(ros={"backend": "memory"}), "--json").output)["warnings"] == []


def test_check_prints_the_schema():
    """--schema prints a JSON Schema of the file."""
    schema = json.loads(rosplc("check", "--schema").output)
    assert "topics" in schema["properties"]


def test_show_prints_the_newest_message(channel, shm_namespace):
    """A message is decoded by the object's own description."""
    writer, layout = channel("/cmd_vel")
    writer.publish(layout.pack({"linear": {"x": 1.5}}), stamp_ns=9)
    output = rosplc("show", "/cmd_vel", "--prefix", shm_namespace.prefix, "--header").output
    assert "x: 1.5" in output
    assert "message 1" in output
    assert layout.layout_id in output
    document = json.loads(rosplc("show", "/cmd_vel", "--prefix", shm_namespace.prefix, "--json").output)
    assert document["message"] == layout.to_dict(layout.pack({"linear": {"x": 1.5}}))
    assert (document["sequence"], document["stamp_ns"]) == (1, 9)


def test_show_says_that_there_is_no_message_yet(channel, shm_namespace):
    """An object without messages is no error."""
    channel("/cmd_vel")
    assert "no message yet" in rosplc("show", "/cmd_vel", "--prefix", shm_namespace.prefix).output
    document = json.loads(rosplc("show", "/cmd_vel", "--prefix", shm_namespace.prefix, "--json").output)
    assert document["message"] is None


def test_show_prints_nested_lists(channel, shm_namespace):
    """Sequences of messages and of numbers are readable."""
    writer, layout = channel("/poly", "geometry_msgs/msg/Polygon")
    writer.publish(layout.pack({"points": [{"x": 1.0}, {"x": 2.0}]}))
    output = rosplc("show", "/poly", "--prefix", shm_namespace.prefix).output
    assert "points:\n    - x: 1.0\n      y: 0.0\n      z: 0.0\n    - x: 2.0\n" in output


def test_show_prints_nan_as_valid_json(channel, shm_namespace):
    """NaN and infinity have no JSON number; they are written as text."""
    writer, layout = channel("/cmd_vel")
    writer.publish(layout.pack({"linear": {"x": float("nan"), "y": float("-inf")}}))
    output = rosplc("show", "/cmd_vel", "--prefix", shm_namespace.prefix, "--json").output
    message = json.loads(output, parse_constant=pytest.fail)["message"]
    assert (message["linear"]["x"], message["linear"]["y"]) == ("nan", "-inf")


def test_show_survives_text_that_is_none(channel, shm_namespace):
    """Bytes that are no UTF-8, and escape sequences, reach neither terminal nor JSON as they are."""
    writer, layout = channel("/text", "std_msgs/msg/String")
    record = bytearray(layout.size)
    record[:8] = b"\x1b[31m\xff\xc2\x9b"
    writer.publish(record)
    for extra in ([], ["--header"]):
        output = rosplc("show", "/text", "--prefix", shm_namespace.prefix, *extra).output
        assert not any((ord(char) < 32 and char != "\n") or 0x7F <= ord(char) < 0xA0 for char in output)
        assert "\\x1b[31m" in output
    output = rosplc("show", "/text", "--prefix", shm_namespace.prefix, "--json").output
    assert output.isascii()
    assert json.loads(output)["message"]["data"] == "\x1b[31m\udcff\x9b"


def test_show_lists_all_channels(channel, shm_namespace):
    """Without a topic every channel is listed, the unreadable ones with their error."""
    channel("/cmd_vel")
    shm_namespace.path("/bad").write_bytes(b"x" * 600)
    result = rosplc("show", "--prefix", shm_namespace.prefix)
    assert "/cmd_vel" in result.output
    assert "SHM104" in result.stderr
    states = json.loads(CliRunner().invoke(app, ["show", "--prefix", shm_namespace.prefix, "--json"]).stdout)
    assert {state["topic"]: state["code"] for state in states} == {"/bad": "SHM104", "/cmd_vel": ""}


def test_show_says_when_there_is_nothing(tmp_path):
    """A machine without channels gets a hint and status 0."""
    assert "no channels" in rosplc("show", "--directory", tmp_path).output


def test_show_gives_up_in_time(channel, shm_namespace):
    """--count with --timeout ends with status 1 when too few messages came."""
    channel("/cmd_vel")
    result = rosplc(
        "show", "/cmd_vel", "--prefix", shm_namespace.prefix, "--count", 2, "--timeout", 0.05, code=1
    )
    assert "0 of 2 messages" in result.stderr


def test_show_knows_other_prefixes(channel, shm_namespace):
    """A topic that stands under another prefix is found, and said how."""
    channel("/cmd_vel_of_prefix")
    result = rosplc("show", "/cmd_vel_of_prefix", code=1)
    assert f"--prefix {shm_namespace.prefix}" in result.stderr


BAD = {
    "unknown type": (["types", "nope/X"], 1, "TYP001"),
    "unknown distribution": (["types", "--distro", "jazy"], 1, "did you mean jazzy"),
    "misspelt limit": (["types", "std_msgs/String", "--limits", "dta=3"], 1, "LAY002"),
    "limit without a number": (["types", "std_msgs/String", "--limits", "data"], 2, "FIELD=N"),
    "limit of no part": (["types", "std_srvs/SetBool", "--limits", "message=3"], 2, "response.FIELD"),
    "unknown service": (["types", "std_srvs/srv/SetBol"], 1, "did you mean"),
    "limit of zero": (["types", "std_msgs/String", "--limits", "data=0"], 1, "LAY001"),
    "missing file": (["check", "/nowhere/rosplc.yaml"], 2, "CFG001"),
    "run without its file": (["run", "/nowhere/rosplc.yaml"], 2, "CFG001"),
    "check without a file": (["check"], 2, "this folder contains no rosplc.yaml"),
    "a topic that does not exist": (["show", "/no/such/topic"], 1, "SHM101"),
    "a topic that cannot exist": (["show", "no slash"], 1, "SHM118"),
    "a prefix that cannot exist": (["show", "/a", "--prefix", "1"], 1, "SHM118"),
    "a directory that does not exist": (["show", "--directory", "/nowhere"], 1, "SHM123"),
    "a count of zero": (["show", "/a", "--count", "0"], 2, "count"),
    "a duration that is none": (["demo", "--duration", "soon"], 2, "should be a number with a unit"),
    "a duration of zero": (["demo", "--duration", "0s"], 2, "is not between"),
    "a rate out of range": (["demo", "--rate", "0"], 2, "rate"),
    "a verb that does not exist": (["shwo"], 2, "show"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_input_is_one_clear_message(case):
    """Every mistake ends with its status and a message that names it, never with a traceback."""
    arguments, code, words = BAD[case]
    result = rosplc(*arguments, code=code)
    assert words in " ".join(result.stderr.split())


@pytest.mark.parametrize(
    "arguments", [["types", "nope/X"], ["show", "/no/such/topic"], ["check", "/nowhere/x"]]
)
def test_errors_are_json_when_json_is_asked_for(arguments):
    """With --json the error is one JSON document on stderr, and stdout stays empty."""
    result = CliRunner().invoke(app, [*arguments, "--json"])
    assert result.stdout == ""
    error = json.loads(result.stderr)["error"]
    assert set(error) == {"code", "what", "where", "remedy"}


def test_a_wrong_configuration_shows_every_mistake(config):
    """All mistakes are shown together, each with file, line and key."""
    path = config(brigde="x", tick="soon")
    result = rosplc("check", path, code=2)
    assert result.stderr.count("rosplc: error CFG") == 2
    assert f"{path}:" in result.stderr
    errors = json.loads(rosplc("check", path, "--json", code=2).stderr)["errors"]
    assert sorted(error["code"] for error in errors) == ["CFG003", "CFG004"]


def test_garbage_in_an_object_is_an_error(shm_namespace):
    """An object that something else wrote is named, not decoded."""
    shm_namespace.path("/junk").write_bytes(os.urandom(8192))
    assert "SHM104" in rosplc("show", "/junk", "--prefix", shm_namespace.prefix, code=1).stderr
    shm_namespace.path("/junk").write_bytes(b"")
    assert "SHM103" in rosplc("show", "/junk", "--prefix", shm_namespace.prefix, code=1).stderr


def test_an_unforeseen_failure_is_no_traceback(monkeypatch):
    """Even a defect gives one message; ROSPLC_DEBUG gives the traceback."""
    from rosplc.model import TypeStore as Store

    monkeypatch.setattr(Store, "bundled", lambda *_: 1 / 0)
    result = rosplc("types", code=1)
    assert "unexpected error: ZeroDivisionError" in result.stderr
    monkeypatch.setenv("ROSPLC_DEBUG", "1")
    assert isinstance(CliRunner().invoke(app, ["types"]).exception, ZeroDivisionError)


@pytest.mark.parametrize(
    ("text", "seconds"), [("20s", 20.0), ("500ms", 0.5), ("1.5min", 90.0), ("1h", 3600.0), ("3", 3.0)]
)
def test_durations(text, seconds):
    """A duration has a unit, seconds without one."""
    assert parse_duration(text) == seconds


def test_columns_align():
    """Numbers stand to the right, text to the left, the last column has no padding."""
    assert columns([("a", 1, "x"), ("bb", 10, "y")], header=("n", "v", "w")) == [
        "n    v  w",
        "a    1  x",
        "bb  10  y",
    ]
    assert columns([], header=("n",)) == []


def test_a_demo_without_a_terminal_ends_and_its_help_says_when(monkeypatch):
    """Without --duration and without a terminal it runs for the time that the help names."""
    given = []

    def ends(plan, seconds, **how):
        given.append(seconds)
        raise typer.Exit(7)

    monkeypatch.setattr("rosplc.cli.demo._run", ends)
    assert CliRunner().invoke(app, ["demo"]).exit_code == 7
    (seconds,) = given
    words = " ".join(CliRunner().invoke(app, ["demo", "--help"]).output.replace("│", " ").split())
    assert f"or for {seconds:g}s if the output is not a terminal" in words


def test_a_package_lists_its_types():
    """`types sensor_msgs` prints the package's types, one a line."""
    lines = rosplc("types", "sensor_msgs").output.split()
    assert "sensor_msgs/msg/JointState" in lines
    assert "sensor_msgs/srv/SetCameraInfo" in lines
    assert all(line.startswith(("sensor_msgs/msg/", "sensor_msgs/srv/")) for line in lines)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("bridge: c\nros:\n\tdistro: jazzy\n", "indented with a tab"),
        ("ros: {distro: jazy}\n", "did you mean 'jazzy'?"),
        ("topics: {/a: {type: std_msgs/Int32, to: PLC}}\n", "did you mean 'plc'?"),
    ],
)
def test_slips_in_a_configuration_get_a_plain_sentence(tmp_path, text, words):
    """A tab, a misspelt distribution and another case are named as such."""
    path = tmp_path / "rosplc.yaml"
    path.write_text(text)
    assert words in rosplc("check", path, code=2).stderr


def test_a_named_pipe_is_no_configuration(tmp_path):
    """It is refused and not waited for."""
    path = tmp_path / "pipe"
    os.mkfifo(path)
    assert "is a named pipe" in rosplc("check", path, code=2).stderr


@pytest.mark.parametrize("error", [MemoryError(), RuntimeError("can't start new thread")])
def test_a_lack_of_memory_is_named(monkeypatch, error):
    """`ulimit -v` leads to SYS014 with what to raise, not to an unexpected error."""

    def fails(*_):
        raise error

    monkeypatch.setattr("rosplc.model.TypeStore.bundled", fails)
    assert "SYS014" in rosplc("types", code=1).stderr


@pytest.mark.parametrize(
    ("word", "found"),
    [
        ("/Cmd_Vel", "/cmd_vel"),
        ("cmd_vel", "/cmd_vel"),
        ("/cmd_vle", "/cmd_vel"),
        ("scan", "/robot1/scan"),
        ("/x", ""),
    ],
)
def test_the_nearest_topic_is_found(word, found):
    """Another case, a missing slash, a slip and a missing namespace."""
    assert nearest(word, ["/cmd_vel", "/robot1/scan", "/tf"]) == found


def test_remedies_name_the_pip_of_this_installation():
    """The command works as printed, also in a checkout."""
    from rosplc.doctor.machine import pip_here

    text = pip_here("pip install 'rosplc[views]'")
    assert text.startswith(str(Path(sys.executable).parent)) and "[views]" in text


def test_remedies_fit_the_environment(monkeypatch, tmp_path):
    """A virtual environment has its pip, pipx its inject; where the system manages Python one is made."""
    from rosplc.doctor import machine

    monkeypatch.setattr(machine, "distribution", lambda name: Mock(read_text=lambda path: None))
    views, other = "pip install 'rosplc[views]'", "pip install 'cyclonedds>=11,<12' (x86-64)"
    environment = tmp_path / "my venvs" / "rosplc"
    (environment / "bin").mkdir(parents=True)
    monkeypatch.setattr("sys.prefix", str(environment))
    monkeypatch.setattr("sys.executable", str(environment / "bin" / "python"))
    assert machine.pip_here(other) == f"'{environment}/bin/python' -m {other}"
    (environment / "bin" / "pip").touch()
    assert machine.pip_here(views) == f"'{environment}/bin/pip' install 'rosplc[views]'"

    (environment / "pipx_metadata.json").touch()
    assert machine.pip_here(other) == "pipx inject rosplc 'cyclonedds>=11,<12' (x86-64)"
    command, brought = machine.pip_here(views).split(" rosplc ")
    names = [Requirement(each).name for each in shlex.split(brought)]
    assert command == "pipx inject" and names == ["textual", "aiohttp"]

    monkeypatch.setattr("sys.prefix", sys.base_prefix)
    monkeypatch.setattr("sys.executable", "/usr/bin/python3")
    monkeypatch.setattr("sysconfig.get_path", {"stdlib": str(tmp_path)}.get)
    assert " -m venv " not in machine.pip_here(views)
    (tmp_path / "EXTERNALLY-MANAGED").touch()
    new = "/usr/bin/python3 -m venv ~/rosplc-env && ~/rosplc-env/bin/pip install"
    assert machine.pip_here(views) == f"{new} 'rosplc[views]'"
    assert machine.pip_here(other) == f"{new} rosplc 'cyclonedds>=11,<12' (x86-64)"
    monkeypatch.setattr("sys.prefix", "/opt/rosplc")
    assert " -m venv " not in machine.pip_here(views)
    monkeypatch.setattr(machine, "find_spec", lambda name: None)
    assert machine.pip_here(views) == f"{new} 'rosplc[views]'"
