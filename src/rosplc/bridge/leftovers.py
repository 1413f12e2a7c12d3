"""What a bridge does before it opens objects: check that the names are free, and retire leftovers."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from rosplc.bridge.called import CalledGoals
from rosplc.bridge.port import Context, log
from rosplc.config.plans import ActionPlan, CallPlan
from rosplc.config.resolve import Project, rights
from rosplc.errors import ChannelError, RosplcError
from rosplc.layout import compute_layout
from rosplc.proc import held_files, holder, name_of
from rosplc.ros import Backend
from rosplc.shm import ACTION, Description, Direction, Identity, OwnedChannel, Part, attach, open_object
from rosplc.shm.files import NameLock

_Name = tuple[str, Part, str]  # an object: topic, service or action, what it carries, and the client


def check_names(project: Project) -> None:
    """Try the lock of every configured name; SHM116, with nothing changed, if another process holds one."""
    namespace, allowed = project.namespace, rights(project.config)
    for name in _objects(project):
        path = namespace.lock_path(*name)
        try:
            NameLock(path, allowed).release()
        except ChannelError as error:
            if error.code in ("SHM119", "SHM121"):
                continue  # a stranger's: a problem of this topic alone
            if error.code != "SHM116":
                raise
            what = f"{_holder(project, name, path)} holds {' '.join(filter(None, (name[0], name[2])))}"
            raise ChannelError("SHM116", what, where=error.where) from None


class Leaving(CalledGoals):
    """A ROS action that was removed from the configuration: a goal of the PLC that is open is canceled."""

    def connect(self, backend: Backend) -> None:
        """Become the action's client if there is such a goal."""
        if (left := self._left()) is None:
            return
        self._bereft(left)
        try:
            super().connect(backend)
        except RosplcError as error:  # no reason not to carry what is configured
            log.warning("the goal left open in action %s was not canceled: %s", self.plan.action, error)

    def ask(self, now_ns: int) -> None:
        """Continue until the server has answered."""
        if self._goals:
            self._hear(now_ns)
            self._ask(now_ns)
            if not self._goals:
                self.disconnect()


def leaving(project: Project, context: Context) -> Iterator[Leaving]:
    """Yield the ROS actions that were removed from the configuration, not connected."""
    store = project.store
    for said, _ in _leftovers(project):
        if (said.part, said.direction) != (Part.GOAL, Direction.TO_ROS):
            continue
        try:
            kind = store.action(said.type.removesuffix("_Goal"))
            about: dict[str, Any] = {"server": "ros", "client": said.client, "task": ""}
            about |= {part.word: compute_layout(store, getattr(kind, part.word).name) for part in ACTION}
        except RosplcError as error:
            log.warning("a goal left open in action %s was not canceled: %s", said.topic, error)
            continue
        plan = ActionPlan(action=said.topic, type_name=kind.name, **about)
        yield Leaving(plan, context, lambda _: None)


def retire_leftovers(project: Project) -> None:
    """Retire the objects that were removed from the configuration (spec, section 8.7)."""
    given = rights(project.config)
    for said, identity in _leftovers(project):
        size, slots = identity.record_size, identity.slot_count
        try:
            OwnedChannel.open(project.namespace, said, record_size=size, slots=slots, rights=given).retire()
        except (ChannelError, OSError, ValueError) as error:
            log.debug("%s is left unchanged: %s", said.topic, error)
        else:
            log.info("%s is no longer configured; its %s object has been retired", said.topic, said.part.word)


def _leftovers(project: Project) -> Iterator[tuple[Description, Identity]]:
    """Yield the descriptions of objects removed from the configuration, except those of other bridges."""
    namespace = project.namespace
    kept = {namespace.object_name(*name) for name in _objects(project)}
    for name, _ in namespace.objects():
        try:
            with open_object(f"{namespace.directory}/{name}") as found:
                said, identity = found.description, found.identity
            own = namespace.object_name(said.topic, said.part, said.client)
        except (ChannelError, OSError) as error:
            log.debug("%s is left unchanged: %s", name, error)
            continue
        if name == own and name not in kept and said.bridge == project.config.settings.bridge:
            yield said, identity


def _objects(project: Project) -> Iterator[_Name]:
    """Yield the objects of a configuration."""
    for plan in project.plans:
        if isinstance(plan, CallPlan):
            yield from ((plan.called, part, plan.client) for part in plan.parts)
        elif plan.port == "channel":
            yield plan.topic, Part.TOPIC, ""


def _holder(project: Project, name: _Name, lock: Path) -> str:
    """Describe the holder of a name's lock, as far as the kernel and the object show it."""
    held = holder(lock, held_files())
    try:
        with attach(project.namespace, name[0], part=name[1], client=name[2]) as found:
            state = found.snapshot()
            to_plc = found.identity.direction is Direction.TO_PLC
            pid = state.writer.pid if to_plc else state.readers[0].pid
            # A container shows other numbers: without the kernel's word the object's is believed.
            if held in (0, pid):
                return f"bridge {found.description.bridge}, process {pid},"
    except (ChannelError, OSError):
        pass
    if not held:
        return "another process"
    return f"process {held}{name_of(held)}, which has not opened its object,"
