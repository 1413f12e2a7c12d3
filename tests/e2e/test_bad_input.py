"""What goes wrong around a bridge, through the real command: a clear error or a counted refusal each."""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from random import Random

import pytest

import rosplc
from rosplc.codec import Codec, Wire
from rosplc.layout import Limits, compute_layout
from rosplc.model import TypeStore
from rosplc.ros import DEFAULT, Backend, Qos, open_backend
from rosplc.shm import Namespace
from tests.command import rosplc as command
from tests.lib.isolated import mounted
from tests.lib.waiting import wait_for

INT, STRING = "std_msgs/msg/Int32", "std_msgs/msg/String"
PLAIN = f"topics:\n  /in: {{type: {INT}, to: plc}}\n  /out: {{type: {INT}, to: ros}}\n"
LOCAL = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}


class Bridge:
    """``rosplc run`` as a process, with what it says."""

    def __init__(self, path: Path, **environment: str) -> None:
        self.said: list[str] = []
        self.process = subprocess.Popen(
            [sys.executable, "-m", "rosplc", "run", str(path), "--status", "0.5"],
            stderr=subprocess.PIPE,
            text=True,
            env={**os.environ, **LOCAL, **environment},
        )
        self._reader = threading.Thread(target=self._read)
        self._reader.start()

    def _read(self) -> None:
        assert self.process.stderr is not None
        with self.process.stderr as lines:
            for line in lines:
                self.said.append(line.rstrip())

    def says(self, words: str) -> str:
        """Wait for a line with these words; pytest's timeout is the watchdog."""
        while True:
            ended = self.process.poll() is not None and not self._reader.is_alive()
            for line in list(self.said):
                if words in line:
                    return line
            assert not ended, f"{words!r} was never said: {self.said}"
            time.sleep(0.02)

    def ends(self) -> int:
        """Wait for its end and return the exit status; a traceback is a failure anyway."""
        status = self.process.wait()
        self._reader.join()
        assert not any("Traceback" in line or "unexpected" in line for line in self.said), self.said
        return status

    def stop(self) -> int:
        """End it as an init system does."""
        self.process.terminate()
        return self.ends()

    def kill(self) -> None:
        """End it as a power cut does."""
        self.process.kill()
        self.process.wait()
        self._reader.join()


@pytest.fixture
def config(tmp_path: Path, shm_prefix: str) -> Callable[..., Path]:
    """Give a function that writes a configuration whose topics begin on line 3."""

    def write(topics: str = PLAIN, ros: str = "{backend: memory}") -> Path:
        path = tmp_path / "rosplc.yaml"
        path.write_text(f"prefix: {shm_prefix}\nros: {ros}\n{topics}")
        return path

    return write


@pytest.fixture
def run() -> Iterator[Callable[..., Bridge]]:
    """Give a function that starts a bridge; what still runs at the end is killed."""
    started: list[Bridge] = []

    def start(path: Path, **environment: str) -> Bridge:
        started.append(Bridge(path, **environment))
        return started[-1]

    yield start
    for bridge in started:
        bridge.kill()


@pytest.fixture
def node(dds_domain: int) -> Iterator[Callable[..., Backend]]:
    """Give a function that joins the test's domain with a node of its own."""
    with contextlib.ExitStack() as stack:

        def join(store: TypeStore | None = None) -> Backend:
            backend = open_backend(
                "dds", store or TypeStore.bundled("jazzy"), "peer", domain=dds_domain, environment=LOCAL
            )
            stack.callback(backend.close)
            return backend

        yield join


# -- the configuration


