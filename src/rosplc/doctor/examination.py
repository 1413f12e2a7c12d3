"""Which examinations there are, in which order, and what each is given of the real machine."""

from __future__ import annotations

import os
import platform
import pwd
import resource
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

from rosplc._version import __version__
from rosplc.bridge import ConfigErrors, Project, TopicPlan, load_project
from rosplc.bridge.describe import object_size
from rosplc.bridge.owner import group_id, user_id
from rosplc.bridge.ros_side import choose_backend
from rosplc.doctor import (
    classic,
    code,
    environment,
    graph,
    leftovers,
    live,
    machine,
    memory,
    network,
    packages,
    rights,
)
from rosplc.doctor.finding import Area, Finding, Level
from rosplc.doctor.generated import Generated, read_generated
from rosplc.doctor.kinds import kind
from rosplc.doctor.look import see_graph
from rosplc.doctor.objects import Objects, held_files, is_held, look_at_objects
from rosplc.doctor.probe import Probe, run_probe
from rosplc.doctor.processes import Runtime, find_runtimes, shm_mount
from rosplc.doctor.report import Report
from rosplc.doctor.words import user_name
from rosplc.errors import RosplcError
from rosplc.ros import ROS1

__all__ = ["Question", "examine"]

_LOOK_S, _GLANCE_S = 3.5, 0.5
"""How long to watch a configuration's objects for beats, and all of a machine's."""


@dataclass(frozen=True)
class Question:
    """What is to be examined.

    Attributes:
        config: The configuration file; None for the machine alone.
        code: The folder of generated PLC code; None for none.
        plc_user: The user of the PLC runtime, where it does not run now; empty: found by its process.
        ros: Whether to look at the ROS graph.
        seconds: How long to look at it, at most.
        root: Where ``proc``, ``sys``, ``etc`` and ``run`` stand.
        directory: Where objects lie without a configuration.
        variables: The environment variables.
        generate: Returns what would be generated for a project: path → content; its arguments are
            whether the code is fenced, and whether it has pins.
    """

    config: Path | None = None
    code: Path | None = None
    plc_user: str = ""
    ros: bool = True
    seconds: float = 4.0
    root: Path = Path("/")
    directory: Path = Path("/dev/shm")
    variables: Mapping[str, str] = field(default_factory=lambda: dict(os.environ))
    generate: Callable[[Project, bool, bool], Mapping[str, bytes]] | None = None


