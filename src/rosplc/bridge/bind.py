"""Access to a topic's object from a user's own ROS node, without a backend."""

from __future__ import annotations

import importlib
import logging
import os
import threading
import weakref
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from pathlib import Path
from typing import Any, ClassVar, Literal, cast

from rosplc.clock import SYSTEM, Clock
from rosplc.codec import Codec, Fault
from rosplc.described import description_of
from rosplc.errors import ChannelError, MessageTypeError
from rosplc.layout import Limits, compute_layout
from rosplc.model import DISTROS, TypeStore
from rosplc.shm import Description, Direction, Namespace, OwnedChannel
from rosplc.shm.files import Rights

_log = logging.getLogger("rosplc.bind")
_LOOK_NS = 1_000_000_000
BEAT_MS = 100  # the beat that is promised and kept, in milliseconds
_DIRECTIONS = {"to_plc": Direction.TO_PLC, "to_ros": Direction.TO_ROS}


def bind(
    topic: str,
    type: str | type,
    direction: Literal["to_plc", "to_ros"] = "to_plc",
    *,
    print: bool = False,
    limits: Limits | Mapping[str, int] | None = None,
    truncate: bool = False,
    every: bool = False,
    slots: int = 4,
    distro: str | None = None,
    paths: Iterable[Path | str] = (),
    prefix: str = "rosplc",
    directory: Path | str = "/dev/shm",
    mode: int = 0o660,
    gid: int | None = None,
    name: str = "bind",
) -> Binding:
    """Create or adopt a topic's object, and own it until :meth:`Binding.close`.

    Args:
        topic: As ROS writes it, ``"/robot1/cmd_vel"``.
        type: ``"package/msg/Name"``, or an rclpy or rospy message class; with a class,
            :meth:`Binding.read` returns objects of this class.
        direction: ``"to_plc"`` to write, ``"to_ros"`` to read.
        print: Log each message (logger ``rosplc.bind``, level INFO) for debugging; to stderr if the
            program has not configured logging.
        limits: Capacities: a :class:`~rosplc.layout.Limits`, or a mapping from field paths to limits, in
            which ``string`` and ``sequence`` are the defaults. The PLC's code must be generated
            with the same limits.
        truncate: Cut off what does not fit instead of refusing the message (``to_plc``).
        every: Return every message in order, instead of the newest (``to_ros``).
        slots: A power of two, at least 4; up to ``slots - 1`` messages can wait.
        distro: The source of definitions; default: ``ROS_DISTRO``, else jazzy; with rospy classes, noetic.
        paths: Folders with custom ``.msg``, ``.srv`` and ``.action`` files.
        prefix: First part of the object's name.
        directory: The directory of the object.
        mode: The object's permission bits.
        gid: The object's group; None for the group of this process.
        name: The name of this program in the self-description.

    Raises:
        ChannelError: SHM116 if a bridge or another program holds the name; SHM117, SHM118, SHM119.
        MessageTypeError: TYP001 …, the type cannot be found.
        LayoutError: LAY001 …, the limits do not fit the type.
        ValueError: ``direction`` is invalid.
    """
    if direction not in _DIRECTIONS:
        raise ValueError(f"direction is {direction!r}; it must be 'to_plc' or 'to_ros'")
    message_class = None if isinstance(type, str) else type
    type_name = type if isinstance(type, str) else type_name_of(type)
    definition = definition_of(message_class)
    chosen = distro or ("noetic" if definition else _environment_distro())
    store = TypeStore.bundled(chosen).with_paths(Path(path) for path in paths)
    if type_name not in store and definition:
        store = store.with_definition(type_name, definition)
    layout = compute_layout(store, type_name, _limits(limits))
    description = description_of(layout, topic, _DIRECTIONS[direction], bridge=name, distro=chosen)
    codec = Codec(layout)

    names = Namespace(prefix, directory)
    size, own = layout.size, Rights(mode, gid=gid)
    made = partial(OwnedChannel.open, names, description, record_size=size, slots=slots, rights=own)
    return Binding(description, codec, made, message_class, print=print, truncate=truncate, every=every)