@pytest.mark.parametrize(
    ("topics", "code", "line", "words"),
    [
        ("topics:\n  /a: {type: std_msgs/Sting, to: plc}\n", "TYP001", 4, "mean std_msgs/msg/String"),
        ("topics:\n  /a: {type: std_msgs/Bool, to: plc,\n    speed: 3}\n", "CFG003", 5, "'speed'"),
        (
            "topics:\n  /a: {type: std_msgs/Bool, to: plc}\n  /a: {type: std_msgs/Bool, to: ros}\n",
            "CFG006",
            5,
            "already defined on line 4",
        ),
        ("topics:\n  /a: {type: std_msgs/String, to: plc, limits: {data: 0}}\n", "LAY001", 4, "capacity 0"),
        ("topics:\n\t/a: {}\n", "CFG002", 4, "indented with a tab"),
        ("types: {paths: [nowhere]}\n", "CFG001", 3, "does not exist"),
        ("shm: {owner: -1}\ntopics: {/a: {type: std_msgs/Bool, to: plc}}\n", "CFG004", 3, "-1 is not"),
    ],
)
def test_configuration(
    config: Callable[..., Path], shm_prefix: str, topics: str, code: str, line: int, words: str
) -> None:
    """What is wrong in the file ends the bridge with status 2, code, line and words; nothing is made."""
    text = command("run", config(topics), code=2).stderr
    assert code in text
    assert words in text
    assert f"rosplc.yaml:{line}" in text
    assert not list(Path("/dev/shm").glob(f"{shm_prefix}.t.*"))


def test_configuration_edited_while_running(config: Callable[..., Path], run: Callable[..., Bridge]) -> None:
    """An edited file changes nothing but is said, even if it is broken by now."""
    path = config()
    bridge = run(path)
    bridge.says("carries 2 topics")
    path.write_text("topics: [")
    assert "run `rosplc reload` or restart the bridge to apply it" in bridge.says(
        "configuration changed on disk"
    )
    assert bridge.stop() == 0


# -- shared memory


@pytest.mark.parametrize("kind", ["directory", "link", "pipe"])
def test_name_that_is_taken(
    config: Callable[..., Path],
    run: Callable[..., Bridge],
    shm_namespace: Namespace,
    tmp_path: Path,
    kind: str,
) -> None:
    """What is no plain file is named and left alone, and its topic is not carried."""
    precious = tmp_path / "precious"
    precious.write_bytes(b"precious")
    path = shm_namespace.path("/in")
    if kind == "directory":
        path.mkdir()
    elif kind == "link":
        path.symlink_to(precious)
    else:
        os.mkfifo(path)
    bridge = run(config())
    assert "/in: " in bridge.says("SHM121")
    assert precious.read_bytes() == b"precious"
    assert path.is_symlink() or not path.is_file()
    assert bridge.stop() == 0


@pytest.mark.foreign
def test_name_that_another_bridge_holds(config: Callable[..., Path], run: Callable[..., Bridge]) -> None:
    """A second bridge says who holds the name, and the first goes on."""
    path = config()
    first = run(path)
    first.says("carries 2 topics")
    second = run(path)
    assert second.ends() == 1
    assert f"bridge rosplc, process {first.process.pid}, holds /in" in "\n".join(second.said)
    assert first.stop() == 0


def test_foreign_file_at_a_name(
    config: Callable[..., Path], run: Callable[..., Bridge], shm_namespace: Namespace
) -> None:
    """A file of this user that no bridge has made is left as it is, and named."""
    path = shm_namespace.path("/in")
    path.write_bytes(b"not an object" * 100)
    bridge = run(config())
    assert "/in: " in bridge.says("SHM104")
    assert path.read_bytes() == b"not an object" * 100
    assert bridge.stop() == 0


@pytest.mark.needs(when=os.geteuid() == 0, why="only root can give files to other users")
def test_object_of_another_user(
    config: Callable[..., Path], run: Callable[..., Bridge], shm_namespace: Namespace
) -> None:
    """An object that someone else owns is left to them."""
    path = shm_namespace.path("/in")
    path.write_bytes(b"theirs")
    os.chown(path, 65534, 65534)
    bridge = run(config())
    assert "/in: " in bridge.says("SHM119")
    assert path.read_bytes() == b"theirs"
    assert bridge.stop() == 0


