"""Parts of the doctor that the table of cases does not show: words, details, order, failures."""

from __future__ import annotations

import json
import os
import socket
import subprocess
import threading
from pathlib import Path

import pytest

from rosplc.config import Project
from rosplc.doctor import Area, Level, Question, Report, examination
from rosplc.doctor.code import against_config, read_generated
from rosplc.doctor.examination import Probe, run_probe
from rosplc.doctor.graph import Graph, judge_graph, see_graph
from rosplc.doctor.kinds import fine, found
from rosplc.doctor.machine import backend, logout, needed
from rosplc.doctor.network import answers, is_local, master, receive_buffers
from rosplc.doctor.rights import File, find_runtimes, may_use, rights, runtimes, same_memory, shm_mount
from rosplc.errors import BackendError
from rosplc.plc.build import plc_project
from rosplc.plc.delivery import project_files, write_files
from rosplc.plc.plan import ProjectOptions
from rosplc.ros import EndpointInfo, GraphInfo, Qos, memory
from rosplc.ros.buffers import cyclone_buffer
from rosplc.shm import Namespace
from tests.unit.doctor.cases import wanted
from tests.unit.doctor.stage import OTHER_MOUNT, Stage, problems

INT, LONG, STRING = "std_msgs/msg/Int32", "std_msgs/msg/Int64", "std_msgs/msg/String"


@pytest.fixture
def stage(tmp_path: Path, shm_namespace: Namespace) -> Stage:
    return Stage(tmp_path, shm_namespace)


def test_what_was_found_before_a_failure_is_kept() -> None:
    """An examination that fails half way keeps what it has found, and says why it could not go on."""

    def look():
        yield fine("DOC101", "a kernel")
        raise PermissionError(13, "Permission denied", "/proc/1/exe")

    first, second = run_probe(Probe("it", Area.MACHINE, look))
    assert first.level is Level.OK
    assert (second.code, second.level) == ("DOC001", Level.WARNING)
    assert second.seen == "could not check it: Permission denied: /proc/1/exe"


def test_a_vital_examination_that_fails_is_an_error() -> None:
    """A configuration that cannot be examined at all does not end in a good exit status."""

    def look():
        raise PermissionError(13, "Permission denied", "rosplc.yaml")
        yield

    (finding,) = run_probe(Probe("the configuration", Area.CONFIG, look, vital=True))
    assert (finding.code, finding.level) == ("DOC001", Level.ERROR)


def test_an_examination_that_hangs_is_given_up() -> None:
    """What hangs is left behind with what it had found; the next examination is done."""
    forever = threading.Event()

    def look():
        yield fine("DOC101", "a kernel")
        forever.wait(30)

    seen = run_probe(Probe("it", Area.MACHINE, look, 0.2))
    forever.set()
    assert [each.code for each in seen] == ["DOC101", "DOC002"]
    assert "could not check it: no result within 0.2 s" in seen[1].seen


def test_a_look_at_the_graph_that_hangs_is_ended(stage: Stage, monkeypatch: pytest.MonkeyPatch) -> None:
    """The process that looks at the graph is killed after its time."""
    monkeypatch.setattr("rosplc.doctor.graph._PROGRAM", "import time; time.sleep(60)")
    monkeypatch.setattr("rosplc.doctor.graph._START_S", 0.2)
    probe = Probe("the graph", Area.GRAPH, lambda: see_graph(stage.root / "x.yaml", 0.1, {}) and ())  # type: ignore[func-returns-value]
    (finding,) = run_probe(probe)
    assert finding.code == "DOC002" and "did not finish" in finding.seen


def test_a_look_at_the_graph_that_crashes_is_told(stage: Stage, monkeypatch: pytest.MonkeyPatch) -> None:
    """A middleware that takes its process with it costs the look, and its last words are shown."""
    program = "import os, sys; sys.stderr.write('no interface\\n'); sys.stderr.flush(); os.abort()"
    monkeypatch.setattr("rosplc.doctor.graph._PROGRAM", program)
    with pytest.raises(BackendError, match="no interface"):
        see_graph(stage.root / "x.yaml", 0.1, {})


