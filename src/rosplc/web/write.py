"""Writing one test message into a channel that nobody else writes.

Towards ROS the channel is claimed as any writer claims it. Towards the PLC only the holder of the
name's lock may write, and while a bridge runs that is the bridge: the page writes there only while
none does. Either claim is given back at once.
"""

from __future__ import annotations

import stat
import time
from pathlib import Path
from typing import Any

from rosplc.api import attach
from rosplc.described import layout_of
from rosplc.errors import ChannelError, WebError
from rosplc.layout import Layout
from rosplc.shm import Attached, Direction, Namespace, OwnedChannel
from rosplc.shm import attach as attach_object
from rosplc.web.form import form_of, from_form

__all__ = ["write_message"]


def write_message(namespace: Namespace, topic: str, layout_id: str, message: dict[str, Any]) -> int:
    """Write one message and return its sequence number.

    Args:
        namespace: Where the channel lies.
        topic: As ROS writes it.
        layout_id: The layout that the message was made for.
        message: Nested dicts and lists; what it lacks takes its initial value. Numbers may be text.

    Raises:
        WebError: WEB010, another writer has the channel, or the channel has another layout by now.
        LayoutError: LAY006, a value does not fit its field.
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
        value = from_form(form_of(layout), message)
        record = layout.pack(value)
        _refuse_other_writer(attached, topic)
        towards_plc = attached.identity.direction is Direction.TO_PLC
        if towards_plc:
            return _to_plc(namespace, attached, bytes(record))
    return _to_ros(namespace, topic, layout, value)


def _refuse_other_writer(attached: Attached, topic: str) -> None:
    """Raise WEB010 if the claim's holder lives, even if it has been silent for long.

    By the format a silent holder's claim may be taken over. A test message is no reason to: a PLC
    that was stopped for a moment would find its claim gone.
    """
    writer = attached.snapshot().writer
    if writer.epoch and writer.pid and Path(f"/proc/{writer.pid}").exists():
        what = f"process {writer.pid}{_name_of(writer.pid)} is its writer"
        raise WebError("WEB010", what, where=topic)


def _name_of(pid: int) -> str:
    try:
        name = Path(f"/proc/{pid}/comm").read_text(errors="replace").strip()
    except OSError:
        return ""
    return f" ({name})"


def _to_ros(namespace: Namespace, topic: str, layout: Layout, value: dict[str, Any]) -> int:
    try:
        with attach(
            topic,
            prefix=namespace.prefix,
            directory=str(namespace.directory),
            write=True,
            layout=layout,
        ) as channel:
            return channel.write(value)
    except ChannelError as error:
        if error.code in ("SHM114", "SHM115"):
            raise WebError("WEB010", error.what, where=topic) from error
        raise


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
            return channel.writer().publish(record, stamp_ns=time.time_ns())
    except ChannelError as error:
        if error.code == "SHM116":
            what = "a bridge has the channel, and writes what comes from ROS"
            raise WebError("WEB010", what, where=attached.description.topic) from error
        raise