@pytest.mark.foreign
@pytest.mark.parametrize(
    ("options", "code"), [("ro", "SHM123"), ("size=4k", "SHM117"), ("nr_inodes=2", "SHM117")]
)
def test_directory_that_cannot_take_an_object(config: Callable[..., Path], options: str, code: str) -> None:
    """A /dev/shm that is read-only, full or out of inodes ends the bridge with the reason."""
    path = config("topics: {/in: {type: sensor_msgs/Image, to: plc, limits: {data: 10000}}}\n")
    done = mounted("/dev/shm", options, 'exec "$0" -m rosplc run "$1"', sys.executable, str(path))
    assert (done.returncode, done.stderr.count(f"rosplc: error {code}")) == (1, 1), done.stderr


@pytest.mark.foreign
def test_objects_removed_under_a_running_bridge(
    config: Callable[..., Path], run: Callable[..., Bridge], shm_namespace: Namespace
) -> None:
    """Objects and locks that somebody removes are said, and made again."""
    bridge = run(config())
    bridge.says("carries 2 topics")
    for path in Path("/dev/shm").glob(f"{shm_namespace.prefix}.*"):
        path.unlink()
    bridge.says("creating it again [SHM120]")
    wait_for(lambda: len(rosplc.topics(shm_namespace.prefix)) == 2)
    wait_for(lambda: shm_namespace.lock_path("/in").exists())
    assert bridge.stop() == 0


@pytest.mark.foreign
def test_more_topics_than_files(config: Callable[..., Path]) -> None:
    """A limit on open files is asked to be lifted, and named where it cannot be."""
    topics = "".join(f"  /t{index}: {{type: std_msgs/Bool, to: plc}}\n" for index in range(80))
    limited = 'ulimit -n 60 && exec "$0" -m rosplc run "$1"'
    done = subprocess.run(
        ["sh", "-c", limited, sys.executable, str(config("topics:\n" + topics))],
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stderr.count("error SYS006: too many files are open")) == (1, 1), (
        done.stderr
    )


# -- the ROS side


@pytest.mark.foreign
def test_peers_that_do_not_fit(
    config: Callable[..., Path],
    run: Callable[..., Bridge],
    node: Callable[..., Backend],
    dds_domain: int,
    shm_prefix: str,
    tmp_path: Path,
) -> None:
    """Another type, definition or QoS, and too long a text, are said in log, status and /diagnostics."""
    msg = tmp_path / "mine" / "my_msgs" / "msg"
    msg.mkdir(parents=True)
    (msg / "Part.msg").write_text("int32 a\nint32 b\n")
    topics = (
        "types: {paths: [mine]}\ndiagnostics: {period: 100ms}\ntopics:\n"
        "  /part: {type: my_msgs/Part, to: plc}\n  /type: {type: std_msgs/Int32, to: plc}\n"
        "  /qos: {type: std_msgs/Int32, to: plc}\n"
        "  /text: {type: std_msgs/String, to: plc, limits: {data: 4}, latched: true}\n"
    )
    bridge = run(config(topics, f"{{domain: {dds_domain}}}"))
    bridge.says("carries 4 topics over dds")
    # The same bytes in another order: DDS would hand them over, with the values exchanged.
    peer = node(TypeStore.bundled("jazzy").with_definition("my_msgs/msg/Part", "int32 b\nint32 a\n"))
    latched = Qos(durability="transient_local")
    part = peer.advertise("/part", "my_msgs/msg/Part", DEFAULT)
    peer.advertise("/type", "std_msgs/msg/Float32", latched)
    peer.advertise("/qos", INT, Qos(reliability="best_effort"))
    text = peer.advertise("/text", STRING, latched)
    diagnostics = compute_layout(
        TypeStore.bundled("jazzy"), "diagnostic_msgs/msg/DiagnosticArray", Limits(string=300, sequence=40)
    )
    codec = Codec(diagnostics, Wire.CDR)
    seen: dict[str, tuple[int, str]] = {}

    def note(payload: bytes, _: int) -> None:
        for status in diagnostics.to_dict(codec.decode(payload))["status"]:
            seen[status["name"].removeprefix("rosplc: rosplc: ")] = (status["level"], status["message"])

    peer.subscribe("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray", DEFAULT, note)
    for words in ("far too long", "fits"):
        text.write(struct.pack("<BBHI", 0, 1, 0, len(words) + 1) + words.encode() + b"\0")
    problems = {
        "/part": "as my_msgs/msg/Part with another definition",
        "/type": "publishes /type as std_msgs/msg/Float32, but the local type is std_msgs/msg/Int32",
        "/qos": "the publisher is best_effort and the subscriber requests reliable",
    }
    for topic, words in problems.items():
        assert topic in bridge.says(f"{words}")
        wait_for(lambda t=topic, w=words: t in seen and seen[t][0] == 2 and w in seen[t][1])
    bridge.says(
        "/text: message refused: std_msgs/msg/String: data: string has 12 bytes; the limit is 4 [COD004]"
    )
    with rosplc.attach("/text", prefix=shm_prefix, latched=True) as channel:
        message = channel.wait()
        assert message is not None
        assert message.data == "fits"
        assert channel.snapshot().writer.refused == 1
    wait_for(lambda: part.matched)
    part.write(struct.pack("<BBHii", 0, 1, 0, 1, 2))
    bridge.says("refused 2")
    with rosplc.attach("/part", prefix=shm_prefix, latched=True) as channel:
        assert channel.read() is None
    assert bridge.stop() == 0


