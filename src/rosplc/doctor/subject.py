"""What is to be examined, and what the configuration makes of it on this machine."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from rosplc.config import Project, TopicPlan
from rosplc.config.resolve import group_id, object_size, user_id
from rosplc.doctor.environment import Wish
from rosplc.doctor.leftovers import concerned
from rosplc.doctor.objects import Objects
from rosplc.doctor.rights import File
from rosplc.errors import RosplcError
from rosplc.ros import ROS1

__all__ = ["Question", "Subject"]


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
    """

    config: Path | None = None
    code: Path | None = None
    plc_user: str = ""
    ros: bool = True
    seconds: float = 4.0
    root: Path = Path("/")
    directory: Path = Path("/dev/shm")
    variables: Mapping[str, str] = field(default_factory=lambda: dict(os.environ))


class Subject:
    """A question with the project of its configuration, once that is read.

    Args:
        question: What is to be examined.

    Attributes:
        project: The configuration's project; None without one, and while it is not read.
        chosen: The backend that the configuration leads to; empty while that is not known.
        uid: The user who asks.
    """

    def __init__(self, question: Question) -> None:
        self.question = question
        self.project: Project | None = None
        self.chosen = ""
        self.uid = os.geteuid()

    @property
    def topics(self) -> tuple[TopicPlan, ...]:
        """The configuration's topics; none without one."""
        return () if self.project is None else self.project.topics

    @property
    def classic(self) -> list[TopicPlan]:
        """Those in classic mode."""
        return [plan for plan in self.topics if plan.classic is not None]

    @property
    def directory(self) -> Path:
        """Where objects lie."""
        return self.question.directory if self.project is None else Path(self.project.namespace.directory)

    @property
    def prefix(self) -> str | None:
        """The configuration's prefix; None without one."""
        return None if self.project is None else self.project.namespace.prefix

    def wish(self) -> Wish | None:
        """Return what the configuration says about ROS; None without one."""
        if self.project is None:
            return None
        ros = self.project.config.settings.ros
        return Wish(ros.distro, ros.distro == ROS1, self.chosen, ros.domain)

    def owner_id(self) -> int:
        """Return who owns, or would own, the objects."""
        if self.project is None:
            return self.uid
        try:
            found = user_id(self.project.config)
        except RosplcError:
            return self.uid
        return self.uid if found is None else found

    def sizes(self) -> tuple[int, int]:
        """Return the bytes that the configuration's objects take, and those that are there already."""
        if self.project is None:
            return 0, 0
        needed = present = 0
        for plan in self.topics:
            path = self.directory / self.project.object_name(plan)
            size = object_size(self.project, plan) if plan.port == "channel" else plan.layout.size
            needed += size
            if path.is_file():
                present += min(size, path.stat().st_blocks * 512)
        return needed, present

    def files(self, objects: Objects) -> list[File]:
        """Return the objects as they are; where the configuration's are missing, as they would be."""
        files, there = [], set()
        for seen in concerned(objects, self.prefix):
            status = seen.status
            files.append(File(seen.topic, status.st_uid, status.st_gid, status.st_mode & 0o7777))
            there.add(seen.topic)
        if self.project is None:
            return files
        uid, gid = self.owner_id(), os.getegid()
        try:
            wanted = group_id(self.project.config)
        except RosplcError:
            wanted = None
        mode = self.project.config.settings.shm.mode
        for plan in self.topics:
            names = [plan.topic if plan.port == "channel" else self.project.object_name(plan)]
            if plan.classic is not None and plan.classic.semaphore:
                names.append(f"sem.{plan.classic.semaphore}")
            for name in names:
                path = self.directory / name.lstrip("/") if plan.classic else None
                if path is not None and path.is_file():
                    status = path.stat()
                    files.append(File(name, status.st_uid, status.st_gid, status.st_mode & 0o7777))
                elif name not in there:
                    files.append(File(name, uid, gid if wanted is None else wanted, mode))
        return files

    def locators(self) -> tuple[str, ...]:
        """Return where a Zenoh session would connect to, as far as that can be told."""
        assert self.project is not None
        zenoh = self.project.config.settings.ros.zenoh
        if zenoh is not None and zenoh.connect:
            return zenoh.connect
        # A file or a variable may say otherwise; what they say only the library can read.
        others = (zenoh is not None and zenoh.config) or self.question.variables.get(
            "ZENOH_SESSION_CONFIG_URI"
        )
        return (
            () if others or self.question.variables.get("ZENOH_CONFIG_OVERRIDE") else ("tcp/localhost:7447",)
        )