def test_problems_come_first() -> None:
    """The area with the worst finding stands first, and in it the worst finding."""
    report = Report(
        (
            fine("DOC101", "fine"),
            found("DOC603", "idle"),
            fine("DOC601", "held"),
            found("DOC602", "differs"),
            found("DOC305", "container"),
        )
    )
    assert [area for area, _ in report.areas()] == [Area.LIVE, Area.PLC, Area.MACHINE]
    assert [finding.code for finding in report.areas()[0][1]] == ["DOC602", "DOC603", "DOC601"]
    assert report.worst is Level.ERROR
    assert report.counts() == {"error": 1, "warning": 1, "note": 1, "ok": 2}
    assert list(json.loads(json.dumps(report.to_dict()))) == [
        "schema", "rosplc", "config", "worst", "counts", "findings",
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("theirs", "qos"), [(LONG, Qos()), (INT, Qos(reliability="best_effort")), (INT, Qos())]
)
def test_the_reasons_are_the_bridges(stage: Stage, theirs: str, qos: Qos) -> None:
    """What keeps a publisher from the bridge is said in the words that the bridge's status has."""
    project = stage.project(f"  /in: {{type: {INT}, to: plc}}\n")
    plan = project.topics[0]
    domain = 73
    robot = memory.open_backend(project.store, "robot", "/", domain)
    bridge = memory.open_backend(project.store, "rosplc_cell", "/", domain)
    observer = memory.open_backend(project.store, "rosplc_doctor", "/", domain)
    try:
        robot.advertise("/in", theirs, qos)
        subscription = bridge.subscribe("/in", plan.type_name, plan.qos, lambda *_: None)
        status = subscription.status()
        graph = Graph("memory", observer.graph(), {"/in": "/in"}, "/rosplc_cell", "domain 73")
        found = problems(judge_graph(graph, [plan], project.store.type_hash, bridge_runs=True))
    finally:
        for each in (robot, bridge, observer):
            each.close()
    said = [finding.seen for finding in found.values()]
    if status.code:
        assert said and status.reason in said[0] and said[0].endswith(f"[{status.code}]")
    else:
        assert not said


def test_services_and_actions_are_compared_with_the_graph(tmp_path, shm_namespace):
    """A second server of what the PLC serves, another type, and an action's service of ROS 2."""
    calls = "{/grip: {type: std_srvs/Trigger, server: ros}, /start: {type: std_srvs/SetBool, server: plc}}"
    action = "{/arm/move: {type: tf2_msgs/action/LookupTransform, server: ros}}"
    stage = Stage(tmp_path, shm_namespace)
    project = stage.project("  /in: {type: std_msgs/msg/Int32, to: plc}\n", services=calls, actions=action)

    def judged(*ends):
        services = tuple(EndpointInfo(name, kind, "in", node, Qos()) for name, kind, node in ends)
        graph = Graph("dds", GraphInfo(("/robot",), services=services), {}, "/rosplc_cell", "domain 0")
        return problems(judge_graph(graph, (), project.store.type_hash, project.calls, bridge_runs=False))

    move = ("/arm/move/_action/send_goal", "tf2_msgs/action/LookupTransform_SendGoal", "/robot")
    grip = ("/grip", "std_srvs/srv/Trigger", "/robot")
    assert judged(move, grip, ("/start", "std_srvs/srv/SetBool", "/rosplc_cell")) == {}
    assert "the action /arm/move" in judged(grip)["DOC519"].seen
    both = judged(move, grip, ("/start", "std_srvs/srv/SetBool", "/robot"))["DOC520"]
    assert "which the PLC also serves" in both.seen
    assert "std_srvs/srv/Empty" in judged(move, ("/grip", "std_srvs/srv/Empty", "/robot"))["DOC512"].seen


