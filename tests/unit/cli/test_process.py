"""The command as a process of its own: signals, pipes, and a bridge in the foreground."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import threading
import time

import pytest
import yaml
from typer.main import get_command

import rosplc
from rosplc.cli import main
from rosplc.cli.app import app
from rosplc.described import description_of
from rosplc.layout import Limits, compute_layout
from rosplc.model import TypeStore
from rosplc.shm import Direction, OwnedChannel

STORE = TypeStore.bundled("jazzy")


@contextlib.contextmanager
def process(*arguments, **settings):
    child = subprocess.Popen(
        [sys.executable, "-m", "rosplc", *map(str, arguments)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        **settings,
    )
    try:
        yield child
    finally:
        child.kill()
        child.communicate()


@pytest.fixture
def talker(shm_namespace):
    """A bridge that publishes numbers all the time."""
    layout = compute_layout(STORE, "std_msgs/msg/Int32", Limits())
    description = description_of(layout, "/n", Direction.TO_PLC, bridge="cell")
    stop = threading.Event()
    with OwnedChannel.open(shm_namespace, description, record_size=layout.size, slots=64) as channel:
        writer = channel.writer()

        def talk():
            number = 0
            while not stop.wait(0.005):
                number += 1
                writer.publish(layout.pack({"data": number}))

        thread = threading.Thread(target=talk)
        thread.start()
        yield shm_namespace
        stop.set()
        thread.join()


def test_follow_prints_messages_in_order(talker):
    """--count prints so many messages, each once and in order, one JSON document per line."""
    with process("show", "/n", "--prefix", talker.prefix, "--count", 20, "--json") as child:
        out, err = child.communicate(timeout=60)
    assert (child.returncode, err) == (0, "")
    numbers = [json.loads(line)["message"]["data"] for line in out.splitlines()]
    assert numbers == list(range(numbers[0], numbers[0] + 20))


@pytest.mark.foreign
def test_a_reader_that_goes_away_ends_it_quietly(talker):
    """`rosplc show --follow | head` ends without a message about the pipe."""
    with process("show", "/n", "--prefix", talker.prefix, "--follow") as child:
        assert child.stdout.readline()
        child.stdout.close()
        assert child.wait(timeout=60) == 141
        assert child.stderr.read() == ""


@pytest.mark.foreign
def test_ctrl_c_ends_it_quietly(talker):
    """Ctrl-C gives status 130 and no traceback."""
    with process("show", "/n", "--prefix", talker.prefix, "--follow") as child:
        assert child.stdout.readline()
        child.send_signal(signal.SIGINT)
        _, err = child.communicate(timeout=60)
    assert (child.returncode, err) == (130, "")


def test_ctrl_c_during_an_import_is_no_traceback(monkeypatch):
    """Python before 3.12 wraps the interrupt where a class is being made; the status is 130 anyway."""

    def importing(**_: object) -> None:
        raise RuntimeError("Error calling __set_name__") from KeyboardInterrupt()

    monkeypatch.setattr("rosplc.cli.prepare_streams", lambda: None)
    monkeypatch.setattr("rosplc.cli.app.app", importing)
    with pytest.raises(SystemExit) as caught:
        main()
    assert caught.value.code == 130


AS_NOBODY = """
import os, sys
from typer.testing import CliRunner
from rosplc.cli.app import app

# Once with all rights, so that everything is imported: nobody may not read root's Python.
assert CliRunner().invoke(app, sys.argv[1:]).exit_code == (0 if os.geteuid() == 0 else 1)
if os.geteuid() == 0:
    os.setgroups([])
    os.setgid(65534)
    os.setuid(65534)