def examine(question: Question, progress: Callable[[str], None] = lambda what: None) -> Report:
    """Examine everything that the question names; nothing is changed by it.

    Args:
        question: What to examine.
        progress: Called with what is looked at next.
    """
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
        self._project: Project | None = None
        self._objects: Objects | None = None
        self._code: Generated | None = None
        self._runtimes: list[Runtime] = []
        self._uid = os.geteuid()
        self._chosen = ""

    def probes(self) -> Iterator[Probe]:
        """Yield the examinations; what a later one looks at depends on what earlier ones have found."""
        q = self._q
        if q.config is not None:
            yield Probe("the configuration", Area.CONFIG, self._read_config, 20.0, vital=True)
        yield Probe("the machine", Area.MACHINE, self._machine)
        yield Probe("installed packages", Area.MACHINE, self._packages)
        yield Probe("the ways into ROS", Area.MACHINE, self._backend, 30.0)
        yield Probe("/dev/shm", Area.MEMORY, self._memory)
        yield Probe("objects in shared memory", Area.MEMORY, self._look_at_objects, 10.0)
        if self._objects is not None:
            yield Probe("left-overs", Area.MEMORY, self._leftovers)
        yield Probe("what happens at log-out", Area.MACHINE, self._logout)
        if self._classic:
            yield Probe("classic memories and locks", Area.MEMORY, self._classic_objects)
        yield Probe("PLC runtimes", Area.PLC, self._plc)
        yield Probe("rights of the PLC's user", Area.PLC, self._rights)
        yield Probe("the ROS environment", Area.ROS, self._variables)
        yield Probe("host names of ROS", Area.ROS, self._addresses)
        yield from self._network()
        if self._project is not None and self._objects is not None:
            yield Probe("the running bridge", Area.LIVE, self._live)
        if q.code is not None:
            yield Probe("generated PLC code", Area.CODE, self._generated, 20.0)
        if self._project is not None and q.ros and self._chosen != "memory":
            yield Probe("the ROS graph", Area.GRAPH, self._graph, q.seconds + 40.0)

    # What the configuration says.

    def _read_config(self) -> Iterable[Finding]:
        path = self._q.config
        assert path is not None
        try:
            self._project = load_project(path)
        except ConfigErrors as errors:
            return [
                kind("DOC501").found(
                    f"{each.where}: {each.what} [{each.code}]", each.remedy, f"rosplc check {path}"
                )
                for each in errors.errors
            ]
        return [
            kind("DOC501").fine(f"{path} is valid: {len(self._project.topics)} topics"),
            *self._owner(self._project),
        ]

    def _owner(self, project: Project) -> Iterator[Finding]:
        settings = project.config.settings.shm
        try:
            uid, gid = user_id(project.config), group_id(project.config)
        except RosplcError as error:
            yield kind("DOC502").found(error.what, error.remedy)
            return
        if self._uid != 0 and uid not in (None, self._uid):
            what = f"shm.owner is {settings.owner}, and {user_name(self._uid)} may not give files away"
            remedy = f"Start the bridge as {settings.owner}, or remove shm.owner."
            yield kind("DOC502").found(what, remedy, level=Level.WARNING)
        elif self._uid != 0 and gid is not None and gid not in {os.getegid(), *os.getgroups()}:
            what = f"shm.group is {settings.group}, and {user_name(self._uid)} is not in it"
            remedy = "Put the bridge's user into the group, and log in again."
            command = f"sudo usermod --append --groups {settings.group} {user_name(self._uid)}"
            yield kind("DOC502").found(what, remedy, command, level=Level.WARNING)
        else:
            yield kind("DOC502").fine(
                "objects can be given to the owner and group that the configuration names"
            )

    @property
    def _topics(self) -> tuple[TopicPlan, ...]:
        return () if self._project is None else self._project.topics

    @property
    def _classic(self) -> list[TopicPlan]:
        return [plan for plan in self._topics if plan.classic is not None]

    @property
    def _directory(self) -> Path:
        return self._q.directory if self._project is None else Path(self._project.namespace.directory)

    @property
    def _prefix(self) -> str | None:
        return None if self._project is None else self._project.namespace.prefix

    def _wish(self) -> environment.Wish | None:
        if self._project is None:
            return None
        ros = self._project.config.settings.ros
        return environment.Wish(ros.distro, ros.distro == ROS1, self._chosen, ros.domain)

    # The machine.

    def _machine(self) -> Iterator[Finding]:
        yield from machine.architecture(platform.machine(), platform.release(), byte_order=sys.byteorder)
        yield from machine.clock(time.time())
        yield from machine.open_files(resource.getrlimit(resource.RLIMIT_NOFILE)[0], len(self._topics))
        priority, locked = (
            resource.getrlimit(which)[0] for which in (resource.RLIMIT_RTPRIO, resource.RLIMIT_MEMLOCK)
        )
        held = machine.capabilities(self._q.root / "proc/self/status")
        yield from machine.real_time(priority, locked, held)

    def _logout(self) -> Iterator[Finding]:
        # Whose objects are there already is who the bridge runs as; the doctor may be asked by another.
        seen = leftovers.concerned(self._objects or Objects(), self._prefix)
        uid = max((each.status.st_uid for each in seen), default=self._owner_id())
        return machine.logout(self._q.root, uid, user_name(uid))

    def _owner_id(self) -> int:
        """Return who owns, or would own, the objects."""
        if self._project is None:
            return self._uid
        try:
            found = user_id(self._project.config)
        except RosplcError:
            return self._uid
        return self._uid if found is None else found

    def _packages(self) -> Iterator[Finding]:
        yield from packages.packages(packages.needed(), platform.python_version(), __version__)
        yield from packages.wheels(platform.machine(), (sys.version_info[0], sys.version_info[1]))

    def _backend(self) -> Iterator[Finding]:
        if self._project is None:
            distro = self._q.variables.get("ROS_DISTRO") or "jazzy"
            return packages.backend(distro, "auto", self._q.variables, configured=False)
        ros = self._project.config.settings.ros
        with suppress(RosplcError):  # the same is found below
            self._chosen = choose_backend(self._project.config, self._q.variables).name
        return packages.backend(
            ros.distro, ros.backend, self._q.variables, zenoh_settings=ros.zenoh is not None
        )

    # Shared memory.

    def _memory(self) -> Iterator[Finding]:
        directory = self._directory
        mount = shm_mount(self._q.root / "proc/self/mountinfo")
        yield from memory.mounted(directory, mount)
        if directory.is_dir():
            yield from memory.mode(directory, writable=os.access(directory, os.W_OK | os.X_OK))
            needed, present = self._sizes()
            yield from memory.room(directory, os.statvfs(directory), needed, present)

    def _sizes(self) -> tuple[int, int]:
        """Return the bytes that the configuration's objects take, and those that are there already."""
        if self._project is None:
            return 0, 0
        needed = present = 0
        for plan in self._topics:
            if plan.classic is None:
                size, path = object_size(self._project, plan), self._project.namespace.path(plan.topic)
            else:
                size, path = plan.layout.size, self._directory / plan.classic.name
            needed += size
            if path.is_file():
                present += min(size, path.stat().st_blocks * 512)
        return needed, present

    def _look_at_objects(self) -> Iterable[Finding]:
        held = held_files(self._q.root / "proc")
        self._objects = look_at_objects(
            self._directory,
            held,
            prefix=self._prefix,
            seconds=_GLANCE_S if self._project is None else _LOOK_S,
        )
        return ()

    def _leftovers(self) -> Iterator[Finding]:
        assert self._objects is not None
        configured = None
        if self._project is not None:
            configured = {self._project.namespace.path(p.topic) for p in self._topics if p.classic is None}
        yield from leftovers.leftovers(self._objects, self._prefix, configured)
        yield from leftovers.soundness(self._objects, self._prefix)
        owners = {self._uid, self._owner_id()}
        yield from leftovers.ownership(self._objects, self._prefix, owners, root=self._uid == 0)

    def _classic_objects(self) -> Iterator[Finding]:
        bits = 64 if sys.maxsize > 1 << 32 else 32
        plans = [(plan.topic, plan.classic, plan.layout.size) for plan in self._classic if plan.classic]
        yield from classic.locks(self._directory, [each for _, each, _ in plans], bits)
        yield from classic.sizes(self._directory, plans)

    # The PLC.

    def _plc(self) -> Iterator[Finding]:
        self._runtimes = find_runtimes(self._q.root / "proc")
        wide = platform.machine() in ("x86_64", "aarch64", "ppc64le", "riscv64")
        locked = any(plan.classic is not None and plan.classic.semaphore for plan in self._topics)
        yield from rights.runtimes(self._runtimes, 64 if wide else 32, classic=locked)
        yield from rights.same_memory(self._runtimes, shm_mount(self._q.root / "proc/self/mountinfo"))
        word = self._q.variables.get("container", "")
        yield from rights.container(self._q.root, word, runtime_seen=bool(self._runtimes))

    def _rights(self) -> Iterator[Finding]:
        users = {(each.uid, each.gids) for each in self._runtimes}
        if self._q.plc_user:
            user = self._q.plc_user
            try:
                entry = pwd.getpwnam(user)
            except KeyError:
                yield kind("DOC303").found(
                    f"there is no user {user!r}", "Correct --plc-user.", "getent passwd"
                )
                return
            users = {(entry.pw_uid, frozenset(os.getgrouplist(user, entry.pw_gid)))}
        for uid, gids in sorted(users, key=lambda each: each[0]):
            yield from rights.rights(self._files(), uid, gids)
        plans = [plan.classic for plan in self._classic if plan.classic is not None]
        if plans and users:
            uids = sorted(uid for uid, _ in users)
            yield from classic.create_or_open(self._q.root, self._directory, plans, uids)

    def _files(self) -> list[rights.File]:
        """Return the objects as they are; where the configuration's are missing, as they would be."""
        files, there = [], set()
        for seen in leftovers.concerned(self._objects or Objects(), self._prefix):
            status = seen.status
            files.append(rights.File(seen.topic, status.st_uid, status.st_gid, status.st_mode & 0o7777))
            there.add(seen.topic)
        if self._project is None:
            return files
        uid, gid = self._owner_id(), os.getegid()
        try:
            wanted = group_id(self._project.config)
        except RosplcError:
            wanted = None
        mode = self._project.config.settings.shm.mode
        for plan in self._topics:
            names = [plan.topic] if plan.classic is None else [plan.classic.name]
            if plan.classic is not None and plan.classic.semaphore:
                names.append(f"sem.{plan.classic.semaphore}")
            for name in names:
                path = self._directory / name.lstrip("/") if plan.classic else None
                if path is not None and path.is_file():
                    status = path.stat()
                    files.append(rights.File(name, status.st_uid, status.st_gid, status.st_mode & 0o7777))
                elif name not in there:
                    files.append(rights.File(name, uid, gid if wanted is None else wanted, mode))
        return files

    # ROS.

    def _variables(self) -> Iterator[Finding]:
        variables, wish = self._q.variables, self._wish()
        for look in (environment.distro, environment.values, environment.domain):
            yield from look(variables, wish)
        yield from environment.middleware(variables, wish)
        yield from environment.reach(variables, wish)

    def _addresses(self) -> Iterator[Finding]:
        return environment.addresses(
            self._q.variables, self._wish(), resolve=network.resolve, is_local=network.is_local
        )

    def _network(self) -> Iterator[Probe]:
        wish = self._wish()
        if wish is not None and wish.backend == "memory":
            return
        if wish is not None and wish.ros1:
            uri = self._q.variables.get("ROS_MASTER_URI") or "http://localhost:11311"
            yield Probe("the ROS master", Area.ROS, lambda: network.master(uri), 8.0)
        elif wish is not None and wish.backend == "zenoh":
            locators = self._locators()
            yield Probe(
                "the Zenoh router", Area.ROS, lambda: network.routers(locators), 4.0 + 3.0 * len(locators)
            )
        else:
            yield Probe("network interfaces", Area.ROS, lambda: network.multicast(self._q.root / "sys"))

    def _locators(self) -> tuple[str, ...]:
        assert self._project is not None
        zenoh = self._project.config.settings.ros.zenoh
        if zenoh is not None and zenoh.connect:
            return zenoh.connect
        # A file or a variable may say otherwise; what they say only the library can read.
        others = (zenoh is not None and zenoh.config) or self._q.variables.get("ZENOH_SESSION_CONFIG_URI")
        return () if others or self._q.variables.get("ZENOH_CONFIG_OVERRIDE") else ("tcp/localhost:7447",)

    def _carried(self) -> list[live.Carried]:
        project, objects = self._project, self._objects
        if project is None or objects is None:
            return []
        return [
            live.Carried(plan, objects.of(project.namespace, plan.topic))
            for plan in self._topics
            if plan.classic is None
        ]

    def _classic_held(self) -> dict[str, bool]:
        """Return classic topic → whether a bridge holds the lock file of its memory."""
        held = held_files(self._q.root / "proc")
        return {
            plan.topic: bool(is_held(self._directory / f"rosplc.classic.{plan.classic.name}", held))
            for plan in self._classic
            if plan.classic is not None
        }

    def _live(self) -> Iterator[Finding]:
        carried = self._carried()
        yield from live.holders(carried, self._classic_held(), str(self._q.config))
        yield from live.layouts(carried)
        yield from live.beating(carried)
        yield from live.refusals(carried)

    def _graph(self) -> Iterator[Finding]:
        project, config = self._project, self._q.config
        assert project is not None and config is not None
        try:
            seen = see_graph(config, self._q.seconds, self._q.variables)
        except RosplcError as error:
            yield kind("DOC510").found(f"{error.what} [{error.code}]", error.remedy)
            return
        distro = project.config.settings.ros.distro
        silent = distro in (ROS1, "humble")
        runs = any(each.live for each in self._carried())
        yield kind("DOC510").fine(f"looked at {seen.where} over {seen.backend}")
        yield from graph.judge_graph(
            seen, self._topics, lambda name: "" if silent else project.store.type_hash(name), bridge_runs=runs
        )

    # Generated code.

    def _generated(self) -> Iterator[Finding]:
        folder = self._q.code
        assert folder is not None
        try:
            found = read_generated(folder)
        except ValueError as error:
            yield kind("DOC701").found(str(error))
            return
        yield kind("DOC701").fine(f"{folder}: {len(found.blocks)} blocks")
        command = f"rosplc generate {self._q.config or 'rosplc.yaml'} --out {folder}"
        if self._project is not None:
            project = self._project
            edited, differences = self._regenerated(project, folder, found, command)
            compared = list(
                code.against_config(
                    found, project.topics, project.namespace.prefix, command, differences=differences
                )
            )
            yield from compared
            if all(each.level is Level.OK for each in compared):
                yield from edited
        if self._objects is not None:
            yield from code.against_live(found, self._objects, self._directory)
        yield from code.fences(found, platform.machine(), command)

    def _regenerated(
        self, project: Project, folder: Path, found: Generated, command: str
    ) -> tuple[list[Finding], dict[str, str]]:
        if self._q.generate is None:
            return [], {}
        top = folder if (folder / "st").is_dir() else folder.parent
        result: tuple[list[Finding], dict[str, str]] = ([], {})
        for pins in (False, True):
            result = code.files(top, self._q.generate(project, found.fenced, pins), command)
            if not any(each.level for each in result[0]):
                break
        return result