def test_settings_that_ros_does_not_have_are_named(stage: Stage) -> None:
    """What keeps a peer from matching beyond ROS's own settings is told as the bridge tells it."""
    project = stage.project(f"  /in: {{type: {INT}, to: plc}}\n")
    own = project.store.type_hash(INT)
    end = EndpointInfo("/in", INT, "out", "/robot", Qos(), own, ("it is in the partition lab",))
    graph = Graph("dds", GraphInfo(("/robot",), (end,)), {}, "/rosplc_cell", "domain 0")
    finding = problems(judge_graph(graph, project.topics, lambda name: own, bridge_runs=False))["DOC514"]
    assert finding.seen.endswith(f"as {INT}, but it is in the partition lab [ROS004]")


def test_the_bridges_own_topics_are_not_proposed(stage: Stage) -> None:
    """A topic that only the bridge has, or that the configuration has already, is not what was meant."""
    project = stage.project(f"  /in: {{type: {INT}, to: plc}}\n  /cell/in: {{type: {INT}, to: ros}}\n")
    ends = (
        EndpointInfo("/cell/in", INT, "in", "/robot", Qos()),
        EndpointInfo("/old/in", INT, "out", "/rosplc_cell", Qos()),
    )
    info = GraphInfo(("/robot",), ends, {end.topic: (INT,) for end in ends})
    names = {plan.topic: plan.topic for plan in project.topics}
    graph = Graph("dds", info, names, "/rosplc_cell", "domain 0")
    found = judge_graph(graph, project.topics, lambda name: "", bridge_runs=False)
    assert "DOC515" not in {finding.code for finding in found}


@pytest.mark.parametrize("fenced", [True, False])
@pytest.mark.parametrize("pins", [True, False])
def test_every_delivery_is_read(stage: Stage, fenced: bool, pins: bool) -> None:
    """Topics, calls, directions, layouts, prefix and rule are read out of whatever is generated."""
    long = "/" + "/".join(["a_rather_long_name"] * 6)
    project = stage.project(
        f"  {long}: {{type: {INT}, to: plc}}\n  /text: {{type: {STRING}, to: ros, limits: {{data: 9}}}}\n"
        f"  /again: {{type: {STRING}, to: ros, limits: {{data: 12}}}}\n"
        f"  /old: {{type: {INT}, to: ros, classic: {{name: old.one, semaphore: none}}}}\n"
        f"services:\n  /start: {{type: std_srvs/srv/SetBool, server: plc}}\n"
        f"  {long}: {{type: std_srvs/srv/Trigger, server: ros, clients: [pick, place]}}\n"
        "actions:\n  /fib: {type: example_interfaces/action/Fibonacci, server: ros}\n"
        "  /own: {type: example_interfaces/action/Fibonacci, server: plc, limits: {result.sequence: 3}}\n"
    )
    files = project_files(plc_project(project, ProjectOptions(fenced=fenced, pins=pins)), [], "rosplc")
    write_files(stage.root / "out", files)
    for folder in (stage.root / "out", stage.root / "out/st"):
        found = read_generated(folder)
        assert (found.prefix, found.fenced) == (stage.namespace.prefix, fenced)
        read = {
            (block.use, block.label, block.to_plc, block.layout_id, block.record_size)
            for block in found.blocks
        }
        assert read == {
            (each.use, each.name, each.direction == 1, each.layout.layout_id, each.layout.size)
            for each in wanted(project)
            if each.use != "/old"
        } | {("old.one", "old.one", False, "", project.topic("/old").layout.size)}


