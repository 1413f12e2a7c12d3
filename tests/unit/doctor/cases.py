"""For each kind of finding: a machine that has the problem, and the same machine without it.

The left column must give the finding, the right one must not. ``test_findings.py`` runs both, and
fails if a kind of the doctor's table is missing here.
"""

from __future__ import annotations

import errno
import os
import resource
import struct
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from importlib.metadata import PackageNotFoundError
from pathlib import Path

from rosplc.config import Project
from rosplc.doctor import (
    Finding,
    Question,
    code,
    examination,
    graph,
    leftovers,
    machine,
    network,
)
from rosplc.doctor import objects as objects_
from rosplc.doctor import rights as rights_
from rosplc.doctor.code import read_generated
from rosplc.doctor.examination import Probe, run_probe
from rosplc.doctor.finding import Area
from rosplc.doctor.graph import Graph
from rosplc.doctor.network import Wish
from rosplc.doctor.objects import Objects, look_at_objects
from rosplc.doctor.rights import File, Mount, find_runtimes
from rosplc.errors import BackendError
from rosplc.proc import held_files
from rosplc.ros import EndpointInfo, GraphInfo, Qos
from rosplc.shm import Direction, OwnedChannel
from rosplc.shm.constants import IDENTITY
from tests.lib.channels import LAYOUT, open_channel
from tests.unit.doctor.stage import OTHER_MOUNT, Stage, space, variables

Look = Callable[[Stage], Iterable[Finding]]
CASES: dict[str, tuple[Look, Look]] = {}

INT = "std_msgs/msg/Int32"
TOPICS = f"  /in: {{type: {INT}, to: plc}}\n  /out: {{type: {INT}, to: ros}}\n"
CLASSIC = f"  /old: {{type: {INT}, to: plc, classic: {{name: NAME, semaphore: NAME}}}}\n"
ROS2 = Wish("jazzy", False, "dds", None)
ROS1 = Wish("noetic", True, "rospy", None)
TMPFS = Mount("0:27 /", "tmpfs", "/dev/shm")


def case(code: str, sick: Look, well: Look) -> None:
    assert code not in CASES
    CASES[code] = (sick, well)


def _fail() -> Iterable[Finding]:
    raise OSError(errno.EIO, "Input/output error", "/dev/shm")


def _hang() -> Iterable[Finding]:
    time.sleep(30)
    return ()


def _probe(look: Callable[[], Iterable[Finding]], seconds: float = 0.05) -> list[Finding]:
    return run_probe(Probe("it", Area.MACHINE, look, seconds))


case("DOC001", lambda s: _probe(_fail), lambda s: _probe(tuple, 10.0))
case("DOC002", lambda s: _probe(_hang), lambda s: _probe(tuple, 10.0))

# The machine.

case(
    "DOC101",
    lambda s: machine.architecture("s390x", "6.1", bits=64, byte_order="big"),
    lambda s: machine.architecture("aarch64", "6.1", bits=64),
)
case(
    "DOC102",
    lambda s: machine.architecture("aarch64", "6.1", bits=32),
    lambda s: machine.architecture("armv7l", "6.1", bits=32),
)
case("DOC103", lambda s: machine.clock(3600.0), lambda s: machine.clock(time.time()))
case(
    "DOC104",
    lambda s: machine.open_files(256, 300),
    lambda s: machine.open_files(resource.RLIM_INFINITY, 300),
)
case(
    "DOC105",
    lambda s: machine.real_time(0, 8 << 20, 0),
    lambda s: machine.real_time(0, 8 << 20, 1 << 14 | 1 << 23),
)


def _logind(stage: Stage, text: str, uid: int = 1000) -> Iterable[Finding]:
    (stage.root / "run/systemd/seats").mkdir(parents=True)
    stage.file("etc/systemd/logind.conf", "[Login]\n#RemoveIPC=no\n")
    stage.file("etc/systemd/logind.conf.d/ipc.conf", text)
    return machine.logout(stage.root, uid, "erika")


case("DOC106", lambda s: _logind(s, "[Login]\n"), lambda s: _logind(s, "[Login]\nRemoveIPC=no\n"))


def _version(name: str) -> str:
    if name == "rosbags":
        raise PackageNotFoundError(name)
    return "1.0"


