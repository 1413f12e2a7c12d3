"""The doctor on this very machine: beside killed bridges, living ones, a PLC, a ROS graph."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from rosplc.doctor import Question, examine
from rosplc.model import TypeStore
from rosplc.ros import Qos, open_backend
from rosplc.shm import Namespace, attach
from rosplc.virtual_plc import ReadBlock, WriteBlock
from tests.interop.graphs import LOCAL, free_domain
from tests.lib.waiting import wait_for

pytestmark = pytest.mark.verifies("doctor", own="simulation of each problem")

INT, LONG = "std_msgs/msg/Int32", "std_msgs/msg/Int64"
TOPICS = f"  /in: {{type: {INT}, to: plc}}\n  /out: {{type: {INT}, to: ros}}\n"
WATCHDOG_S = 100.0
Document = dict[str, Any]
ENVIRONMENT = {**os.environ, **LOCAL}


def rosplc(*arguments: object) -> subprocess.CompletedProcess[str]:
    done = subprocess.run(
        [sys.executable, "-m", "rosplc", *map(str, arguments)],
        capture_output=True,
        text=True,
        timeout=120,
        env=ENVIRONMENT,
    )
    assert "Traceback" not in done.stdout + done.stderr
    return done


def doctor(config: Path, code: Path | None = None) -> dict[str, list[Document]]:
    """Return findings by code, as JSON has them."""
    document = examine(Question(config, code, variables=ENVIRONMENT)).to_dict()
    found: dict[str, list[Document]] = {}
    for finding in document["findings"]:
        found.setdefault(finding["code"], []).append(finding)
    assert "DOC001" not in found and "DOC002" not in found, found
    return found


def of_machine(namespace: Namespace) -> list[Document]:
    """Return what the doctor says of a prefix's bridges without a configuration."""
    document = examine(Question(None, None, ros=False, variables=ENVIRONMENT)).to_dict()
    marker = f"(prefix {namespace.prefix})"
    return [f for f in document["findings"] if f["code"] == "DOC601" and marker in f["seen"]]


def levels(found: dict[str, list[Document]], code: str) -> list[str]:
    return [finding["level"] for finding in found.get(code, [])]


def shown(found: dict[str, list[Document]], codes: Document) -> Document:
    return {code: levels(found, code) for code in codes}


class Bridge:
    """`rosplc run` in a process of its own."""

    def __init__(self, config: Path, namespace: Namespace, topics: int = 2) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-m", "rosplc", "run", str(config), "--quiet"],
            env=ENVIRONMENT,
            stderr=subprocess.PIPE,
        )
        wait_for(lambda: len(namespace.topics()) == topics and self._beats(namespace), "the bridge")

    def _beats(self, namespace: Namespace) -> bool:
        assert self._process.poll() is None
        with attach(namespace, "/in") as found:
            return found.snapshot().writer.epoch != 0 and found.snapshot().writer.pid == self._process.pid

    def send(self, number: signal.Signals) -> None:
        self._process.send_signal(number)

    def end(self, number: signal.Signals = signal.SIGTERM) -> None:
        if self._process.poll() is None:
            self._process.send_signal(signal.SIGCONT)
            self._process.send_signal(number)
        self._process.communicate(timeout=WATCHDOG_S)


@pytest.fixture
def config(tmp_path: Path, shm_namespace: Namespace) -> Callable[..., Path]:
    def write(topics: str = TOPICS, ros: str = "{backend: memory}", name: str = "rosplc.yaml") -> Path:
        path = tmp_path / name
        path.write_text(f"bridge: cell\nprefix: {shm_namespace.prefix}\nros: {ros}\ntopics:\n{topics}")
        return path

    return write


@pytest.fixture
def bridges() -> Iterator[list[Bridge]]:
    running: list[Bridge] = []
    yield running
    for bridge in running:
        bridge.end(signal.SIGKILL)


def image(namespace: Namespace) -> dict[str, tuple[bytes, int, int]]:
    """Return every file of a prefix: content, mode, time of the last change."""
    result = {}
    for path in sorted(Path(namespace.directory).glob(f"{namespace.prefix}.*")):
        status = path.stat()
        result[path.name] = (path.read_bytes(), status.st_mode, status.st_mtime_ns)
    return result


@pytest.mark.foreign
def test_a_machine_alone() -> None:
    """Without a configuration the machine is examined, and the exit status says whether there is an error."""
    done = rosplc("doctor", "--json")
    document = json.loads(done.stdout)
    assert done.returncode == (1 if document["worst"] == "error" else 0)
    assert document["config"] is None and document["schema"] == 1
    areas = {finding["area"] for finding in document["findings"]}
    assert {"machine", "shared memory", "PLC runtime", "ROS environment"} <= areas
    assert "ROS graph" not in areas
    words = {"ok", "note", "warning", "error"}
    assert {finding["level"] for finding in document["findings"]} <= words == set(document["counts"])
    assert sum(document["counts"].values()) == len(document["findings"])