def test_blocks_of_services_are_compared_with_the_configuration(stage: Stage) -> None:
    """A use that has no block, a block without a use, and another layout are found, each by its name."""

    def project(uses: str, limit: int) -> Project:
        entry = f"type: std_srvs/srv/Trigger, server: ros, clients: [{uses}]"
        limits = f"limits: {{response.message: {limit}}}"
        return stage.project(f"  /in: {{type: {INT}, to: plc}}\nservices:\n  /close: {{{entry}, {limits}}}\n")

    before, now = project("pick, place", 20), project("pick, stack", 40)
    write_files(stage.root / "out", project_files(plc_project(before, ProjectOptions()), [], "rosplc"))
    code, prefix = read_generated(stage.root / "out"), stage.namespace.prefix
    assert not problems(against_config(code, wanted(before), prefix, ""))
    found = problems(against_config(code, wanted(now), prefix, ""))
    assert {each: found[each].seen.partition(" layout")[0] for each in found} == {
        "DOC702": "/close response pick:",
        "DOC704": "the code has no block for service /close stack",
        "DOC705": "the configuration has no entry for these blocks of the code: service /close place",
    }


@pytest.mark.parametrize("path", ["Base/RosPlc_Settings.st", "Blocks/std_msgs_Int32_Read.st"])
def test_code_that_is_damaged_is_an_error(stage: Stage, path: str) -> None:
    """A file that is missing or says nothing is named; no layout is made up."""
    project = stage.project(f"  /in: {{type: {INT}, to: plc}}\n")
    write_files(stage.root / "out", project_files(plc_project(project, ProjectOptions()), [], "rosplc"))
    file = stage.root / "out/st" / path
    file.write_bytes(b"\xff\0nothing")
    with pytest.raises(ValueError, match=file.name):
        read_generated(stage.root / "out")
    file.unlink()
    with pytest.raises(ValueError, match=f"{file.name} cannot be read"):
        read_generated(stage.root / "out")


@pytest.mark.parametrize(
    ("file", "uid", "gids", "may"),
    [
        (File("x", 0, 0, 0o600), 0, frozenset({0}), True),
        (File("x", 5, 5, 0o600), 0, frozenset(), True),
        (File("x", 5, 6, 0o060), 5, frozenset({6}), False),  # the owner's bits count for the owner
        (File("x", 5, 6, 0o660), 7, frozenset({6}), True),
        (File("x", 5, 6, 0o640), 7, frozenset({6}), False),
        (File("x", 5, 6, 0o606), 7, frozenset({6}), False),  # and the group's for its members
        (File("x", 5, 6, 0o606), 7, frozenset({8}), True),
    ],
)
def test_rights_are_the_kernels(file: File, uid: int, gids: frozenset[int], may: bool) -> None:
    """Whether a user may read and write follows owner, then group, then others."""
    assert may_use(file, uid, gids) is may


def test_the_remedy_for_rights_names_the_group() -> None:
    """Where a group would do, the command puts the user into it; otherwise it makes one."""
    (finding,) = rights([File("/in", 500, 4294967, 0o660)], 1234567, frozenset())
    assert finding.command == "sudo usermod --append --groups group 4294967 user 1234567"
    (finding,) = rights([File("/in", 0, 0, 0o660)], 1234567, frozenset())
    assert finding.command.startswith("sudo groupadd --force plc && ")


def test_a_web_server_is_no_master() -> None:
    """Something that takes connections where a master should be is not taken for one."""
    (finding,) = master(
        "http://robot:11311", call=lambda host, port: "", ask=lambda uri: "its answer is none"
    )
    assert (finding.code, finding.level) == ("DOC408", Level.WARNING)
    assert "is not a ROS master: its answer is none" in finding.seen
    (finding,) = master("robot:11311")
    assert (finding.code, finding.level) == ("DOC403", Level.ERROR)


