"""What 0.1.0 made goes on working: a program over its C headers, and the PLC code that it generated."""

from __future__ import annotations

import json
import secrets
import shutil
import signal
import struct
import subprocess
import sys
import threading
import time
from hashlib import sha256
from pathlib import Path

import pytest

from rosplc.codec import Codec, Wire
from rosplc.described import description_of
from rosplc.layout import Limits, compute_layout
from rosplc.model import TypeStore
from rosplc.project import generate_types
from rosplc.ros import DEFAULT, open_backend
from rosplc.shm import Direction, Namespace, OwnedChannel, attach
from tests.lib.waiting import wait_for
from tests.peers.release import environment, old_release

if shutil.which("gcc") is None:
    pytest.skip("Debian package gcc is missing", allow_module_level=True)

ROOT = Path(__file__).resolve().parents[2]
HERE = Path(__file__).parent
TYPE = "geometry_msgs/msg/Vector3"
STORE = TypeStore.bundled("jazzy")
LAYOUT = compute_layout(STORE, TYPE, Limits())
# Of each file that 0.1.0 generated: the first half of its SHA-256.
TYPES: dict[str, dict[str, str]] = json.loads((HERE / "types-0.1.0.json").read_text("utf-8"))
WATCHDOG_S = 100.0
NO_BRIDGE, REPLACED = 125, {109, 111}  # the object has gone, or is retired: the block opens the next one


def test_a_program_over_the_old_c_headers(tmp_path: Path, shm_namespace: Namespace) -> None:
    """It takes every message of today's writer in order, and today's reader takes every one of its own."""
    program = tmp_path / "echo"
    headers = old_release() / "rosplc" / "_core"
    flags = ["-std=gnu11", "-O2", "-Wall", "-Werror", f"-I{headers}"]
    subprocess.run(["gcc", *flags, str(HERE / "echo.c"), "-o", str(program)], check=True)
    into, out = (
        OwnedChannel.open(
            shm_namespace, description_of(LAYOUT, topic, direction, bridge="test"), record_size=LAYOUT.size
        )
        for topic, direction in (("/in", Direction.TO_PLC), ("/out", Direction.TO_ROS))
    )
    with into, out:
        writer, reader, record = into.writer(), out.reader(), bytearray(LAYOUT.size)
        command = [str(program), into.path, out.path]
        with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as peer:
            assert peer.stdin is not None and peer.stdout is not None
            assert peer.stdout.readline() == "ready\n"
            for number in range(1, 1001):
                sent = bytes(LAYOUT.pack({"x": float(number), "y": -float(number), "z": 0.5}))
                writer.publish(sent)
                wait_for(lambda: reader.next(record), "the message to come back", every=0.001)
                assert record == sent
            peer.stdin.close()
            assert peer.stdout.read() == "lost 0\n"
        assert peer.returncode == 0


@pytest.mark.parametrize("distro", sorted(TYPES))
def test_data_types_are_those_of_the_old_release(distro: str, tmp_path: Path) -> None:
    """Data unit types of every bundled type are the same text, to the byte; but ROS 1's byte has a sign."""
    generate_types(distro, tmp_path, programs="SharedMemory")
    now = {}
    for path in (tmp_path / "st/Types").iterdir():
        text = path.read_bytes()
        now[path.stem] = sha256(text.replace(b" BYTE", b" SINT") if distro == "noetic" else text)
    assert len(TYPES[distro]) > 50
    assert {name: now[name].hexdigest()[:16] for name in TYPES[distro]} == TYPES[distro]


PASS = """PROGRAM Pass
ROS_Write.out.msg := ROS_Read.in.msg;
ROS_Write.out.xEnable := ROS_Read.in.xNew;
ROS_Write.resized.msg := ROS_Read.in.msg;
ROS_Write.resized.xEnable := ROS_Read.in.xNew;
END_PROGRAM
"""
BLOCKS = ("ROS_Read.in", "ROS_Write.out", "ROS_Write.resized")


class Plc(threading.Thread):
    """The project that 0.1.0 generated, translated and scanned; it sends back what comes.

    Attributes:
        errors: Block → every error number that it has shown since all were ready.
    """

    def __init__(self, folder: Path) -> None:
        super().__init__(daemon=True)
        from rosplc_st.build import Toolchain, build
        from rosplc_st.machine import LibraryMachine
        from rosplc_st.run_project import load_texts

        texts = load_texts(folder) | {"Pass": PASS}
        self.machine = LibraryMachine(build(texts, None, Toolchain(flags=("-O1",))))
        self.machine.option("real_clock")
        self.errors: dict[str, set[int]] = {block: set() for block in BLOCKS}
        self.ready = self.ending = False

    def run(self) -> None:
        """Scan every 2 ms."""
        self.machine.start()
        while not self.ending:
            for program in ("SharedMemory_Read", "Pass", "SharedMemory_Write"):
                self.machine.scan(program, step=0)
            shown = {block: self.machine.get(f"{block}.udiError") for block in BLOCKS}
            writing = all(self.machine.get(f"{block}.xReady") for block in BLOCKS[1:])
            self.ready = self.ready or (writing and not any(shown.values()))
            for block in BLOCKS if self.ready else ():
                self.errors[block].add(shown[block])
            time.sleep(0.002)