case(
    "DOC110",
    lambda s: machine.packages(["PyYAML", "rosbags"], "3.11.2", "0.1", version_of=_version),
    lambda s: machine.packages(["PyYAML"], "3.11.2", "0.1", version_of=_version),
)
case("DOC111", lambda s: machine.wheels("aarch64", (3, 11)), lambda s: machine.wheels("x86_64", (3, 11)))
case(
    "DOC112",
    lambda s: machine.backend("jazzy", "auto", {}, missing=lambda name: "no module"),
    lambda s: machine.backend("jazzy", "auto", {}, missing=lambda name: ""),
)
case(
    "DOC113",
    lambda s: machine.backend("jazzy", "zenoh", {}, missing=lambda name: "no module"),
    lambda s: machine.backend("jazzy", "zenoh", {}, missing=lambda name: ""),
)

# Shared memory.

case(
    "DOC201",
    lambda s: machine.mounted(Path("/dev/shm"), Mount("8:1 /", "ext4", "/")),
    lambda s: machine.mounted(Path("/dev/shm"), TMPFS),
)


def _mode(stage: Stage, bits: int) -> Iterable[Finding]:
    folder = stage.root / "shm"
    folder.mkdir()
    folder.chmod(bits)
    return machine.mode(folder, writable=True)


case("DOC202", lambda s: _mode(s, 0o755), lambda s: _mode(s, 0o1777))
MIB = 1 << 20
case(
    "DOC203",
    lambda s: machine.room(Path("/dev/shm"), space(64 * MIB, 60 * MIB), 80 * MIB, 0),
    lambda s: machine.room(Path("/dev/shm"), space(64 * MIB, 60 * MIB), 80 * MIB, 30 * MIB),
)
case(
    "DOC204",
    lambda s: machine.room(Path("/dev/shm"), space(64 * MIB, 4 * MIB), MIB, 0),
    lambda s: machine.room(Path("/dev/shm"), space(64 * MIB, 40 * MIB), MIB, 0),
)


def _objects(stage: Stage) -> Objects:
    held = held_files(Path("/proc"))
    return look_at_objects(Path(stage.namespace.directory), held, prefix=stage.namespace.prefix, seconds=0.2)


def _left(stage: Stage, configured: set[Path] | None = None) -> Iterable[Finding]:
    return list(leftovers.leftovers(_objects(stage), stage.namespace.prefix, configured))


def _closed(stage: Stage) -> OwnedChannel:
    channel = open_channel(stage.namespace)
    channel.close()
    return channel


def _open(stage: Stage) -> OwnedChannel:
    channel = open_channel(stage.namespace)
    stage.kept.append(channel)
    return channel


def _after(action: Callable[[Stage], object], look: Look) -> Look:
    def both(stage: Stage) -> Iterable[Finding]:
        action(stage)
        return look(stage)

    return both


case("DOC205", _after(_closed, _left), _after(_open, _left))
case(
    "DOC206",
    _after(_closed, lambda s: _left(s, set())),
    _after(_closed, lambda s: _left(s, {s.namespace.path("/robot1/cmd_vel")})),
)


def _temporary(stage: Stage) -> None:
    prefix = stage.namespace.temporary_prefix("/robot1/cmd_vel")
    (Path(stage.namespace.directory) / f"{prefix}0badf00d").write_bytes(b"")


case("DOC207", _after(_temporary, _left), _left)


def _retired(stage: Stage) -> None:
    path = _closed(stage).path
    with path.open("r+b") as file:
        file.seek(IDENTITY["state"])
        file.write(struct.pack("<I", 2))


case("DOC208", _after(_retired, _left), _after(_closed, _left))


def _owned_by(uid: int) -> Look:
    def look(stage: Stage) -> Iterable[Finding]:
        _closed(stage)
        found = _objects(stage)
        return leftovers.ownership(found, stage.namespace.prefix, {uid}, root=False)

    return look


case("DOC209", _owned_by(os.geteuid() + 1), _owned_by(os.geteuid()))


def _with_mode(bits: int) -> Look:
    def look(stage: Stage) -> Iterable[Finding]:
        _closed(stage).path.chmod(bits)
        return leftovers.ownership(_objects(stage), stage.namespace.prefix, {os.geteuid()}, root=True)

    return look


case("DOC210", _with_mode(0o664), _with_mode(0o660))


def _sound(stage: Stage) -> Iterable[Finding]:
    return leftovers.soundness(_objects(stage), stage.namespace.prefix)


def _scribbled(stage: Stage) -> None:
    with _closed(stage).path.open("r+b") as file:
        file.seek(IDENTITY["slot_count"])
        file.write(b"\7")