def test_who_answers_is_asked_for_real() -> None:
    """A port that listens answers; one that nobody holds does not, with the reason."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
        assert answers("127.0.0.1", port) == ""
    assert "refused" in answers("127.0.0.1", port)
    assert is_local("127.0.0.1") and not is_local("192.0.2.1")


def test_processes_are_found_by_their_names(stage: Stage) -> None:
    """A runtime is found by program or name, cut off or not, with word size, user, groups and mount."""
    stage.process(20, name="codesyscontrol.bin", bits=32, uid=7, groups=(8, 9), mount=OTHER_MOUNT)
    stage.process(10, name="CODESYSControl_arm_very_long")
    stage.process(30, name="bash")
    stage.file("proc/cpuinfo", "")
    stage.file("proc/40/comm", "codesyscontrol")  # it is ending
    first, second = find_runtimes(stage.root / "proc")
    assert (first.pid, second.pid) == (10, 20)
    assert (second.bits, second.uid, second.gids) == (32, 7, {7, 8, 9})
    assert second.shm is not None and second.shm.device == "0:99 /"


def test_a_narrow_runtime_matters_where_a_lock_is_shared(stage: Stage) -> None:
    """A 32-bit runtime is worth a note; with a classic topic's semaphore it is an error."""
    stage.process(bits=32)
    found = find_runtimes(stage.root / "proc")
    levels = [problems(runtimes(found, 64, classic=classic))["DOC302"].level for classic in (False, True)]
    assert levels == [Level.NOTE, Level.ERROR]


def test_the_last_mount_covers_the_others(stage: Stage) -> None:
    """Of several mounts the one that is seen counts; without one at /dev/shm it is the parent's."""
    path = stage.file(
        "mountinfo", "1 0 8:1 / / rw - ext4 x rw\n" + OTHER_MOUNT + OTHER_MOUNT.replace("99", "27")
    )
    mount = shm_mount(path)
    assert mount is not None and (mount.device, mount.point) == ("0:27 /", "/dev/shm")
    path.write_text("1 0 8:1 / / ro - ext4 x rw\nnonsense\n")
    mount = shm_mount(path)
    assert mount is not None and (mount.point, mount.read_only) == ("/", True)


def test_a_mount_namespace_of_its_own_is_seen(stage: Stage) -> None:
    """A process with another /dev/shm, as in a container, is told from one with the same."""
    own = shm_mount(Path("/proc/self/mountinfo"))
    script = "mount -t tmpfs tmpfs /dev/shm && echo ready && exec sleep 60"
    with subprocess.Popen(
        ["unshare", "--mount", "sh", "-c", script],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    ) as other:
        try:
            assert other.stdout is not None
            if other.stdout.readline() != "ready\n":
                pytest.skip("this user may not make a mount namespace")
            for pid in (other.pid, os.getpid()):
                stage.process(pid, mount=Path(f"/proc/{pid}/mountinfo").read_text())
        finally:
            other.kill()
    found = find_runtimes(stage.root / "proc")
    seen = {each.pid: bool(problems(same_memory([each], own))) for each in found}
    assert seen == {other.pid: True, os.getpid(): False}


@pytest.mark.parametrize(
    ("uid", "linger", "found"),
    [(1000, False, True), (999, False, False), (1000, True, False), (65534, False, False)],
)
def test_log_out_concerns_people(stage: Stage, uid: int, linger: bool, found: bool) -> None:
    """Only an ordinary user who does not linger loses objects at log-out."""
    (stage.root / "run/systemd/seats").mkdir(parents=True)
    if linger:
        stage.file("var/lib/systemd/linger/erika")
    assert ("DOC106" in problems(logout(stage.root, uid, "erika"))) is found


def test_auto_says_why() -> None:
    """The finding about `auto` names the backend, the reason, and what could be used."""
    (finding,) = backend("jazzy", "auto", {"RMW_IMPLEMENTATION": "rmw_zenoh_cpp"}, missing=lambda name: "")
    assert "backend auto selects zenoh, because RMW_IMPLEMENTATION is rmw_zenoh_cpp" in finding.seen
    (finding,) = backend("noetic", "auto", {}, configured=False, missing=lambda name: "no module")
    assert finding.level is Level.WARNING and "reinstall rosplc" in finding.remedy


