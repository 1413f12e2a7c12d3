"""The examinations in their order, and the parts of the real machine that each one receives.

A file system or a name lookup may hang. Each examination therefore runs in its own thread, which is abandoned
after a time limit; what it has found by then is kept.
"""

from __future__ import annotations

import os
import platform
import pwd
import resource
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path

from rosplc._version import __version__
from rosplc.bridge.ros_side import choose_backend
from rosplc.config import ConfigErrors, Project, TopicPlan, load_project
from rosplc.config.plans import CallPlan, ClassicPlan
from rosplc.config.resolve import object_plans
from rosplc.config.resolve import rights as rights_of
from rosplc.doctor import code, graph, leftovers, machine, network, objects, rights
from rosplc.doctor.code import Generated, read_generated
from rosplc.doctor.finding import Area, Finding, Level, Report, user_name
from rosplc.doctor.graph import see_graph
from rosplc.doctor.kinds import fine, found, judged
from rosplc.doctor.network import Wish
from rosplc.doctor.objects import Objects, is_held, look_at_objects
from rosplc.errors import RosplcError
from rosplc.harmless import plural
from rosplc.plc.plan import ProjectOptions
from rosplc.proc import held_files, status_mask
from rosplc.project import call_memory, expected_files
from rosplc.ros import ROS1
from rosplc.shm import Part


@dataclass(frozen=True)
class Probe:
    """One examination: ``what`` it examines, as the reader sees it, and its time limit in ``seconds``.

    ``look`` returns or yields the findings. If a ``vital`` examination fails or hangs, that is an error.
    """

    what: str
    area: Area
    look: Callable[[], Iterable[Finding]]
    seconds: float = 5.0
    vital: bool = False


def run_probe(probe: Probe) -> list[Finding]:
    """Return the findings of an examination, with one more finding if the examination fails or hangs."""
    seen: list[Finding] = []
    failed: list[BaseException] = []

    def work() -> None:
        try:
            for finding in probe.look():
                seen.append(finding)
        except BaseException as error:
            failed.append(error)

    thread = threading.Thread(target=work, name=f"doctor: {probe.what}", daemon=True)
    thread.start()
    thread.join(probe.seconds)
    result = list(seen)
    level = Level.ERROR if probe.vital else None
    if thread.is_alive() or failed:
        late = thread.is_alive() or (isinstance(failed[0], TimeoutError) and not failed[0].strerror)
        why = f"no result within {probe.seconds:g} s" if thread.is_alive() else _words(failed[0], late=late)
        code = "DOC002" if late else "DOC001"
        result.append(found(code, f"could not check {probe.what}: {why}", level=level))
    # What the doctor could not do is shown beside what it did: people read by area.
    return [replace(each, area=probe.area) if each.area is Area.DOCTOR else each for each in result]


def _words(error: BaseException, *, late: bool) -> str:
    if isinstance(error, RosplcError):
        return f"{error.what} [{error.code}]"
    if isinstance(error, OSError) and error.strerror:
        return f"{error.strerror}: {error.filename}" if error.filename else error.strerror
    return str(error) if late else f"{type(error).__name__}: {error}"


_LOOK_S = 3.5  # how long to watch objects for beats, at most: who beats ends it sooner


@dataclass(frozen=True)
class Question:
    """The subject of an examination.

    ``config`` is None for the machine alone; ``code`` is the folder of generated PLC code; ``plc_user`` the
    user of the PLC runtime, needed only while the runtime is not running. ``ros``: examine the ROS graph for
    at most ``seconds``. ``root`` contains the folders ``proc``, ``sys``, ``etc`` and ``run``; ``directory``
    contains the objects if there is no configuration; ``variables`` is the environment.
    """

    config: Path | None = None
    code: Path | None = None
    plc_user: str = ""
    ros: bool = True
    seconds: float = 4.0
    root: Path = Path("/")
    directory: Path = Path("/dev/shm")
    variables: Mapping[str, str] = field(default_factory=lambda: dict(os.environ))


def examine(question: Question, progress: Callable[[str], None] = lambda what: None) -> Report:
    """Examine without changing anything; ``progress`` is called with the subject of each examination."""
    examination = _Examination(question)
    findings: list[Finding] = []
    for probe in examination.probes():
        progress(probe.what)
        findings += run_probe(probe)
    return Report(tuple(findings), None if question.config is None else str(question.config))