case("DOC211", _after(_scribbled, _sound), _after(_closed, _sound))
case(
    "DOC212",
    _after(lambda s: s.namespace.path("/in").symlink_to("/etc/passwd"), _sound),
    _after(_closed, _sound),
)


def _beating(*, lock: bool) -> Look:
    def look(stage: Stage) -> Iterable[Finding]:
        channel = _open(stage)
        writer = channel.writer(beat_ms=1000)
        if not lock:
            stage.namespace.lock_path("/robot1/cmd_vel").unlink()

        def sleep(seconds: float) -> None:
            writer.beat()

        held = held_files(Path("/proc"))
        directory, prefix = Path(stage.namespace.directory), stage.namespace.prefix
        found = look_at_objects(directory, held, prefix=prefix, seconds=1.0, sleep=sleep)
        return list(leftovers.leftovers(found, stage.namespace.prefix, None))

    return look


case("DOC213", _beating(lock=False), _beating(lock=True))


def _semaphore(value: int, size: int = 32, word: str = "=I") -> Look:
    def look(stage: Stage) -> Iterable[Finding]:
        (stage.root / "shm").mkdir()
        stage.file("shm/sem.x", struct.pack(word, value).ljust(size, b"\0"))
        plan = _classic_plan(stage)
        return leftovers.locks(stage.root / "shm", [plan], 64, sleep=lambda seconds: None)

    return look


def _classic_plan(stage: Stage):
    project = stage.project(CLASSIC.replace("NAME", "x"))
    plan = project.topics[0].classic
    assert plan is not None
    return plan


case("DOC214", _semaphore(0), _semaphore(1))
case("DOC215", _semaphore(1, size=16), _semaphore(1))
case("DOC216", _semaphore(2), _semaphore(1))


def _memory_of(size: int) -> Look:
    def look(stage: Stage) -> Iterable[Finding]:
        stage.file("shm/x", bytes(size))
        return leftovers.sizes(stage.root / "shm", [("/old", _classic_plan(stage), 4)])

    return look


case("DOC217", _memory_of(3), _memory_of(4096))


def _protected(level: int) -> Look:
    def look(stage: Stage) -> Iterable[Finding]:
        stage.file("proc/sys/fs/protected_regular", f"{level}\n")
        path = stage.file("shm/x", bytes(4))
        folder = path.parent
        folder.chmod(0o1777)
        if os.geteuid() == 0:
            os.chown(path, 1001, 1001)
        else:  # the folder would have to be another's; the rule is the same from there
            stage.kept.append(path)
        uid = 1002 if os.geteuid() == 0 else os.geteuid()
        return leftovers.create_or_open(stage.root, folder, [_classic_plan(stage)], [uid])

    return look


if os.geteuid() == 0:
    case("DOC218", _protected(1), _protected(0))

# The PLC.


def _runtimes(stage: Stage, *, classic: bool = False) -> Iterable[Finding]:
    (stage.root / "proc").mkdir(exist_ok=True)
    return rights_.runtimes(find_runtimes(stage.root / "proc"), 64, classic=classic)


case("DOC301", _runtimes, _after(lambda s: s.process(), _runtimes))
case("DOC302", _after(lambda s: s.process(bits=32), _runtimes), _after(lambda s: s.process(), _runtimes))
case("DOC003", _after(lambda s: s.process(bits=0), _runtimes), _after(lambda s: s.process(), _runtimes))
OBJECT = File("/in", 500, 600, 0o660)
case(
    "DOC303",
    lambda s: rights_.rights([OBJECT], 1234, frozenset({1234})),
    lambda s: rights_.rights([OBJECT], 1234, frozenset({1234, 600})),
)


def _same(stage: Stage) -> Iterable[Finding]:
    return rights_.same_memory(find_runtimes(stage.root / "proc"), TMPFS)


case(
    "DOC304",
    _after(lambda s: s.process(mount=OTHER_MOUNT), _same),
    _after(lambda s: s.process(), _same),
)
case(
    "DOC305",
    lambda s: (s.file(".dockerenv"), list(rights_.container(s.root, "", runtime_seen=False)))[1],
    lambda s: rights_.container(s.root, "", runtime_seen=False),
)

# ROS.

