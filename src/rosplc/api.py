"""Channels for any Python program on the machine: attach to a topic, read, write.

Neither ROS nor a configuration is needed: each object in shared memory describes itself.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from rosplc.described import layout_of
from rosplc.errors import ChannelError
from rosplc.layout import Layout, RecordView
from rosplc.monitor import ObjectState, find_objects
from rosplc.shm import Attached, Description, Direction, Namespace, Reader, SlotInfo, Snapshot, Writer
from rosplc.shm import attach as attach_object

_REOPEN_SECONDS = 0.1
_MOVED_SECONDS = 1.0


def include_dir() -> Path:
    """Return the folder with the C headers ``rosplc/*.h``; pass it to a C or C++ compiler with ``-I``."""
    return Path(__file__).parent / "include"


def attach(
    topic: str,
    *,
    prefix: str = "rosplc",
    write: bool = False,
    latched: bool = False,
    layout: Layout | None = None,
    task: str = "",
    directory: str = "/dev/shm",
    timeout: float = 0.0,
) -> Channel:
    """Attach to a topic that a bridge on this machine carries.

    Args:
        topic: The topic's ROS name, such as ``"/cmd_vel"``.
        prefix: The bridge's ``prefix:``.
        write: Also claim the channel, to publish to ROS; only one writer at a time is allowed.
        latched: Treat a message that is already in the channel as new.
        layout: The expected layout; None uses the object's self-description.
        task: A name that other programs can see; it claims a reader line, which requires write
            access. Without a name, this reader is an invisible observer.
        directory: The folder that contains the objects.
        timeout: Seconds to wait for the object to appear.

    Returns:
        The channel, which is a context manager.

    Raises:
        ChannelError: SHM101 if the object does not exist; SHM102 without permission; SHM112 if
            ``layout`` differs from the object's; SHM114 if another writer holds the claim; and
            the other errors of spec/shm-format.md, section 9.
    """
    deadline, names = time.monotonic() + timeout, Namespace(prefix, directory)
    while True:
        try:
            return Channel(topic, namespace=names, write=write, latched=latched, layout=layout, task=task)
        except ChannelError as error:
            if error.code != "SHM101" or not time.monotonic() < deadline:  # NaN is no time to wait
                raise
            time.sleep(min(0.05, max(0.0, deadline - time.monotonic())))


def topics(prefix: str | None = None, *, directory: str = "/dev/shm") -> list[ObjectState]:
    """Return the channels on this machine, including unreadable ones (with ``error`` set).

    The call takes about a third of a second, to detect which programs are alive. With ``prefix``, it returns
    only the channels of that bridge. Raises ChannelError SHM118 or SHM123.
    """
    return find_objects(directory, prefix=prefix)


class Channel:
    """One topic's channel, read and written as typed records; created by :func:`attach`.

    If a bridge replaces the object (because the layout changed or the file was removed), the
    next call attaches to the new object, and unread messages of the old object are lost. While
    no object exists, reading returns None and writing raises an error.

    Only one thread at a time may use a channel.

    Attributes:
        topic: The topic's ROS name.
        layout: The record's layout.
    """

    def __init__(
        self,
        topic: str,
        *,
        namespace: Namespace,
        write: bool,
        latched: bool,
        layout: Layout | None,
        task: str,
    ) -> None:
        self.topic = topic
        self._info: SlotInfo | None = None
        self._namespace = namespace
        self._write = write
        self._latched = latched
        self._expected = layout
        self._task = task
        self._closed = False
        self._attached: Attached | None = None
        self._retry_at = 0.0
        self._moved_at = 0.0
        self._lost_before = 0
        self._open()

    @property
    def type_name(self) -> str:
        """The message type, ``package/msg/Name``."""
        return self.layout.type_name

    @property
    def direction(self) -> Direction:
        """``TO_PLC`` or ``TO_ROS``."""
        return self._description.direction

    @property
    def description(self) -> Description:
        """The object's self-description."""
        return self._description

    @property
    def attached(self) -> bool:
        """Whether an object is open and in use."""
        return self._attached is not None

    @property
    def info(self) -> SlotInfo | None:
        """The slot header of the last returned message (sequence, stamp, flags, lost), or None."""
        return self._reader.info or self._info

    @property
    def lost(self) -> int:
        """The number of messages that this channel missed, including skipped ones."""
        return self._lost_before + (self._reader.lost if self._attached is not None else 0)

    @property
    def retries(self) -> int:
        """Copies discarded since attaching, because the writer might have changed the slot meanwhile."""
        return self._reader.retries

    def snapshot(self) -> Snapshot:
        """Return the counters and heartbeats of writer and readers.

        Raises ChannelError: SHM101 while no object exists.
        """
        return self._need().snapshot()

    def read(self) -> RecordView | None:
        """Return the newest message if it has not been returned yet, else None.

        Older unread messages are skipped and counted in :attr:`lost`.
        """
        return self._take(0)

    def current(self) -> RecordView | None:
        """Return the newest message, even if already returned; None if there is none."""
        return self._take(2)

    def every(self, timeout: float | None = 0.0, *, poll: float = 0.001) -> Iterator[RecordView]:
        """Yield messages in order, each once.

        The iteration ends when no message arrives within ``timeout`` seconds: 0 ends it after the last
        available message, None waits forever. ``poll`` is the polling interval in seconds.
        """
        while True:
            message = self._wait(1, timeout, poll)
            if message is None:
                return
            yield message

    def wait(self, timeout: float | None = None, *, poll: float = 0.001) -> RecordView | None:
        """Wait for a new message and return it; None after ``timeout`` seconds (None: wait forever).

        ``poll`` is the polling interval in seconds. Because readers poll, a PLC does not wake them and its
        scans make no system calls.
        """
        return self._wait(0, timeout, poll)

    def write(self, value: Mapping[str, Any] | RecordView | object, *, stamp_ns: int | None = None) -> int:
        """Publish a message to ROS, and return its sequence number.

        ``value`` is a mapping, a record view, or any object with the fields as attributes (a ROS message);
        missing fields have their initial values. ``stamp_ns`` is the source's time stamp in ns since 1970 UTC
        (None: now). Raises LayoutError LAY006 if a value does not fit its field; ChannelError SHM122 without
        ``write=True``, SHM115 if another writer has taken the claim, SHM101 while no object exists.
        """
        if not self._write:
            raise ChannelError("SHM122", "the channel was attached for reading only", where=self.topic)
        again = True
        while True:
            try:
                if self._attached is not None:
                    assert self._writer is not None
                    if sequence := self._writer.publish_value(self._shape, value, stamp_ns, self._moved_at):
                        return sequence
            except ChannelError as error:
                if error.code not in ("SHM111", "SHM112") or not again:
                    raise
                again = False
                self._drop()
            self._need()

    def close(self) -> None:
        """Release claims and detach from the object; a second call does nothing."""
        self._closed = True
        self._drop()

    def __enter__(self) -> Channel:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __repr__(self) -> str:
        arrow = "to the PLC" if self.direction is Direction.TO_PLC else "to ROS"
        return f"Channel({self.topic}, {self.type_name}, {arrow})"

    def _open(self) -> None:
        attached = attach_object(
            self._namespace,
            self.topic,
            layout_id=None if self._expected is None else self._expected.layout_id,
            record_size=None if self._expected is None else self._expected.size,
            write=self._write or bool(self._task),
        )
        try:
            description = attached.description
            layout = self._expected or layout_of(attached)
            reader = attached.reader(self._task, latched=self._latched, observe=not self._task)
            # 0: a program that writes now and then promises no beat; a killed one is replaced after 1 s.
            writer = attached.writer(beat_ms=0) if self._write else None
        except BaseException:
            attached.close()
            raise
        self._attached, self._description, self.layout = attached, description, layout
        self._shape = layout.shape
        self._reader: Reader = reader
        self._writer: Writer | None = writer
        self._moved_at = time.monotonic() + _MOVED_SECONDS

    def _drop(self) -> None:
        if self._attached is not None:
            self._lost_before += self._reader.lost
            self._info = self.info
            self._attached.close()
            self._attached = None

    def _follow(self) -> bool:
        """Return whether an object is open, after one attempt to find a new one if it is due."""
        if self._closed:
            raise ValueError(f"the channel of {self.topic} is closed")
        now = time.monotonic()
        if self._attached is not None and now >= self._moved_at:
            self._moved_at = now + _MOVED_SECONDS
            if not self._attached.still_there():
                self._drop()
        if self._attached is None and now >= self._retry_at:
            self._retry_at = now + _REOPEN_SECONDS
            try:
                self._open()
            except ChannelError as error:
                if error.code not in ("SHM101", "SHM111"):
                    raise
        return self._attached is not None

    def _need(self) -> Attached:
        if not self._follow():
            raise ChannelError("SHM101", "the topic has no object at the moment", where=self.topic)
        assert self._attached is not None
        return self._attached

    def _take(self, how: int) -> RecordView | None:
        while self._attached is not None or self._follow():
            try:
                found: Any = self._reader.view(self._shape, how, self._moved_at)
            except ChannelError as error:
                if error.code not in ("SHM111", "SHM112"):
                    raise
                self._drop()
                return None
            if found is not False:
                return found  # type: ignore[no-any-return] # a view of the shape's class
            self._follow()
        return None

    def _wait(self, how: int, timeout: float | None, poll: float) -> RecordView | None:
        deadline = None if timeout is None else time.monotonic() + timeout
        while True:
            message = self._take(how)
            if message is not None:
                return message
            if deadline is None:
                time.sleep(poll)
                continue
            rest = deadline - time.monotonic()
            if not rest > 0:
                return None
            time.sleep(min(poll, rest))