class _Examination:
    """The examinations, and what earlier ones leave for later ones."""

    def __init__(self, question: Question) -> None:
        self._q = question
        self._project: Project | None = None  # what it says, as far as it could be read:
        self._topics: tuple[TopicPlan, ...] = ()
        self._calls: tuple[CallPlan, ...] = ()
        self._classic: list[tuple[TopicPlan, ClassicPlan]] = []
        self._directory = question.directory
        self._prefix: str | None = None
        self._chosen = ""  # the backend that the configuration leads to, once it is known
        self._uid = os.geteuid()
        self._objects: Objects | None = None
        self._runtimes: list[rights.Runtime] = []
        self._proc = question.root / "proc"

    def probes(self) -> Iterator[Probe]:
        """Yield the examinations; what a later one looks at depends on what earlier ones have found."""
        q = self._q
        if q.config is not None:
            yield Probe("the configuration", Area.CONFIG, self._read_config, 20.0, vital=True)
        yield Probe("the machine", Area.MACHINE, self._machine)
        yield Probe("installed packages", Area.MACHINE, self._packages)
        yield Probe("the ROS backends", Area.MACHINE, self._backend, 30.0)
        yield Probe("/dev/shm", Area.MEMORY, self._memory)
        yield Probe("objects in shared memory", Area.MEMORY, self._look_at_objects, 10.0)
        if self._objects is not None:
            yield Probe("leftovers", Area.MEMORY, self._leftovers)
        yield Probe("logout settings", Area.MACHINE, self._logout)
        if self._classic:
            yield Probe("classic shared memory and locks", Area.MEMORY, self._classic_objects)
        yield Probe("PLC runtimes", Area.PLC, self._plc)
        yield Probe("permissions of the PLC user", Area.PLC, self._rights)
        yield Probe("the ROS environment", Area.ROS, self._variables)
        yield Probe("ROS host names", Area.ROS, self._addresses)
        yield from self._network()
        if self._project is not None and self._objects is not None:
            yield Probe("the running bridge", Area.LIVE, self._live)
        elif self._objects is not None:
            yield Probe("running bridges", Area.LIVE, lambda: objects.bridges(self._seen()))
        if q.code is not None:
            yield Probe("generated PLC code", Area.CODE, self._generated, 20.0)
        if self._project is not None and q.ros and self._chosen != "memory":
            yield Probe("the ROS graph", Area.GRAPH, self._graph, q.seconds + 40.0)

    @property
    def _wish(self) -> Wish | None:
        if self._project is None:
            return None
        ros = self._project.config.settings.ros
        return Wish(ros.distro, ros.distro == ROS1, self._chosen, ros.domain)

    @property
    def _owner_id(self) -> int:
        """Who owns, or would own, the objects."""
        with suppress(RosplcError):
            if self._project is not None and (uid := rights_of(self._project.config).uid) is not None:
                return uid
        return self._uid

    def _seen(self) -> Objects:
        return self._objects or Objects()

    def _read_config(self) -> Iterable[Finding]:
        path = self._q.config
        assert path is not None
        try:
            project = load_project(path)
        except ConfigErrors as errors:
            command = f"rosplc check {path}"
            for each in errors.errors:
                yield found("DOC501", f"{each.where}: {each.what} [{each.code}]", each.remedy, command)
            return
        self._project, self._topics, self._calls = project, project.topics, project.calls
        self._classic = [(plan, plan.classic) for plan in project.topics if plan.classic is not None]
        self._directory, self._prefix = Path(project.namespace.directory), project.namespace.prefix
        several = len({(plan.kind, plan.called) for plan in project.calls})
        more = f"; services and actions: {several}" if several else ""
        yield fine("DOC501", f"{path} is valid: {plural(len(project.topics), 'topic')}{more}")
        yield self._owner(project)

    def _owner(self, project: Project) -> Finding:
        settings, who = project.config.settings.shm, user_name(self._uid)
        try:
            wanted = rights_of(project.config)
        except RosplcError as error:
            return found("DOC502", error.what, error.remedy)
        uid, gid = wanted.uid, wanted.gid
        what = remedy = command = ""
        if self._uid != 0 and uid not in (None, self._uid):
            what = f"shm.owner is {settings.owner}, but {who} cannot give files to that user"
            remedy = f"Start the bridge as {settings.owner}, or remove shm.owner."
        elif self._uid != 0 and gid is not None and gid not in {os.getegid(), *os.getgroups()}:
            what = f"shm.group is {settings.group}, but {who} is not a member of it"
            remedy = "Add the bridge's user to the group, and log in again."
            command = f"sudo usermod --append --groups {settings.group} {who}"
        well = "the bridge can give objects to the configured owner and group"
        return judged("DOC502", what, well, remedy, command, Level.WARNING)

    # The machine.

    def _machine(self) -> Iterator[Finding]:
        def limit(which: int) -> int:
            return resource.getrlimit(which)[0]

        yield from machine.architecture(platform.machine(), platform.release(), byte_order=sys.byteorder)
        yield from machine.clock(time.time())
        yield from machine.open_files(limit(resource.RLIMIT_NOFILE), len(self._topics))
        held = status_mask(self._proc / "self/status", "CapEff")
        yield from machine.real_time(limit(resource.RLIMIT_RTPRIO), limit(resource.RLIMIT_MEMLOCK), held)

    def _logout(self) -> Iterator[Finding]:
        # Whose objects exist already is who the bridge runs as; another user may run the doctor.
        seen = leftovers.concerned(self._seen(), self._prefix)
        uid = max((each.status.st_uid for each in seen), default=self._owner_id)
        return machine.logout(self._q.root, uid, user_name(uid))

    def _packages(self) -> Iterator[Finding]:
        yield from machine.packages(machine.needed(), platform.python_version(), __version__)
        yield from machine.wheels(platform.machine(), (sys.version_info[0], sys.version_info[1]))

    def _backend(self) -> Iterator[Finding]:
        variables = self._q.variables
        if self._project is None:
            return machine.backend(
                variables.get("ROS_DISTRO") or "jazzy", "auto", variables, configured=False
            )
        ros = self._project.config.settings.ros
        with suppress(RosplcError):  # the same is found below
            self._chosen = choose_backend(self._project.config, variables).name
        return machine.backend(
            ros.distro,
            ros.backend,
            variables,
            zenoh_settings=ros.zenoh is not None,
            services=bool(self._project.calls),
        )

    # Shared memory.

    def _memory(self) -> Iterator[Finding]:
        directory = self._directory
        yield from machine.mounted(directory, rights.shm_mount(self._proc / "self/mountinfo"))
        if directory.is_dir():
            yield from machine.mode(directory, writable=os.access(directory, os.W_OK | os.X_OK))
            yield from machine.room(directory, os.statvfs(directory), *self._sizes())

    def _sizes(self) -> tuple[int, int]:
        """Return the bytes that the configuration's objects take, and those that exist already."""
        needed = present = 0
        for plan in self._topics:
            assert self._project is not None
            path = self._directory / self._project.object_name(plan)
            own = object_plans(self._project, plan)[Part.TOPIC].object_size if plan.port == "channel" else 0
            size = own or plan.layout.size
            needed += size
            if path.is_file():
                present += min(size, path.stat().st_blocks * 512)
        for call in self._calls:
            assert self._project is not None
            needed += call_memory(self._project, call)
            for part in call.parts:
                path = self._project.namespace.path(call.called, part, call.client)
                present += path.stat().st_blocks * 512 if path.is_file() else 0
        return needed, present

    def _look_at_objects(self) -> Iterable[Finding]:
        held = held_files(self._proc)
        self._objects = look_at_objects(self._directory, held, prefix=self._prefix, seconds=_LOOK_S)
        return ()

    def _leftovers(self) -> Iterator[Finding]:
        objects, prefix, configured = self._seen(), self._prefix, None
        if self._project is not None:
            path = self._project.namespace.path
            configured = {path(plan.topic) for plan in self._topics if plan.port == "channel"}
            configured |= {
                path(call.called, part, call.client) for call in self._calls for part in call.parts
            }
        yield from leftovers.leftovers(objects, prefix, configured)
        yield from leftovers.soundness(objects, prefix)
        yield from leftovers.ownership(objects, prefix, {self._uid, self._owner_id}, root=self._uid == 0)

    def _classic_objects(self) -> Iterator[Finding]:
        bits = 64 if sys.maxsize > 1 << 32 else 32
        plans = [(plan.topic, each, plan.layout.size) for plan, each in self._classic]
        yield from leftovers.locks(self._directory, [each for _, each in self._classic], bits)
        yield from leftovers.sizes(self._directory, plans)

    # The PLC.

    def _plc(self) -> Iterator[Finding]:
        self._runtimes = rights.find_runtimes(self._proc)
        wide = platform.machine() in ("x86_64", "aarch64", "ppc64le", "riscv64")
        locked = any(each.semaphore for _, each in self._classic)
        yield from rights.runtimes(self._runtimes, 64 if wide else 32, classic=locked)
        yield from rights.same_memory(self._runtimes, rights.shm_mount(self._proc / "self/mountinfo"))
        word = self._q.variables.get("container", "")
        yield from rights.container(self._q.root, word, runtime_seen=bool(self._runtimes))

    def _rights(self) -> Iterator[Finding]:
        users = {(each.uid, each.gids) for each in self._runtimes}
        if user := self._q.plc_user:
            try:
                entry = pwd.getpwnam(user)
            except KeyError:
                yield found("DOC303", f"user {user!r} does not exist", "Correct --plc-user.", "getent passwd")
                return
            users = {(entry.pw_uid, frozenset(os.getgrouplist(user, entry.pw_gid)))}
        for uid, gids in sorted(users, key=lambda each: each[0]):
            yield from rights.rights(self._files(), uid, gids)
        if self._classic and users:
            plans, uids = [each for _, each in self._classic], sorted(uid for uid, _ in users)
            yield from leftovers.create_or_open(self._q.root, self._directory, plans, uids)

    def _files(self) -> list[rights.File]:
        """Return the objects as they are, or as they would be if the configuration's do not exist yet."""

        def file(name: str, status: os.stat_result) -> rights.File:
            return rights.File(name, status.st_uid, status.st_gid, status.st_mode & 0o7777)

        seen = leftovers.concerned(self._seen(), self._prefix)
        files = [file(each.label, each.status) for each in seen]
        there = {each.label for each in seen}
        if self._project is None:
            return files
        config, gid = self._project.config, os.getegid()
        with suppress(RosplcError):
            gid = gid if (wanted := rights_of(config).gid) is None else wanted
        mode = config.settings.shm.mode
        for plan in self._topics:
            names = [plan.topic if plan.port == "channel" else self._project.object_name(plan)]
            if plan.classic is not None and plan.classic.semaphore:
                names.append(f"sem.{plan.classic.semaphore}")
            for name in names:
                path = self._directory / name.lstrip("/")
                if plan.port != "channel" and path.is_file():
                    files.append(file(name, path.stat()))
                elif name not in there:
                    files.append(rights.File(name, self._owner_id, gid, mode))
        missing = [each.name for each in self._carried() if each.use != each.name and each.name not in there]
        return [*files, *(rights.File(name, self._owner_id, gid, mode) for name in missing)]

    # ROS.

    def _variables(self) -> Iterator[Finding]:
        for look in (network.distro, network.values, network.domain, network.middleware, network.reach):
            yield from look(self._q.variables, self._wish)

    def _addresses(self) -> Iterator[Finding]:
        resolve, is_local = network.resolve, network.is_local
        return network.addresses(self._q.variables, self._wish, resolve=resolve, is_local=is_local)

    def _network(self) -> Iterator[Probe]:
        wish, variables = self._wish, self._q.variables
        backend = "" if wish is None else wish.backend
        if wish is not None and wish.ros1 and backend != "memory":
            uri = variables.get("ROS_MASTER_URI") or "http://localhost:11311"
            yield Probe("the ROS master", Area.ROS, lambda: network.master(uri), 8.0)
        elif backend == "zenoh":
            locators = self._locators()
            seconds = 4.0 + 3.0 * len(locators)
            yield Probe("the Zenoh router", Area.ROS, lambda: network.routers(locators), seconds)
        elif backend != "memory":
            yield Probe("network interfaces", Area.ROS, lambda: network.multicast(self._q.root / "sys"))
            rmw = variables.get("RMW_IMPLEMENTATION", "").strip()
            cyclone = backend == "dds" or rmw == "rmw_cyclonedds_cpp"
            if backend == "dds" or (backend == "rclpy" and rmw != "rmw_zenoh_cpp"):
                root, topics = self._q.root, self._topics
                look = network.receive_buffers
                yield Probe("receive buffers", Area.ROS, lambda: look(topics, root, cyclone=cyclone))

    def _locators(self) -> tuple[str, ...]:
        """Return where a Zenoh session would connect to, as far as that can be known."""
        assert self._project is not None
        zenoh, variables = self._project.config.settings.ros.zenoh, self._q.variables
        if zenoh is not None and zenoh.connect:
            return zenoh.connect
        # A file or a variable may set others, which only the library can read.
        others = [variables.get(name) for name in ("ZENOH_SESSION_CONFIG_URI", "ZENOH_CONFIG_OVERRIDE")]
        return () if any(others) or (zenoh is not None and zenoh.config) else ("tcp/localhost:7447",)

    def _carried(self) -> list[objects.Carried]:
        if self._project is None:
            return []
        own, seen = self._project.namespace, self._seen().of
        carried = [
            objects.Carried(plan.topic, plan.topic, plan.direction, plan.layout, seen(own, plan.topic))
            for plan in self._topics
            if plan.port == "channel"
        ]
        for call in self._calls:
            for part in call.parts:
                name = f"{call.called} {part.word} {call.client}".rstrip()
                found = seen(own, call.called, part, call.client)
                carried.append(
                    objects.Carried(call.name, name, part.direction(call.server), call.layout(part), found)
                )
        return carried

    def _live(self) -> Iterator[Finding]:
        carried, held = self._carried(), held_files(self._proc)
        # A bridge holds the lock file of a classic topic's memory.
        locks = {
            plan.topic: bool(is_held(self._directory / f"rosplc.classic.{each.name}", held))
            for plan, each in self._classic
        }
        yield from objects.holders(carried, locks, str(self._q.config))
        yield from objects.layouts(carried)
        yield from objects.beating(carried)
        yield from objects.refusals(carried)

    def _graph(self) -> Iterator[Finding]:
        project, config = self._project, self._q.config
        assert project is not None and config is not None
        try:
            seen = see_graph(config, self._q.seconds, self._q.variables)
        except RosplcError as error:
            yield found("DOC510", f"{error.what} [{error.code}]", error.remedy)
            return
        yield fine("DOC510", f"examined {seen.where} (backend {seen.backend})")
        silent = project.config.settings.ros.distro in (ROS1, "humble")
        runs = any(each.live for each in self._carried())

        def type_hash(name: str) -> str:
            return "" if silent else project.store.type_hash(name)

        of_ros = [plan for plan in self._topics if not plan.own]
        yield from graph.judge_graph(seen, of_ros, type_hash, self._calls, bridge_runs=runs)

    # Generated code.

    def _generated(self) -> Iterator[Finding]:
        folder, project = self._q.code, self._project
        assert folder is not None
        try:
            present = read_generated(folder)
        except ValueError as error:
            yield found("DOC701", str(error))
            return
        yield fine("DOC701", f"{folder} contains blocks for {plural(len(present.blocks), 'object')}")
        command = f"rosplc generate {self._q.config or 'rosplc.yaml'} --out {folder}"
        if project is not None:
            edited, differences = _regenerated(project, folder, present, command)
            prefix = project.namespace.prefix
            wanted = self._carried()
            wanted += [
                objects.Carried(plan.topic, each.name, plan.direction, plan.layout, None)
                for plan, each in self._classic
            ]
            compared = list(code.against_config(present, wanted, prefix, command, differences=differences))
            yield from compared
            if all(each.level is Level.OK for each in compared):
                yield from edited
        if self._objects is not None:
            yield from code.against_live(present, self._objects, self._directory)
        yield from code.fences(present, platform.machine(), command)


def _regenerated(
    project: Project, folder: Path, present: Generated, command: str
) -> tuple[list[Finding], dict[str, str]]:
    """Compare with what would be generated now, without and with pins; return the closer comparison."""
    top = folder if (folder / "st").is_dir() else folder.parent
    result: tuple[list[Finding], dict[str, str]] = ([], {})
    for pins in (False, True):
        options = ProjectOptions(
            target="arm" if present.arm else "x86",
            fenced=present.fenced,
            programs=present.programs,
            pins=pins,
        )
        result = code.files(top, expected_files(project, options), command)
        if not any(each.level for each in result[0]):
            break
    return result