case(
    "DOC401",
    lambda s: network.distro(variables(ROS_DISTRO="humble"), ROS2),
    lambda s: network.distro(variables(ROS_DISTRO="jazzy"), ROS2),
)
case(
    "DOC402",
    lambda s: network.domain(variables(ROS_DOMAIN_ID="3"), replace(ROS2, domain=5)),
    lambda s: network.domain(variables(ROS_DOMAIN_ID="5"), replace(ROS2, domain=5)),
)
case(
    "DOC403",
    lambda s: network.values(variables(ROS_DOMAIN_ID="233"), ROS2),
    lambda s: network.values(variables(ROS_DOMAIN_ID="232"), ROS2),
)
case(
    "DOC404",
    lambda s: network.middleware(variables(RMW_IMPLEMENTATION="rmw_zenoh_cpp"), ROS2),
    lambda s: network.middleware(variables(RMW_IMPLEMENTATION="rmw_fastrtps_cpp"), ROS2),
)
case(
    "DOC405",
    lambda s: network.reach(variables(ROS_LOCALHOST_ONLY="1"), ROS2),
    lambda s: network.reach(variables(ROS_LOCALHOST_ONLY="0"), ROS2),
)


def _addresses(wish: Wish, **given: str) -> Iterable[Finding]:
    def resolve(host: str) -> list[str]:
        if host == "nowhere":
            raise OSError(-2, "Name or service not known")
        return ["10.0.0.5"]

    return network.addresses(given, wish, resolve=resolve, is_local=lambda text: text == "10.0.0.5")


case(
    "DOC406",
    lambda s: _addresses(ROS2, ROS_STATIC_PEERS="robot;nowhere"),
    lambda s: _addresses(ROS2, ROS_STATIC_PEERS="robot"),
)
case(
    "DOC410",
    lambda s: _addresses(ROS1, ROS_IP="10.0.0.6"),
    lambda s: _addresses(ROS1, ROS_HOSTNAME="robot"),
)


def _interfaces(**flags: str) -> Look:
    def look(stage: Stage) -> Iterable[Finding]:
        for name, value in flags.items():
            stage.file(f"sys/class/net/{name}/flags", value + "\n")
        return network.multicast(stage.root / "sys")

    return look


case("DOC407", _interfaces(lo="0x9", eth0="0x1002"), _interfaces(lo="0x9", eth0="0x1003"))
case(
    "DOC408",
    lambda s: network.master("http://robot:11311", call=lambda host, port: "Connection refused"),
    lambda s: network.master("http://robot:11311", call=lambda host, port: "", ask=lambda uri: ""),
)
case(
    "DOC409",
    lambda s: network.routers(["tcp/robot:7447"], call=lambda host, port: "Connection refused"),
    lambda s: network.routers(["tcp/[::1]:7447#iface=lo"], call=lambda host, port: ""),
)


def _buffers(default: int) -> Look:
    def look(stage: Stage) -> Iterable[Finding]:
        stage.file("proc/sys/net/core/rmem_default", f"{default}\n")
        stage.file("proc/sys/net/core/rmem_max", f"{default}\n")
        image = "{type: sensor_msgs/msg/Image, to: ros, limits: {data: 921600}}"
        return network.receive_buffers(stage.project(f"  /image: {image}\n").topics, stage.root, cyclone=True)

    return look


case("DOC411", _buffers(212_992), _buffers(4 << 20))

# The configuration.


def _configured(text: str) -> Look:
    def look(stage: Stage) -> Iterable[Finding]:
        path = stage.file("rosplc.yaml", f"prefix: {stage.namespace.prefix}\n{text}")
        return examination.examine(Question(path, ros=False)).findings

    return look


case("DOC501", _configured("topcis: {}\n"), _configured("topics: {}\n"))
case("DOC502", _configured("shm: {group: no-such-group}\n"), _configured("shm: {mode: '0660'}\n"))

# The graph.

NODE = "/robot"
QOS = Qos(depth=1)


def _graph(*ends: EndpointInfo, nodes: tuple[str, ...] = (NODE,), bridge_runs: bool = False) -> Look:
    def look(stage: Stage) -> Iterable[Finding]:
        project = stage.project(TOPICS)
        topics = {end.topic: (end.type_name,) for end in ends}
        names = {plan.topic: plan.topic for plan in project.topics}
        seen = Graph("dds", GraphInfo(nodes, ends, topics), names, "/rosplc_cell", "domain 0")
        return graph.judge_graph(seen, project.topics, project.store.type_hash, bridge_runs=bridge_runs)

    return look


def _end(topic: str = "/in", type_name: str = INT, *, qos: Qos = QOS, type_hash: str = "") -> EndpointInfo:
    return EndpointInfo(topic, type_name, "out" if topic != "/out" else "in", NODE, qos, type_hash)