def test_needed_packages_are_those_of_the_metadata() -> None:
    """The packages that have to be there are read from rosplc's own metadata."""
    assert {"rosbags", "pydantic", "PyYAML", "typer", "rich"} <= set(needed())
    assert "cyclonedds" not in needed()


def test_the_plc_of_another_user(stage: Stage) -> None:
    """A runtime's user that may not open what the configuration would make is an error before it is made."""
    stage.process(uid=7654321, groups=(7654321,))
    path = stage.file(
        "rosplc.yaml", f"prefix: {stage.namespace.prefix}\ntopics:\n  /in: {{type: {INT}, to: plc}}\n"
    )
    for name in ("proc/locks", "proc/self/mountinfo", "proc/self/status"):
        stage.file(name, Path("/", name).read_text())
    stage.file("sys/class/net/lo/flags", "0x9\n")
    question = Question(path, ros=False, root=stage.root)
    found = problems(examination.examine(question).findings)
    assert "DOC001" not in found
    assert "user 7654321 may not open /in" in found["DOC303"].seen


def test_an_unknown_plc_user_is_named(stage: Stage) -> None:
    """A user that this machine does not have is an error of its own."""
    path = stage.file("rosplc.yaml", f"prefix: {stage.namespace.prefix}\n")
    question = Question(path, plc_user="no-such-user", ros=False)
    assert "'no-such-user' does not exist" in problems(examination.examine(question).findings)["DOC303"].seen


@pytest.mark.parametrize(
    ("direction", "qos", "cyclone", "level"),
    [
        ("ros", "reliable", True, Level.NOTE),
        ("ros", "best_effort", True, Level.WARNING),
        # Cyclone's own sockets ask for 1 MiB, of which the kernel allows twice rmem_max here.
        ("plc", "best_effort", True, Level.OK),
        ("plc", "best_effort", False, Level.WARNING),
    ],
)
def test_receive_buffers(stage: Stage, direction: str, qos: str, cyclone: bool, level: Level) -> None:
    """Sizes, buffer and remedy are named; only messages that are not sent again are lost."""
    for name in ("rmem_default", "rmem_max"):
        stage.file(f"proc/sys/net/core/{name}", "212992\n")
    # frame_id, encoding and header take part; the encapsulation and the padding too.
    settings = f"to: {direction}, qos: {{reliability: {qos}}}, limits: {{data: 300000}}"
    project = stage.project(f"  /image: {{type: sensor_msgs/msg/Image, {settings}}}\n")
    (finding,) = receive_buffers(project.topics, stage.root, cyclone=cyclone)
    assert (finding.code, finding.level) == ("DOC411", level)
    if level:
        size = int(finding.seen.partition("up to ")[2].partition(" ")[0])
        assert 300_000 < size < 301_000 and "buffer 212992" in finding.seen
        assert finding.command == "sudo sysctl -w net.core.rmem_default=4194304 net.core.rmem_max=4194304"


def test_receive_buffers_that_are_not_visible(stage: Stage) -> None:
    """A container may hide the settings; that is no good result."""
    (finding,) = receive_buffers((), stage.root, cyclone=True)
    assert (finding.code, finding.level) == ("DOC003", Level.NOTE)


@pytest.mark.parametrize(
    ("default", "most", "ours"),
    [(212_992, 212_992, 425_984), (212_992, 4 << 20, 2 << 20), (4 << 20, 4 << 20, 4 << 20), (0, 0, 0)],
)
def test_cyclone_asks_for_a_larger_buffer(stage: Stage, default: int, most: int, ours: int) -> None:
    """Cyclone asks for 1 MiB where the default is smaller; the kernel doubles it, within rmem_max."""
    stage.file("proc/sys/net/core/rmem_default", f"{default}\n")
    stage.file("proc/sys/net/core/rmem_max", f"{most}\n")
    assert cyclone_buffer(stage.root) == ours