@pytest.mark.foreign
def test_bridges_change_places_under_an_old_project(tmp_path: Path) -> None:
    """0.1.0, today's, and 0.1.0 again: the PLC's side sees a pause; nothing is torn, repeated or invented.

    Objects are adopted, but for that of a topic whose slots follow from a default that has changed.
    """
    pytest.importorskip("blark")
    pytest.importorskip("cyclonedds")
    prefix, domain = f"peers{secrets.token_hex(4)}", str(secrets.randbelow(90) + 10)
    place = {"ROS_DOMAIN_ID": domain, "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    config = tmp_path / "rosplc.yaml"
    # `depth` as 0.1.0 called it, and with its default.
    config.write_text(
        f"bridge: peers\nprefix: {prefix}\nros: {{distro: jazzy, backend: dds}}\ntopics:\n"
        f"  /in: {{type: {TYPE}, to: plc, stale_after: 500ms}}\n"
        f"  /out: {{type: {TYPE}, to: ros, depth: 4}}\n  /resized: {{type: {TYPE}, to: ros}}\n"
    )
    old, new = environment(), {**environment(), "PYTHONPATH": str(ROOT / "src")}
    generate = [sys.executable, "-m", "rosplc", "generate", str(config), "--out", str(tmp_path / "plc")]
    subprocess.run(generate, env=old, check=True, capture_output=True)
    plc = Plc(tmp_path / "plc" / "st")
    node = open_backend("dds", STORE, "peers", domain=int(domain), environment=place)
    codec = Codec(LAYOUT, Wire.CDR)
    came: dict[str, list[tuple[float, ...]]] = {"/out": [], "/resized": []}
    for topic, arrived in came.items():

        def receive(payload: bytes, *_: object, arrived: list[tuple[float, ...]] = arrived) -> None:
            arrived.append(struct.unpack("<3d", bytes(payload)[4:28]))

        node.subscribe(topic, TYPE, DEFAULT, receive)
    publisher = node.advertise("/in", TYPE, DEFAULT)
    sent = 0

    def flow() -> None:
        """Send until some more of what was sent since has come back over both topics."""
        nonlocal sent
        first, deadline = sent, time.monotonic() + WATCHDOG_S
        while any(not arrived or arrived[-1][0] < first + 50 for arrived in came.values()):
            assert time.monotonic() < deadline, "messages flow"
            sent += 1
            record = LAYOUT.pack({"x": float(sent), "y": -float(sent), "z": 0.5})
            publisher.write(codec.encode(record), time.time_ns())
            time.sleep(0.004)

    plc.start()
    generations: list[list[int]] = []
    try:
        for release in (old, new, old):
            with (tmp_path / "bridge.log").open("a") as log:
                command = [sys.executable, "-m", "rosplc", "run", str(config), "--status", "0"]
                bridge = subprocess.Popen(command, env={**release, **place}, stdout=log, stderr=log)
            try:
                flow()
                generations.append([])
                for topic in ("/in", *came):
                    with attach(Namespace(prefix), topic) as channel:
                        generations[-1].append(channel.identity.generation)
            finally:
                bridge.send_signal(signal.SIGTERM)
                assert bridge.wait(WATCHDOG_S) == 0, (tmp_path / "bridge.log").read_text()
    finally:
        plc.ending = True
        plc.join(WATCHDOG_S)
        node.close()
        for file in Path("/dev/shm").glob(f"{prefix}.*"):
            file.unlink()
    assert [len(set(each)) for each in zip(*generations, strict=True)] == [1, 1, 3]
    assert plc.errors["ROS_Read.in"] | plc.errors["ROS_Write.out"] <= {0, NO_BRIDGE}
    assert plc.errors["ROS_Write.resized"] <= {0, NO_BRIDGE, *REPLACED}
    for arrived in came.values():
        numbers = [x for x, _, _ in arrived]
        assert numbers == sorted(set(numbers)) and numbers[-1] <= sent
        assert all((y, z) == (-x, 0.5) for x, y, z in arrived)