INT_HASH = "RIHS01_b6578ded3c58c626cfe8d1a6fb6e04f706f97e9f03d2727c9ff4e74b1cef0deb"
GOOD = (_end(type_hash=INT_HASH), _end("/out", type_hash=INT_HASH))
case(
    "DOC510",
    lambda s: _joined(s, BackendError("ROS002", "the middleware refused")),
    lambda s: _joined(s, None),
)


def _joined(stage: Stage, error: Exception | None) -> Iterable[Finding]:
    path = stage.file("rosplc.yaml", f"prefix: {stage.namespace.prefix}\nros: {{backend: dds}}\n")

    def see(config: Path, seconds: float, environment: Mapping[str, str]) -> Graph:
        if error is not None:
            raise error
        return Graph("dds", GraphInfo(), {}, "/rosplc_rosplc", "domain 0")

    before, examination.see_graph = examination.see_graph, see
    try:
        return examination.examine(Question(path)).findings
    finally:
        examination.see_graph = before


case("DOC511", _graph(GOOD[1]), _graph(*GOOD))
case("DOC512", _graph(_end(type_name="std_msgs/msg/Int64")), _graph(*GOOD))
case("DOC513", _graph(_end(type_hash="RIHS01_" + "0" * 64)), _graph(*GOOD))
case("DOC514", _graph(_end(qos=Qos(reliability="best_effort"), type_hash=INT_HASH)), _graph(*GOOD))
case("DOC515", _graph(_end("/robot1/in")), _graph(*GOOD))
case("DOC516", _graph(nodes=()), _graph(*GOOD))
case(
    "DOC517",
    _graph(*GOOD, bridge_runs=True),
    _graph(*GOOD, nodes=(NODE, "/rosplc_cell"), bridge_runs=True),
)
case("DOC518", _graph(_end()), _graph(*GOOD))

CALLS = """{
  /grip: {type: std_srvs/srv/Trigger, server: ros, clients: [pick, place]},
  /start: {type: std_srvs/srv/SetBool, server: plc}}"""


def _calls(*ends: EndpointInfo) -> Look:
    def look(stage: Stage) -> Iterable[Finding]:
        project = stage.project(TOPICS, services=CALLS.replace("\n", " "))
        seen = Graph("dds", GraphInfo((NODE,), services=ends), {}, "/rosplc_cell", "domain 0")
        return graph.judge_graph(seen, (), project.store.type_hash, project.calls, bridge_runs=False)

    return look


def _server(
    name: str = "/grip", node: str = NODE, type_name: str = "std_srvs/srv/Trigger", *why: str
) -> EndpointInfo:
    return EndpointInfo(name, type_name, "in", node, QOS, obstacles=why)


case("DOC519", _calls(), _calls(_server()))
case("DOC520", _calls(_server(), _server(node="/second")), _calls(_server()))
case("DOC521", _calls(_server("/grip", NODE, "std_srvs/srv/Trigger", "over another DDS")), _calls(_server()))

# What runs.


def _seen(
    stage: Stage,
    topic: str = "/in",
    direction: Direction = Direction.TO_PLC,
    layout_id: str = "",
    *,
    held: bool = True,
    beats: bool = True,
    plc: str | None = "",
    refused: int = 0,
) -> Look:
    """Return the look of a bridge that holds one object, as a PLC's task sees it."""

    def look(stage: Stage) -> list[objects_.Carried]:
        plan = stage.project(TOPICS).topic("/in")
        actual = layout_id or plan.layout.layout_id
        channel = open_channel(stage.namespace, direction, topic=topic, layout_id=actual)
        stage.kept.append(channel)
        found = _objects(stage).of(stage.namespace, topic)
        assert found is not None and found.snapshot is not None
        line = replace(
            found.snapshot.readers[0], claim=1, layout_id=actual if plc == "" else str(plc), task="RosTask"
        )
        writer = replace(found.snapshot.writer, refused=refused)
        found = replace(
            found,
            held=held,
            bridge_beats=beats,
            plc_beats=plc is not None,
            plc_lines=() if plc is None else (line,),
            snapshot=replace(found.snapshot, writer=writer),
        )
        return [objects_.Carried(topic, topic, plan.direction, plan.layout, found)]

    return look  # type: ignore[return-value]


