"""Writing one test message into a channel that no one else writes.

A claim other than 0 is never taken, however long its holder has been silent: Structured Text stores no
process number, and a PLC in another container or at a breakpoint would find its claim gone. A person frees
the claim of a dead PLC with ``rosplc release``. Towards the PLC the page must also get the lock of the
object's name, which a running bridge holds.
"""

from __future__ import annotations

import stat
import time
from pathlib import Path
from typing import Any

from rosplc.described import layout_of
from rosplc.errors import ChannelError, WebError
from rosplc.shm import Attached, Direction, Namespace, OwnedChannel, Region, Writer
from rosplc.shm import attach as attach_object
from rosplc.shm.constants import STAMP_SYSTEM
from rosplc.web.form import form_of, from_form, refuse_unsafe

__all__ = ["write_message"]

_BEAT_MS = 1000


def write_message(
    namespace: Namespace, topic: str, layout_id: str, message: dict[str, Any], *, not_finite: bool = False
) -> int:
    """Write one message and return its sequence number.

    Args:
        namespace: Where the channel lies.
        topic: As ROS writes it.
        layout_id: The layout that the message was made for.
        message: Nested dicts and lists; what it lacks takes its initial value. Numbers may be text.
        not_finite: Whether NaN and infinities are meant.

    Raises:
        WebError: WEB010, another writer has the channel, or the channel has another layout by now.
        LayoutError: LAY006, a value does not fit its field, or is not finite.
        ChannelError: SHM101 and the others of :func:`rosplc.attach`.
    """
    with attach_object(namespace, topic) as attached:
        layout = layout_of(attached)
        if layout.layout_id != layout_id:
            raise WebError(
                "WEB010",
                "the channel has another layout than the form was made for",
                where=topic,
                remedy="Open the form again.",
            )
        form = form_of(layout)
        value = from_form(form, message)
        record = bytes(layout.pack(value))
        refuse_unsafe(form, message, not_finite=not_finite)
        _refuse_other_writer(attached, topic)
        if attached.identity.direction is Direction.TO_PLC:
            return _to_plc(namespace, attached, record)
    with attach_object(namespace, topic, write=True) as attached:
        return _publish(attached.region, attached.identity.layout_id == layout_id, topic, record)


def _refuse_other_writer(attached: Attached, topic: str) -> None:
    writer = attached.snapshot().writer
    if writer.epoch:
        who = f"process {writer.pid}{_name_of(writer.pid)}" if writer.pid else "a PLC program"
        raise _claimed(topic, who)


def _claimed(topic: str, who: str) -> WebError:
    return WebError(
        "WEB010",
        f"{who} holds the writer's claim",
        where=topic,
        remedy=f"Stop that writer. If it crashed, free its claim: `rosplc release {topic}`.",
    )


def _name_of(pid: int) -> str:
    try:
        name = Path(f"/proc/{pid}/comm").read_text(errors="replace").strip()
    except OSError:
        return ""
    return f" ({name})"


def _publish(region: Region, same_layout: bool, topic: str, record: bytes) -> int:
    """Claim a free writer's line, publish, and give the claim back."""
    try:
        writer = Writer(region, 0, _BEAT_MS)
    except ChannelError as error:
        if error.code == "SHM114":
            raise _claimed(topic, "another writer") from error
        raise
    try:
        if not same_layout:  # replaced between two looks
            raise WebError("WEB010", "the channel has another layout by now", where=topic)
        return writer.publish(record, stamp_ns=time.time_ns(), stamp_clock=STAMP_SYSTEM)
    finally:
        writer.release()


def _to_plc(namespace: Namespace, attached: Attached, record: bytes) -> int:
    found = Path(attached.path).stat()
    try:
        with OwnedChannel.open(
            namespace,
            attached.description,
            record_size=attached.identity.record_size,
            slots=attached.identity.slot_count,
            mode=stat.S_IMODE(found.st_mode),
            uid=found.st_uid,
            gid=found.st_gid,
        ) as channel:
            return _publish(channel.region, True, channel.description.topic, record)
    except ChannelError as error:
        if error.code == "SHM116":
            what = "a bridge has the channel, and writes what comes from ROS"
            raise WebError("WEB010", what, where=attached.description.topic) from error
        raise