@pytest.mark.foreign
def test_garbage_on_the_wire(
    config: Callable[..., Path],
    run: Callable[..., Bridge],
    node: Callable[..., Backend],
    dds_domain: int,
    shm_prefix: str,
) -> None:
    """Datagrams that are no DDS, or hardly, do not keep the bridge from carrying what is."""
    bridge = run(config(PLAIN, f"{{domain: {dds_domain}}}"))
    bridge.says("carries 2 topics over dds")
    random = Random(1)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        for _ in range(300):
            body = random.randbytes(random.choice([0, 3, 60, 1400]))
            if random.random() < 0.7:
                kind = bytes([random.choice([0x15, 0x16, 0x06, 0x07, 0x08]), random.randrange(8)])
                body = b"RTPS\x02\x05\x01\x10" + random.randbytes(12) + kind + body
            for port in range(4):
                sender.sendto(body, ("127.0.0.1", 7400 + 250 * dds_domain + 10 + port))
    publisher = node().advertise("/in", INT, DEFAULT)
    with rosplc.attach("/in", prefix=shm_prefix) as channel:
        wait_for(lambda: publisher.matched)
        publisher.write(struct.pack("<BBHi", 0, 1, 0, 77))
        message = channel.wait()
        assert message is not None
        assert message.data == 77
    assert bridge.stop() == 0


@pytest.mark.foreign
@pytest.mark.parametrize(
    ("name", "value"),
    [("ROS_DOMAIN_ID", "abc"), ("ROS_DOMAIN_ID", "233"), ("ROS_STATIC_PEERS", "host.invalid")],
)
def test_environment(config: Callable[..., Path], run: Callable[..., Bridge], name: str, value: str) -> None:
    """A variable with a value of no use is named; the DDS library does not get to abort."""
    bridge = run(config(PLAIN, "{backend: dds}"), **{name: value})
    assert bridge.ends() == 1
    text = "\n".join(bridge.said)
    assert f"error ROS010: {name}" in text
    assert value in text


# -- signals


@pytest.mark.foreign
@pytest.mark.parametrize("numbers", [(signal.SIGTERM,), (signal.SIGINT, signal.SIGINT)])
def test_signals(config: Callable[..., Path], run: Callable[..., Bridge], numbers: tuple[int, ...]) -> None:
    """A signal, also one that comes to the process and to its group, is a clean stop."""
    bridge = run(config())
    bridge.says("carries 2 topics")
    for each in numbers:
        bridge.process.send_signal(each)
    assert bridge.ends() == 0
    assert "stopped" in bridge.said[-1]