def _live(judge: Callable[[list[objects_.Carried]], Iterable[Finding]], **given: object) -> Look:
    def look(stage: Stage) -> Iterable[Finding]:
        return judge(_seen(stage, **given)(stage))  # type: ignore[arg-type]

    return look


case(
    "DOC601",
    _live(lambda c: objects_.holders(c, {}, "rosplc.yaml"), held=False, beats=False),
    _live(lambda c: objects_.holders(c, {}, "rosplc.yaml")),
)
case("DOC602", _live(objects_.layouts, layout_id=LAYOUT), _live(objects_.layouts))
case("DOC603", _live(objects_.beating, plc=None), _live(objects_.beating))
case("DOC604", _live(objects_.beating, plc=LAYOUT), _live(objects_.beating))
case("DOC605", _live(objects_.refusals, refused=3), _live(objects_.refusals))

# The PLC's code.


def _generated(topics: str = TOPICS, *, now: str = "", prefix: str = "") -> Look:
    """Generate for some topics and compare with a configuration of others."""

    def look(stage: Stage) -> Iterable[Finding]:
        project = _write_code(stage, topics)
        current = stage.project(now or topics)
        return (
            code.against_config(
                read_generated(stage.root / "out"),
                wanted(current),
                prefix or current.namespace.prefix,
                "rosplc generate",
                differences={},
            )
            if project
            else ()
        )

    return look


def wanted(project: Project) -> list[objects_.Carried]:
    """Return what the code of a configuration is to open."""
    topics = [objects_.Carried(p.topic, p.topic, p.direction, p.layout, None) for p in project.topics]
    return topics + [
        objects_.Carried(
            call.name,
            f"{call.called} {part.word} {call.client}".rstrip(),
            part.direction(call.server),
            call.layout(part),
            None,
        )
        for call in project.calls
        for part in call.parts
    ]


def _write_code(stage: Stage, topics: str, **options):
    from rosplc.plc.build import plc_project
    from rosplc.plc.delivery import project_files, write_files
    from rosplc.plc.plan import ProjectOptions

    project = stage.project(topics)
    files = project_files(plc_project(project, ProjectOptions(**options)), [], "rosplc")
    write_files(stage.root / "out", files)
    return project


LARGE = "  /in: {type: std_msgs/msg/String, to: plc, limits: {data: 40}}\n"
SMALL = "  /in: {type: std_msgs/msg/String, to: plc, limits: {data: 20}}\n"


def _folder(stage: Stage, name: str) -> Iterable[Finding]:
    _write_code(stage, TOPICS)
    path = stage.file("rosplc.yaml", f"prefix: {stage.namespace.prefix}\ntopics:\n{TOPICS}")
    return examination.examine(Question(path, stage.root / name, ros=False)).findings


case("DOC701", lambda s: _folder(s, "nothing"), lambda s: _folder(s, "out"))
case("DOC702", _generated(LARGE, now=SMALL), _generated(LARGE))


def _against_live(layout_id: str = "") -> Look:
    def look(stage: Stage) -> Iterable[Finding]:
        project = _write_code(stage, TOPICS)
        actual = layout_id or project.topic("/in").layout.layout_id
        stage.kept.append(open_channel(stage.namespace, topic="/in", layout_id=actual))
        directory = Path(stage.namespace.directory)
        return code.against_live(read_generated(stage.root / "out"), _objects(stage), directory)

    return look


case("DOC703", _against_live(LAYOUT), _against_live())
case("DOC704", _generated(LARGE, now=LARGE + TOPICS.splitlines()[1] + "\n"), _generated())
case("DOC705", _generated(TOPICS, now=TOPICS.splitlines()[0] + "\n"), _generated())
case("DOC706", _generated(prefix="other"), _generated())


def _fences(target: str) -> Look:
    def look(stage: Stage) -> Iterable[Finding]:
        _write_code(stage, TOPICS, target=target)
        return code.fences(read_generated(stage.root / "out"), "aarch64", "rosplc generate")

    return look


case("DOC707", _fences("x86"), _fences("arm"))


def _edited(text: str) -> Look:
    def look(stage: Stage) -> Iterable[Finding]:
        _write_code(stage, TOPICS)
        expected = {"st/ROS_Read.st": (stage.root / "out/st/ROS_Read.st").read_bytes()}
        with (stage.root / "out/st/ROS_Read.st").open("a") as file:
            file.write(text)
        return code.files(stage.root / "out", expected, "rosplc generate")[0]

    return look


case("DOC708", _edited("// mine\n"), _edited(""))