class Binding:
    """A topic's object that this process owns; returned by :func:`bind`; a context manager that closes it.

    While it is open, a background thread shows the PLC that this process is alive.

    Attributes:
        topic: The topic.
        layout: The record's layout.
        closed: Whether :meth:`close` was called.
    """

    def __init__(
        self,
        description: Description,
        codec: Codec,
        open_channel: Any,
        message_class: type | None,
        *,
        clock: Clock = SYSTEM,
        print: bool,
        truncate: bool,
        every: bool,
    ) -> None:
        self.topic = description.topic
        self.layout = codec.layout
        self._codec = codec
        self._open_channel = open_channel
        self._message_class = message_class
        self._clock = clock
        self._print, self._truncate, self._every = print, truncate, every
        if print:
            _be_heard()
        self._to_plc = description.direction is Direction.TO_PLC
        self._lock = threading.RLock()
        self._user: Any = None  # the writer or the reader
        self._channel: OwnedChannel | None = None
        self.closed = False
        self._open()
        Beats.add(self)

    def __repr__(self) -> str:
        way = "to the PLC" if self._to_plc else "to ROS"
        return f"Binding({self.topic}, {self.layout.type_name}, {way}{', closed' if self.closed else ''})"

    def write(self, message: Any, *, stamp_ns: int | None = None) -> int:
        """Write a message for the PLC, and return its sequence number.

        The message is an object of rclpy, rospy or rosbags, a mapping, or serialized bytes (CDR with header;
        for noetic, ROS 1 serialization). ``stamp_ns`` is the source stamp, ns since 1970 (None: now). Raises
        CodecError, with field, size and limit, if serialized bytes do not fit; LayoutError LAY006 if a value
        does not fit its field; ChannelError SHM110 if the direction is to_ros, SHM117 … if the object has
        vanished and cannot be created again.
        """
        if not self._to_plc:
            raise ChannelError("SHM110", "this binding can only read messages from the PLC", where=self.topic)
        stamp = self._clock.time_ns() if stamp_ns is None else stamp_ns
        sequence: int = self._use(lambda: self._put(message, stamp))
        if self._print:
            _log.info("%s was written: %s", self.topic, self._shown(message))
        return sequence

    def _use(self, work: Callable[[], Any]) -> Any:
        """Use the object; if it was retired, repeat this with a new object."""
        with self._lock:
            self._look_after()
            try:
                return work()
            except ChannelError:
                self._reopen()
                return work()

    def _put(self, message: Any, stamp_ns: int) -> Any:
        clock = 1 if stamp_ns else 0
        if not isinstance(message, (bytes, bytearray, memoryview)):
            record = self.layout.pack(message)
            return self._user.publish(record, stamp_ns=stamp_ns, stamp_clock=clock)
        try:
            return self._user.publish_wire(
                self._codec.plan, message, truncate=self._truncate, stamp_ns=stamp_ns, stamp_clock=clock
            )[0]
        except Fault as fault:
            raise self._codec.explain(fault) from None

    def read(self) -> Any:
        """Return a message from the PLC: the newest, or with ``every`` the next; None if there is no new one.

        The message is an object of the message class that was passed to :func:`bind`, otherwise a
        :class:`~rosplc.layout.RecordView` with the fields as attributes. Raises ChannelError SHM110 if the
        direction is to_plc; SHM117 … as for :meth:`write`.
        """
        record = self._take()
        if record is None:
            return None
        if self._message_class is not None:
            return deserialize(self._message_class, self._codec.encode(record))
        return self.layout.view(record)

    def read_bytes(self) -> bytes | None:
        """As :meth:`read`, but serialized, for ``publisher.publish(bytes)``."""
        record = self._take()
        return None if record is None else self._codec.encode(record)

    def _take(self) -> bytes | None:
        if self._to_plc:
            raise ChannelError("SHM110", "this binding can only write messages to the PLC", where=self.topic)
        record: bytes | None = self._use(self._next)
        if record is not None and self._print:
            _log.info("%s was read: %s", self.topic, self.layout.to_dict(record))
        return record

    def _next(self) -> bytes | None:
        found = self._user.next_record() if self._every else self._user.latest_record()
        return None if found is None else cast(bytes, found[0])

    @property
    def lost(self) -> int:
        """Messages from the PLC that were overwritten before they were read, since the object was opened."""
        return 0 if self._to_plc or self._user is None else int(self._user.lost)

    def beat(self) -> None:
        """Send a heartbeat; the background thread does this ten times per second."""
        with self._lock:
            if self._user is not None:
                self._user.beat()

    def close(self) -> None:
        """Close the object, which keeps its last state for the PLC and the next owner; callable twice."""
        with self._lock:
            self.closed = True
            self._leave()

    def __enter__(self) -> Binding:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _open(self) -> None:
        channel: OwnedChannel = self._open_channel()
        self._user = channel.writer(BEAT_MS) if self._to_plc else channel.reader(BEAT_MS)
        self._channel = channel
        self._looked_ns = self._clock.monotonic_ns()

    def _leave(self) -> None:
        channel, self._channel, self._user = self._channel, None, None
        if channel is not None:
            channel.close()

    def _reopen(self) -> None:
        _log.warning("%s: the object was removed or replaced; creating it again", self.topic)
        self._leave()
        self._open()

    def _look_after(self) -> None:
        """Check about once per second that the name still refers to the object."""
        if self.closed:
            raise ValueError(f"the binding of {self.topic} is closed")
        now = self._clock.monotonic_ns()
        if self._channel is not None and now - self._looked_ns < _LOOK_NS:
            return
        if self._channel is None or not self._channel.still_there():
            self._reopen()
        self._looked_ns = now

    def _shown(self, message: Any) -> Any:
        if isinstance(message, (bytes, bytearray, memoryview)):
            return self.layout.to_dict(self._codec.decode(message, truncate=self._truncate))
        return self.layout.to_dict(self.layout.pack(message))