def test_a_wrong_configuration(config: Callable[..., Path]) -> None:
    """What is wrong with a configuration is a finding with file and line; the machine is examined too."""
    path = config(f"  /in: {{type: {INT}, too: plc}}\n")
    done = rosplc("doctor", path, "--json")
    assert done.returncode == 2
    findings = json.loads(done.stdout)["findings"]
    wrong = [finding for finding in findings if finding["code"] == "DOC501"]
    assert {finding["level"] for finding in wrong} == {"error"}
    assert any(f"{path}:5" in finding["seen"] for finding in wrong)
    assert any(finding["code"] == "DOC101" for finding in findings)
    assert levels(doctor(path.parent / "missing.yaml"), "DOC501") == ["error"]


@pytest.mark.foreign
def test_a_killed_bridge(
    config: Callable[..., Path], bridges: list[Bridge], shm_namespace: Namespace
) -> None:
    """What a killed bridge leaves is found and not touched; once the next bridge runs it is found no more."""
    path = config()
    bridges.append(Bridge(path, shm_namespace))
    bridges[-1].end(signal.SIGKILL)
    before = image(shm_namespace)
    found = doctor(path)
    assert image(shm_namespace) == before
    assert levels(found, "DOC205") == ["note"] and levels(found, "DOC601") == ["note"]
    assert found["DOC205"][0]["command"].endswith(f"--prefix {shm_namespace.prefix}")
    assert levels(doctor(config(TOPICS.splitlines()[0], name="other.yaml")), "DOC206") == ["warning"]
    bridges.append(Bridge(path, shm_namespace))
    fine = {"DOC205": ["ok"], "DOC601": ["ok"]}
    wait_for(lambda: shown(doctor(path), fine) == fine, "the next bridge to beat")


@pytest.mark.foreign
def test_a_bridge_that_stands_still(
    config: Callable[..., Path], bridges: list[Bridge], shm_namespace: Namespace
) -> None:
    """A bridge that is stopped holds its objects and does not beat; one that goes on is fine again."""
    path = config()
    bridges.append(Bridge(path, shm_namespace))
    # One that was stopped before its first beat would count as starting, for half a minute.
    wait_for(lambda: levels(doctor(path), "DOC601") == ["ok"], "the bridge to beat")
    bridges[-1].send(signal.SIGSTOP)
    wait_for(lambda: "error" in levels(doctor(path), "DOC601"), "the stop to be noticed")
    # On a busy machine a look at every object that there is may end before it has come to this one.
    (stands,) = wait_for(lambda: of_machine(shm_namespace), "the stopped bridge to be named")
    assert stands["level"] == "error" and "has no heartbeat" in stands["seen"]
    assert f"bridge cell (prefix {shm_namespace.prefix})" in stands["seen"]
    assert "SIGSTOP" in stands["seen"]
    bridges[-1].send(signal.SIGCONT)
    wait_for(lambda: [f["level"] for f in of_machine(shm_namespace)] == ["ok"], "the bridge to be fine again")
    wait_for(lambda: levels(doctor(path), "DOC601") == ["ok"], "the bridge to beat")


@pytest.mark.foreign
def test_an_older_configuration_runs(
    config: Callable[..., Path], bridges: list[Bridge], shm_namespace: Namespace
) -> None:
    """A bridge that runs on an older configuration is named, with what differs."""
    bridges.append(Bridge(config(), shm_namespace))
    newer = config(TOPICS.replace("Int32", "Int64", 1), name="newer.yaml")
    (finding,) = doctor(newer)["DOC602"]
    assert finding["level"] == "error" and "/in" in finding["seen"]
    assert f"type {INT} instead of {LONG}" in finding["seen"]


@pytest.mark.foreign
def test_a_classic_topic(
    config: Callable[..., Path], bridges: list[Bridge], shm_namespace: Namespace
) -> None:
    """A bridge holds a classic topic as well as another, and leaves memory and lock in order."""
    name = f"{shm_namespace.prefix.lower()}_old"
    text = f"  /in: {{type: {INT}, to: plc}}\n  /old: {{type: {INT}, to: plc, classic: {{name: {name}}}}}\n"
    path = config(text)
    try:
        assert levels(doctor(path), "DOC601") == ["note"]
        bridges.append(Bridge(path, shm_namespace, 1))
        fine = {code: ["ok"] for code in ("DOC214", "DOC215", "DOC216", "DOC217", "DOC601")}
        wait_for(lambda: shown(doctor(path), fine) == fine, "the bridge to hold both")
        bridges[-1].end()
        assert levels(doctor(path), "DOC601") == ["note"]
    finally:
        for bridge in bridges:
            bridge.end()
        for left in (name, f"sem.{name}", f"rosplc.classic.{name}"):
            (Path(shm_namespace.directory) / left).unlink(missing_ok=True)


