"""What a bridge does to names before it opens them: refuse at once, and retire what it dropped."""

from __future__ import annotations

from rosplc.bridge.owner import group_id, user_id
from rosplc.bridge.topic import log
from rosplc.config.resolve import Project
from rosplc.errors import ChannelError
from rosplc.shm import Direction, OwnedChannel, attach
from rosplc.shm.lock import NameLock

__all__ = ["retire_leftovers"]


def retire_leftovers(project: Project) -> None:
    """Retire objects of topics that have left this bridge's configuration (spec, section 8.7).

    Every configured name's lock is tried first: if another bridge holds one, nothing is
    disturbed. Objects of other bridges, by the name in their self-description, are left alone.

    Raises:
        ChannelError: SHM116, or what else keeps a lock from being taken.
    """
    namespace, mode, uid = project.namespace, project.config.settings.shm.mode, user_id(project.config)
    channels = [plan for plan in project.topics if plan.classic is None]
    for plan in channels:
        try:
            NameLock(namespace.lock_path(plan.topic), mode=mode, uid=uid).release()
        except ChannelError as error:
            if error.code != "SHM116":
                raise
            what = f"{_holder(project, plan.topic)} holds {plan.topic}"
            raise ChannelError("SHM116", what, where=error.where) from None
    kept = {namespace.object_name(plan.topic) for plan in channels}
    for name in namespace.topics():
        topic = namespace.topic_of(name)
        if topic is None or name in kept:
            continue
        try:
            _retire(project, topic)
        except (ChannelError, OSError, ValueError) as error:
            log.debug("%s is left alone: %s", name, error)


def _holder(project: Project, topic: str) -> str:
    """Say who holds a name, as far as its object tells."""
    try:
        with attach(project.namespace, topic) as found:
            state = found.snapshot()
            to_plc = found.identity.direction is Direction.TO_PLC
            pid = state.writer.pid if to_plc else state.readers[0].pid
            return f"bridge {found.description.bridge}, process {pid},"
    except (ChannelError, OSError):
        return "another bridge"


def _retire(project: Project, topic: str) -> None:
    with attach(project.namespace, topic) as found:
        description, identity = found.description, found.identity
    if description.bridge != project.config.settings.bridge or description.topic != topic:
        return
    channel = OwnedChannel.open(
        project.namespace,
        description,
        record_size=identity.record_size,
        slots=identity.slot_count,
        mode=project.config.settings.shm.mode,
        uid=user_id(project.config),
        gid=group_id(project.config),
    )
    channel.retire()
    log.info("%s has left the configuration; its object is retired", topic)