def _limits(limits: Limits | Mapping[str, int] | None) -> Limits:
    if limits is None or isinstance(limits, Limits):
        return limits or Limits()
    fields = dict(limits)
    return Limits(fields.pop("string", 80), fields.pop("sequence", 16), fields)


def _environment_distro() -> str:
    distro = os.environ.get("ROS_DISTRO", "")
    return distro if distro in DISTROS else "jazzy"


def _be_heard() -> None:
    # Without this a node that never set up Python's logging would ask for its messages and see none.
    if not _log.isEnabledFor(logging.INFO):
        _log.setLevel(logging.INFO)
    if not _log.hasHandlers():
        _log.addHandler(logging.StreamHandler())


def definition_of(message_class: type | None) -> str | None:
    """Return the definition that a rospy class contains; None for other classes."""
    text = getattr(message_class, "_full_text", None)
    return text if isinstance(text, str) else None


def type_name_of(message_class: type) -> str:
    """Return the type name of a message class of rospy, rosbags or rclpy; raises TYP001 for other classes."""
    for attribute in ("_type", "__msgtype__"):
        if isinstance(name := getattr(message_class, attribute, None), str):
            return name
    package, *rest = message_class.__module__.split(".")
    if not rest or rest[0] != "msg":
        raise MessageTypeError(
            "TYP001",
            f"{message_class.__name__} is not a message class",
            remedy="Pass an rclpy or rospy message class, or the name of the type.",
        )
    return f"{package}/msg/{message_class.__name__}"


def deserialize(message_class: type, data: bytes) -> Any:
    """Deserialize an object of a rospy or rclpy class."""
    if hasattr(message_class, "deserialize"):  # rospy
        return message_class().deserialize(data)
    return importlib.import_module("rclpy.serialization").deserialize_message(data, message_class)


class Beats:
    """The heartbeat thread and its members; the thread ends when the last member is gone."""

    _all: ClassVar[weakref.WeakSet[Binding]] = weakref.WeakSet()
    _lock = threading.Lock()
    _running = False

    @classmethod
    def add(cls, member: Binding) -> None:
        """Send heartbeats for a member until it is closed or no longer referenced."""
        with cls._lock:
            cls._all.add(member)
            if not cls._running:
                cls._running = True
                threading.Thread(target=cls._run, name="rosplc-beats", daemon=True).start()

    @classmethod
    def _run(cls) -> None:
        while True:
            SYSTEM.sleep(BEAT_MS * 1_000_000)
            with cls._lock:
                members = [member for member in cls._all if not member.closed]
                if not members:
                    cls._running = False
                    return
            for member in members:
                try:
                    member.beat()
                except (ChannelError, ValueError):
                    continue  # write() and read() report it to the caller, who can act
            del members, member  # or this thread would keep alive what nobody else refers to

    @classmethod
    def _forked(cls) -> None:
        # Threads stay with the parent, and so does what it owns (rosplc.shm.owned).
        cls._lock = threading.Lock()
        cls._all = weakref.WeakSet()
        cls._running = False


os.register_at_fork(after_in_child=Beats._forked)