@pytest.mark.foreign
def test_generated_code(config: Callable[..., Path], bridges: list[Bridge], shm_namespace: Namespace) -> None:
    """Generated code is compared with configuration and running bridge; a changed limit is named."""
    text = "  /in: {type: std_msgs/msg/String, to: plc, limits: {data: 40}}\n"
    path = config(text)
    folder = path.parent / "generated"
    rosplc("generate", path, "--out", folder)
    bridges.append(Bridge(path, shm_namespace, 1))
    found = doctor(path, folder)
    assert [levels(found, code) for code in ("DOC702", "DOC703", "DOC706", "DOC708")] == [["ok"]] * 4
    newer = config(text.replace("40", "20"), name="newer.yaml")
    found = doctor(newer, folder)
    assert levels(found, "DOC702") == ["error"] and levels(found, "DOC703") == ["ok"]
    assert "`data : STRING(40)` in the code, `data : STRING(20)` expected" in found["DOC702"][0]["seen"]
    rosplc("generate", newer, "--out", folder)
    found = doctor(newer, folder)
    assert levels(found, "DOC702") == ["ok"] and levels(found, "DOC703") == ["error"]


class Plc:
    """A PLC that calls its blocks until it is stopped."""

    def __init__(self, prefix: str) -> None:
        self._stop = threading.Event()
        self.blocks = [ReadBlock("/in", prefix=prefix), WriteBlock("/out", prefix=prefix)]
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self) -> None:
        while not self._stop.wait(0.005):
            for block in self.blocks:
                block()

    def __enter__(self) -> Plc:
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()
        for block in self.blocks:
            block.close()


@pytest.mark.foreign
def test_everything_runs(
    config: Callable[..., Path], bridges: list[Bridge], shm_namespace: Namespace
) -> None:
    """Beside a robot, a bridge and a PLC that agree nothing is wrong; what the robot changes is named."""
    pytest.importorskip("cyclonedds", reason="cyclonedds has no wheel here")
    with free_domain() as domain:
        path = config(ros=f"{{backend: dds, domain: {domain}}}")
        robot = open_backend("dds", TypeStore.bundled("jazzy"), "robot", domain=domain, environment=LOCAL)
        try:
            sends = robot.advertise("/in", INT, Qos())
            hears = robot.subscribe("/out", INT, Qos(), lambda *_: None)
            bridges.append(Bridge(path, shm_namespace))
            with Plc(shm_namespace.prefix) as plc:
                wait_for(lambda: all(not block.udiError for block in plc.blocks), "the PLC")
                wait_for(lambda: sends.matched == 1 and hears.matched == 1, "the bridge's endpoints")
                codes = ("DOC510", "DOC516", "DOC517", "DOC601", "DOC602", "DOC603", "DOC604")
                fine = {code: ["ok"] for code in codes} | {"DOC511": ["ok", "ok"]}
                seen: Document = {}
                # On a busy machine discovery may take longer than a look.
                wait_for(lambda: seen.update(doctor(path)) or shown(seen, fine) == fine, str(fine))
                assert sends.matched == hears.matched == 1  # the doctor is nobody's peer
            sends.close()
            hears.close()
            robot.advertise("/in", LONG, Qos())
            robot.subscribe("/out2", INT, Qos(), lambda *_: None)
            odd = {"DOC512": ["error"], "DOC515": ["warning"], "DOC603": ["warning"]}
            wait_for(lambda: seen.update(doctor(path)) or shown(seen, odd) == odd, str(odd))
            assert (
                f"node /robot publishes /in as {LONG}, but the local type is {INT}"
                in seen["DOC512"][0]["seen"]
            )
        finally:
            robot.close()


@pytest.mark.foreign
def test_paper(config: Callable[..., Path]) -> None:
    """For people it fits 80 columns but for commands, has the problems first, and ends with a count."""
    path = config()
    lines = rosplc("doctor", path).stdout.splitlines()
    assert all(len(line) <= 80 for line in lines if not line.lstrip().startswith("$ "))
    assert lines[-1].endswith(" passed") and " errors, " in lines[-1]
    assert any("[DOC601]" in line for line in lines)
    worst = [line[2:10].strip() for line in lines if line[2:10].strip() in ("error", "warning", "note", "ok")]
    assert "ok" in worst and worst.index("ok") > 0
    every = rosplc("doctor", path, "--all").stdout
    assert every.count("  ok ") > "\n".join(lines).count("  ok ")