app()
"""


@pytest.mark.foreign
def test_no_permission_is_an_error(talker):
    """An object that this user may not open is SHM102, with the remedy."""
    os.chmod(talker.path("/n"), 0o600 if os.geteuid() == 0 else 0)
    done = subprocess.run(
        [sys.executable, "-c", AS_NOBODY, "show", "/n", "--prefix", talker.prefix],
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert done.returncode == 1
    assert "SHM102" in done.stderr


def run_config(tmp_path, prefix):
    path = tmp_path / "rosplc.yaml"
    content = {
        "prefix": prefix,
        "ros": {"backend": "memory"},
        "topics": {"/cmd_vel": {"type": "geometry_msgs/msg/Twist", "to": "plc"}},
    }
    path.write_text(yaml.safe_dump(content))
    return path


def started(prefix):
    end = time.monotonic() + 60
    while not any(state.writer_alive for state in rosplc.topics(prefix)):
        assert time.monotonic() < end, "the bridge did not start"


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_run_carries_until_a_signal(tmp_path, shm_namespace, number):
    """`rosplc run` beats until a signal, ends with status 0, and leaves its objects."""
    path = run_config(tmp_path, shm_namespace.prefix)
    with process("run", path, "--status", "0.2") as child:
        said = ""
        while "status:" not in said:
            said += child.stderr.readline() or pytest.fail(f"no status line: {said}")
        child.send_signal(number)
        out, _ = child.communicate(timeout=60)
    assert (child.returncode, out) == (0, "")
    assert "carries 1 topics" in said
    assert shm_namespace.path("/cmd_vel").exists()
    assert not any(state.writer_alive for state in rosplc.topics(shm_namespace.prefix))


@pytest.mark.foreign
def test_a_second_bridge_is_refused(tmp_path, shm_namespace):
    """Two bridges on one name: the second ends with SHM116 and the first goes on."""
    path = run_config(tmp_path, shm_namespace.prefix)
    with process("run", path, "-q") as first:
        started(shm_namespace.prefix)
        with process("run", path) as second:
            _, err = second.communicate(timeout=60)
        assert second.returncode == 1
        assert "SHM116" in err
        assert first.poll() is None
        started(shm_namespace.prefix)


@pytest.mark.foreign
def test_run_takes_ros_arguments(tmp_path, shm_namespace):
    """ROS arguments stand among the command's own; a bad one ends it with status 2 and is named."""
    path = run_config(tmp_path, shm_namespace.prefix)
    arguments = (
        "__name:=cell",
        "--ros-args",
        "-r",
        "__ns:=/r1",
        "--log-level",
        "warn",
        "--",
        "--status",
        "0",
    )
    with process("run", path, *arguments) as child:
        started(shm_namespace.prefix)
        child.send_signal(signal.SIGINT)
        _, err = child.communicate(timeout=60)
    assert (child.returncode, err) == (0, "")
    with process("run", path, "--ros-args", "-r", "/cmd_vel=/base") as child:
        _, err = child.communicate(timeout=60)
    assert child.returncode == 2
    assert "CFG011" in err
    assert "/cmd_vel=/base" in err


def test_a_verb_without_a_configuration_starts_without_pydantic():
    """Reading the command line does not load it: only a configuration needs it."""
    code = (
        "import sys\nfrom rosplc.cli import main\n"
        "try:\n    main()\n"
        "except SystemExit:\n    pass\n"
        "print('IMPORTED', 'pydantic' in sys.modules)"
    )
    command = [sys.executable, "-c", code, "types", "std_msgs/String", "--distro", "humble"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert "std_msgs/msg/String (humble)" in done.stdout
    assert done.stdout.splitlines()[-1] == "IMPORTED False"


def test_the_list_of_verbs_says_what_each_says_itself():
    """`rosplc --help` has the first sentence of every verb's own help."""
    for name, listed in get_command(app).commands.items():
        command = listed.make_context(name, [], resilient_parsing=True).command
        assert command.help.partition("\n\n")[0] == listed.help


def test_help_and_completion_need_the_command_alone():
    """They list every verb without importing a single one."""
    code = (
        "import sys\nfrom rosplc.cli import main\n"
        "try:\n    main()\n"
        "except SystemExit:\n    pass\n"
        "print('IMPORTED', *sorted(name for name in sys.modules if name.startswith('rosplc.')))"
    )
    command = [sys.executable, "-c", code]
    listed = subprocess.run([*command, "--help"], capture_output=True, text=True, timeout=120)
    assert listed.stdout.splitlines()[-1] == "IMPORTED rosplc._version rosplc.cli rosplc.cli.app"
    one = subprocess.run([*command, "bench"], capture_output=True, text=True, timeout=120)
    verbs = {f"rosplc.cli.{name}" for name in (*get_command(app).commands, "ros")}
    assert verbs & set(one.stdout.split()) == {"rosplc.cli.bench"}
    asked = {**os.environ, "_ROSPLC_COMPLETE": "complete_bash", "COMP_WORDS": "rosplc re", "COMP_CWORD": "1"}
    command = [sys.executable, "-m", "rosplc"]
    done = subprocess.run(command, env=asked, capture_output=True, text=True, timeout=120)
    assert done.stdout.split() == ["reload", "release", "record", "replay"]


def test_an_interrupt_while_a_class_is_made_gives_its_status(tmp_path):
    """Where Ctrl-C meets an exec, as of a dataclass, the command ends with 130 and not by the signal."""
    (tmp_path / "interrupted.py").write_text(
        "import rosplc.cli.app\n"
        "rosplc.cli.app.app = lambda **_: exec('raise KeyboardInterrupt')\n"
        "rosplc.cli.main()\n"
    )
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(tmp_path), *sys.path])}
    ended = subprocess.run([sys.executable, "-m", "interrupted"], env=environment, check=False)
    assert ended.returncode == 130
