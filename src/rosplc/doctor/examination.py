"""Which examinations there are, in which order, and what each is given of the real machine."""

from __future__ import annotations

import os
import platform
import pwd
import resource
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from pathlib import Path

from rosplc._version import __version__
from rosplc.bridge.ros_side import choose_backend
from rosplc.config import ConfigErrors, Project, load_project
from rosplc.config.resolve import group_id, user_id
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
from rosplc.doctor.subject import Question, Subject
from rosplc.doctor.words import user_name
from rosplc.errors import RosplcError
from rosplc.plc.plan import ProjectOptions
from rosplc.project import expected_files
from rosplc.ros import ROS1

__all__ = ["examine"]

_LOOK_S = 3.5
"""How long to watch objects for beats, at most: who beats ends it sooner."""


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
        self._subject = Subject(question)
        self._objects: Objects | None = None
        self._code: Generated | None = None
        self._runtimes: list[Runtime] = []

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
        if self._subject.classic:
            yield Probe("classic memories and locks", Area.MEMORY, self._classic_objects)
        yield Probe("PLC runtimes", Area.PLC, self._plc)
        yield Probe("rights of the PLC's user", Area.PLC, self._rights)
        yield Probe("the ROS environment", Area.ROS, self._variables)
        yield Probe("host names of ROS", Area.ROS, self._addresses)
        yield from self._network()
        if self._subject.project is not None and self._objects is not None:
            yield Probe("the running bridge", Area.LIVE, self._live)
        elif self._objects is not None:
            yield Probe("running bridges", Area.LIVE, lambda: live.bridges(self._objects or Objects()))
        if q.code is not None:
            yield Probe("generated PLC code", Area.CODE, self._generated, 20.0)
        if self._subject.project is not None and q.ros and self._subject.chosen != "memory":
            yield Probe("the ROS graph", Area.GRAPH, self._graph, q.seconds + 40.0)

    # What the configuration says.

    def _read_config(self) -> Iterable[Finding]:
        path = self._q.config
        assert path is not None
        try:
            self._subject.project = load_project(path)
        except ConfigErrors as errors:
            return [
                kind("DOC501").found(
                    f"{each.where}: {each.what} [{each.code}]", each.remedy, f"rosplc check {path}"
                )
                for each in errors.errors
            ]
        return [
            kind("DOC501").fine(f"{path} is valid: {len(self._subject.project.topics)} topics"),
            *self._owner(self._subject.project),
        ]

    def _owner(self, project: Project) -> Iterator[Finding]:
        settings = project.config.settings.shm
        try:
            uid, gid = user_id(project.config), group_id(project.config)
        except RosplcError as error:
            yield kind("DOC502").found(error.what, error.remedy)
            return
        if self._subject.uid != 0 and uid not in (None, self._subject.uid):
            what = (
                f"shm.owner is {settings.owner}, and {user_name(self._subject.uid)} may not give files away"
            )
            remedy = f"Start the bridge as {settings.owner}, or remove shm.owner."
            yield kind("DOC502").found(what, remedy, level=Level.WARNING)
        elif self._subject.uid != 0 and gid is not None and gid not in {os.getegid(), *os.getgroups()}:
            what = f"shm.group is {settings.group}, and {user_name(self._subject.uid)} is not in it"
            remedy = "Put the bridge's user into the group, and log in again."
            command = f"sudo usermod --append --groups {settings.group} {user_name(self._subject.uid)}"
            yield kind("DOC502").found(what, remedy, command, level=Level.WARNING)
        else:
            yield kind("DOC502").fine(
                "objects can be given to the owner and group that the configuration names"
            )

    # The machine.

    def _machine(self) -> Iterator[Finding]:
        yield from machine.architecture(platform.machine(), platform.release(), byte_order=sys.byteorder)
        yield from machine.clock(time.time())
        yield from machine.open_files(
            resource.getrlimit(resource.RLIMIT_NOFILE)[0], len(self._subject.topics)
        )
        priority, locked = (
            resource.getrlimit(which)[0] for which in (resource.RLIMIT_RTPRIO, resource.RLIMIT_MEMLOCK)
        )
        held = machine.capabilities(self._q.root / "proc/self/status")
        yield from machine.real_time(priority, locked, held)

    def _logout(self) -> Iterator[Finding]:
        # Whose objects are there already is who the bridge runs as; the doctor may be asked by another.
        seen = leftovers.concerned(self._objects or Objects(), self._subject.prefix)
        uid = max((each.status.st_uid for each in seen), default=self._subject.owner_id())
        return machine.logout(self._q.root, uid, user_name(uid))

    def _packages(self) -> Iterator[Finding]:
        yield from packages.packages(packages.needed(), platform.python_version(), __version__)
        yield from packages.wheels(platform.machine(), (sys.version_info[0], sys.version_info[1]))

    def _backend(self) -> Iterator[Finding]:
        if self._subject.project is None:
            distro = self._q.variables.get("ROS_DISTRO") or "jazzy"
            return packages.backend(distro, "auto", self._q.variables, configured=False)
        ros = self._subject.project.config.settings.ros
        with suppress(RosplcError):  # the same is found below
            self._subject.chosen = choose_backend(self._subject.project.config, self._q.variables).name
        return packages.backend(
            ros.distro, ros.backend, self._q.variables, zenoh_settings=ros.zenoh is not None
        )

    # Shared memory.

    def _memory(self) -> Iterator[Finding]:
        directory = self._subject.directory
        mount = shm_mount(self._q.root / "proc/self/mountinfo")
        yield from memory.mounted(directory, mount)
        if directory.is_dir():
            yield from memory.mode(directory, writable=os.access(directory, os.W_OK | os.X_OK))
            needed, present = self._subject.sizes()
            yield from memory.room(directory, os.statvfs(directory), needed, present)

    def _look_at_objects(self) -> Iterable[Finding]:
        held = held_files(self._q.root / "proc")
        self._objects = look_at_objects(
            self._subject.directory,
            held,
            prefix=self._subject.prefix,
            seconds=_LOOK_S,
        )
        return ()

    def _leftovers(self) -> Iterator[Finding]:
        assert self._objects is not None
        configured = None
        if self._subject.project is not None:
            configured = {
                self._subject.project.namespace.path(p.topic)
                for p in self._subject.topics
                if p.port == "channel"
            }
        yield from leftovers.leftovers(self._objects, self._subject.prefix, configured)
        yield from leftovers.soundness(self._objects, self._subject.prefix)
        owners = {self._subject.uid, self._subject.owner_id()}
        yield from leftovers.ownership(
            self._objects, self._subject.prefix, owners, root=self._subject.uid == 0
        )

    def _classic_objects(self) -> Iterator[Finding]:
        bits = 64 if sys.maxsize > 1 << 32 else 32
        plans = [
            (plan.topic, plan.classic, plan.layout.size) for plan in self._subject.classic if plan.classic
        ]
        yield from classic.locks(self._subject.directory, [each for _, each, _ in plans], bits)
        yield from classic.sizes(self._subject.directory, plans)

    # The PLC.

    def _plc(self) -> Iterator[Finding]:
        self._runtimes = find_runtimes(self._q.root / "proc")
        wide = platform.machine() in ("x86_64", "aarch64", "ppc64le", "riscv64")
        locked = any(plan.classic is not None and plan.classic.semaphore for plan in self._subject.topics)
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
            yield from rights.rights(self._subject.files(self._objects or Objects()), uid, gids)
        plans = [plan.classic for plan in self._subject.classic if plan.classic is not None]
        if plans and users:
            uids = sorted(uid for uid, _ in users)
            yield from classic.create_or_open(self._q.root, self._subject.directory, plans, uids)

    # ROS.

    def _variables(self) -> Iterator[Finding]:
        variables, wish = self._q.variables, self._subject.wish()
        for look in (environment.distro, environment.values, environment.domain):
            yield from look(variables, wish)
        yield from environment.middleware(variables, wish)
        yield from environment.reach(variables, wish)

    def _addresses(self) -> Iterator[Finding]:
        return environment.addresses(
            self._q.variables, self._subject.wish(), resolve=network.resolve, is_local=network.is_local
        )

    def _network(self) -> Iterator[Probe]:
        wish = self._subject.wish()
        if wish is not None and wish.backend == "memory":
            return
        if wish is not None and wish.ros1:
            uri = self._q.variables.get("ROS_MASTER_URI") or "http://localhost:11311"
            yield Probe("the ROS master", Area.ROS, lambda: network.master(uri), 8.0)
        elif wish is not None and wish.backend == "zenoh":
            locators = self._subject.locators()
            yield Probe(
                "the Zenoh router", Area.ROS, lambda: network.routers(locators), 4.0 + 3.0 * len(locators)
            )
        else:
            yield Probe("network interfaces", Area.ROS, lambda: network.multicast(self._q.root / "sys"))
            rmw = self._q.variables.get("RMW_IMPLEMENTATION", "").strip()
            backend = "" if wish is None else wish.backend
            if backend == "dds" or (backend == "rclpy" and rmw != "rmw_zenoh_cpp"):
                cyclone = backend == "dds" or rmw == "rmw_cyclonedds_cpp"
                yield Probe("receive buffers", Area.ROS, lambda: self._buffers(cyclone=cyclone))

    def _buffers(self, *, cyclone: bool) -> Iterator[Finding]:
        return network.receive_buffers(self._subject.topics, self._q.root, cyclone=cyclone)

    def _carried(self) -> list[live.Carried]:
        project, objects = self._subject.project, self._objects
        if project is None or objects is None:
            return []
        return [
            live.Carried(plan, objects.of(project.namespace, plan.topic))
            for plan in self._subject.topics
            if plan.port == "channel"
        ]

    def _classic_held(self) -> dict[str, bool]:
        """Return classic topic → whether a bridge holds the lock file of its memory."""
        held = held_files(self._q.root / "proc")
        return {
            plan.topic: bool(is_held(self._subject.directory / f"rosplc.classic.{plan.classic.name}", held))
            for plan in self._subject.classic
            if plan.classic is not None
        }

    def _live(self) -> Iterator[Finding]:
        carried = self._carried()
        yield from live.holders(carried, self._classic_held(), str(self._q.config))
        yield from live.layouts(carried)
        yield from live.beating(carried)
        yield from live.refusals(carried)

    def _graph(self) -> Iterator[Finding]:
        project, config = self._subject.project, self._q.config
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
            seen,
            self._subject.topics,
            lambda name: "" if silent else project.store.type_hash(name),
            bridge_runs=runs,
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
        if self._subject.project is not None:
            project = self._subject.project
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
            yield from code.against_live(found, self._objects, self._subject.directory)
        yield from code.fences(found, platform.machine(), command)

    def _regenerated(
        self, project: Project, folder: Path, found: Generated, command: str
    ) -> tuple[list[Finding], dict[str, str]]:
        top = folder if (folder / "st").is_dir() else folder.parent
        result: tuple[list[Finding], dict[str, str]] = ([], {})
        for pins in (False, True):
            options = ProjectOptions(
                target="arm" if found.arm else "x86",
                fenced=found.fenced,
                programs=found.programs,
                pins=pins,
            )
            result = code.files(top, expected_files(project, options), command)
            if not any(each.level for each in result[0]):
                break
        return result
