"""The bridge's side of an object's life cycle: spec/shm-format.md, sections 2 and 8.

Lock the name → remove temporary files → adopt a matching object, or retire it and create a new
one in its place → write or read → leave it for the next bridge, or retire it.
"""

from __future__ import annotations

import contextlib
import os
import re
import secrets
import stat
import struct
import time
import weakref
from collections.abc import Iterable, Sequence
from pathlib import Path

from rosplc._core import Reader, Writer
from rosplc.errors import ChannelError
from rosplc.shm import constants as spec
from rosplc.shm import files
from rosplc.shm.attach import Attached, Mapped, start_of, take_over_line, take_over_writer
from rosplc.shm.constants import Direction
from rosplc.shm.files import USUAL, NameLock, Rights, create_complete, open_plain_file
from rosplc.shm.header import Identity, channel_error
from rosplc.shm.names import Description, Namespace, partnered

_LOOKS = 100


class OwnedChannel(Mapped):
    """An object that this process created or adopted, and whose name it holds; a context manager.

    Use :meth:`open`. In a forked child process, the parent's channels are closed.
    """

    def __init__(self, found: _Found) -> None:
        description = found.description
        super().__init__(found.fd, found.path, description.direction, True, description.part)
        self.description = description
        self.adopted = found.difference is None  # whether an object was found and kept
        self.replaced_reason = found.difference or ""  # why an object found was not kept; else empty
        self.generation = self.identity.generation
        # for how long no process held the name before this one, ns, as far as the lock file tells
        self.unowned_ns = found.lock.unheld_ns
        self._lock = found.lock
        names, lock = (os.fsencode(found.path), os.fsencode(found.lock.path)), os.fstat(found.lock.fd)
        numbers = found.lock.fd, *self._file, lock.st_dev, lock.st_ino
        self._held = *names, *numbers, self._first[: spec.IDENTITY_SIZE]
        _owned.add(self)

    @classmethod
    def open(
        cls,
        namespace: Namespace,
        description: Description,
        *,
        record_size: int,
        slots: int = 4,
        rights: Rights = USUAL,
        bridge_id: bytes | None = None,
    ) -> OwnedChannel:
        """Lock the name, then adopt the object with this name if it matches completely; otherwise replace it.

        ``record_size`` is in bytes; ``slots`` is a power of two, 4 to 65536; up to ``slots - 1`` messages can
        wait. ``bridge_id`` is 16 random bytes drawn when the bridge started; None draws them now.

        Raises ChannelError SHM116 if another bridge holds the name, SHM117 without room, SHM118 if the name
        is not valid, SHM119 for another user's object, SHM121 if it is not a plain file or has hard links,
        SHM104 or SHM103 for a file that no bridge created, SHM123 if the directory cannot be used, SHM102 if
        owner or group cannot be set; ValueError if slots or record_size exceed the format's limits.
        """
        return cls._open(namespace, [(description, record_size)], slots, rights, bridge_id)[0]

    @classmethod
    def take_over(cls, namespace: Namespace, found: Attached) -> OwnedChannel:
        """Open an object that another process created, unchanged. Raises as :meth:`open`."""
        size, slots, rights = found.identity.record_size, found.identity.slot_count, found.path.stat()
        return cls.open(namespace, found.description, record_size=size, slots=slots, rights=Rights.of(rights))

    @classmethod
    def open_together(
        cls,
        namespace: Namespace,
        parts: Sequence[tuple[Description, int]],
        *,
        rights: Rights = USUAL,
        bridge_id: bytes | None = None,
    ) -> tuple[OwnedChannel, ...]:
        """Open all objects of one use of a service or action; adopt all of them or none (section 11.1).

        ``parts`` has the description and record size, in bytes, of each; ``partners`` is filled in here.
        Raises as :meth:`open`; then none is owned. If one is no longer :meth:`still_there`, close or retire
        all, and open them together again.
        """
        complete = zip(partnered([one for one, _ in parts]), (size for _, size in parts), strict=True)
        return cls._open(namespace, complete, spec.MIN_SLOTS, rights, bridge_id)

    @classmethod
    def _open(
        cls,
        namespace: Namespace,
        parts: Iterable[tuple[Description, int]],
        slots: int,
        rights: Rights,
        bridge_id: bytes | None,
    ) -> tuple[OwnedChannel, ...]:
        made_by = {"bridge_id": bridge_id or secrets.token_bytes(16), "creator_pid": os.getpid()}
        plans = []
        for description, size in parts:
            made_by |= {"generation": secrets.randbelow(2**32 - 1) + 1, "created_ns": time.time_ns()}
            plans.append((description, description.plan(size, slots, **made_by)))
        found: list[_Found] = []
        try:
            for description, plan in plans:
                found.append(_Found(namespace, description, plan, rights))
                found[-1].look()
            if any(one.difference is not None for one in found):
                # All retired before the first is made: who dies in between leaves no mixed set behind.
                for one in found:
                    one.retire()
                for one in found:
                    one.make()
            channels = tuple(cls(one) for one in found)
        except BaseException:
            for one in found:
                one.give_up()
            raise
        finally:
            for one in found:
                one.close()
        return channels

    def writer(self, beat_ms: int = 1000) -> Writer:
        """Claim the channel to the PLC; since the lock is held, any other claim is outdated.

        ``beat_ms`` is the longest time between two heartbeats or messages that the writer promises. Raises
        SHM110 if the direction is to ROS.
        """
        if self.identity.direction is not Direction.TO_PLC:
            raise channel_error(110, "only the PLC can write to a to_ros channel", self.path)
        writer = take_over_writer(self.region, beat_ms)
        self._users.append(writer)
        return writer

    def reader(self, beat_ms: int = 1000, *, latched: bool = False) -> Reader:
        """Claim line 0 of a channel to ROS, and continue after the last message taken before (M14).

        ``beat_ms`` is the longest time between two heartbeats or reads that the reader promises. If no
        earlier reader is recorded, ``latched`` starts with the messages in the object. Raises SHM110 if the
        direction is to the PLC.
        """
        if self.identity.direction is not Direction.TO_ROS:
            raise channel_error(110, "the bridge cannot read a to_plc channel, which it writes", self.path)
        reader = Reader(self.region, start_of(self.region, latched=latched, line=0))
        take_over_line(self.region, reader, 0, beat_ms, self.description.bridge)
        self._users.append(reader)
        return reader

    def still_there(self) -> bool:
        """Return whether the names still refer to this object and its lock, and its identity is intact.

        If not, close this object and open the name again. Call this every few seconds: it also notes, for
        the next owner, that the name is held.
        """
        return self._lock.fd >= 0 and self.region.held(*self._held)

    def retire(self) -> None:
        """Mark the object as retired for every process that has mapped it, remove its name, and close it."""
        self.region.store(spec.IDENTITY["state"], spec.STATE_RETIRED)
        if files.same_file(self.path, *self._file):
            self.path.unlink(missing_ok=True)
            self._lock.remember_object(False)
        self.close()

    def close(self) -> None:
        """Release claims and lock; the object keeps its last state. A second call does nothing."""
        for user in self._users:
            user.release()
        self._lock.show()
        self._abandon()

    def _abandon(self) -> None:
        self._users.clear()
        self.process.close()
        self.region.close()
        self._lock.release()


_owned: weakref.WeakSet[OwnedChannel] = weakref.WeakSet()


def _forked() -> None:
    """Close the parent's channels in a child process.

    With the descriptor, the child would inherit the lock: a worker that outlives its killed parent would
    lock out the next bridge, and at its exit it would release the parent's claims.
    """
    for channel in list(_owned):
        channel._abandon()


os.register_at_fork(after_in_child=_forked)


def _image(identity: Identity, text: bytes) -> bytes:
    """Return an object from its first byte to the end of its self-description; the rest is zero."""
    head = bytearray(spec.HEADER_SIZE)
    head[: spec.IDENTITY_SIZE] = identity.build()
    if identity.direction is Direction.TO_ROS:
        # Line 0 stands for "nothing taken" from the start, so that no crash between creation and
        # claim makes the next bridge skip what the PLC has sent meanwhile.
        at = spec.reader_line(0) + spec.READER_LINE["generation"]
        struct.pack_into("<I", head, at, identity.generation)
    return bytes(head) + text


def _sweep(directory: Path, temporary_prefix: str) -> None:
    """Remove temporary files that a killed bridge left; the caller holds the lock."""
    pattern = re.compile(re.escape(temporary_prefix) + "[0-9a-f]{8}")
    for name in os.listdir(directory):  # noqa: PTH208 - once per topic, and each may have thousands of others
        if name.startswith(temporary_prefix) and pattern.fullmatch(name):
            with contextlib.suppress(OSError):  # another user's, or a directory: in nobody's way
                (directory / name).unlink()


class _Found:
    """The object found at a name whose lock this process holds."""

    def __init__(
        self, namespace: Namespace, description: Description, identity: Identity, rights: Rights
    ) -> None:
        name = description.topic, description.part, description.client
        self.path = namespace.path(*name)
        self.description = description
        self.lock = NameLock(namespace.lock_path(*name), rights)
        self.fd = -1  # the object found or made; -1 none
        # why the object found cannot be adopted; empty where there is none, None if it can
        self.difference: str | None = ""
        self._temporary = namespace.temporary_prefix(*name)
        self._identity = identity
        self._rights = rights
        self._ours = self.lock.held_an_object
        self._made = False

    def look(self) -> None:
        """Open and check the object."""
        _sweep(self.path.parent, self._temporary)
        try:
            self.fd = open_plain_file(self.path, os.O_RDWR, denied=119)
        except ChannelError as error:
            if error.code != "SHM101":
                raise
        else:
            # A bridge's object that is damaged beyond recognition may be replaced; everything else that
            # does not look like an object is somebody's file.
            _refuse_foreign(self.fd, self.path, self._rights.uid, self._ours)
            where = str(self.path)
            self.difference = (
                _difference(self.fd, self.description, self._identity, self._rights, where) or None
            )
        self.lock.remember_object(True)

    def retire(self) -> None:
        """Retire an object that is not adopted."""
        if self.fd >= 0:
            retire_file(self.fd)
            self.difference = self.difference or "another object of the same service or action was replaced"
            self.close()

    def make(self) -> None:
        """Create a new object with the name."""
        image = _image(self._identity, self.description.to_json())
        self.fd = create_complete(self.path, self._temporary, image, self._identity.object_size, self._rights)
        self.difference = self.difference or ""
        self._made = True

    def give_up(self) -> None:
        """Release the name, unchanged except for a retired object."""
        with contextlib.suppress(OSError):
            if self._made and self.fd >= 0:
                retire_file(self.fd)
                self.path.unlink()
            self.lock.remember_object(self._ours)
        self.lock.release()

    def close(self) -> None:
        """Close the file; a mapping of the object stays."""
        fd, self.fd = self.fd, -1
        if fd >= 0:
            os.close(fd)


def _refuse_foreign(fd: int, path: Path, uid: int | None, ours: bool) -> None:
    """Raise SHM119, SHM121, SHM103 or SHM104 for a file that no bridge of this user created."""
    status = os.fstat(fd)
    if status.st_uid not in (os.geteuid(), uid):
        raise channel_error(119, f"the object belongs to user {files.user_name(status.st_uid)}", path)
    files.refuse_second_name(fd, path)
    first, size = files.read_header(fd)
    if ours or first[:4] == spec.MAGIC.to_bytes(4, "little"):
        return
    what = f"this name belongs to a file of {size} bytes that no bridge created"
    remedy = "If nothing uses the file, remove it; otherwise choose another prefix."
    code = "SHM103" if size < spec.HEADER_SIZE else "SHM104"
    raise ChannelError(code, what, where=str(path), remedy=remedy)


def _difference(fd: int, description: Description, wanted: Identity, rights: Rights, where: str) -> str:
    """Return why an object cannot be adopted (section 8.3); empty if it can."""
    status = os.fstat(fd)
    uid = os.geteuid() if rights.uid is None else rights.uid
    first, size = files.read_header(fd)
    try:
        found = Identity.parse(first, size, direction=wanted.direction, kind=wanted.kind, where=where)
    except ChannelError as error:
        return f"{error.what} [{error.code}]"
    group = status.st_gid if rights.gid is None else rights.gid
    here = status.st_uid, status.st_gid, stat.S_IMODE(status.st_mode)
    if here != (uid, group, stat.S_IMODE(rights.mode)):
        # Named, as it may have been open to everybody until now.
        return f"its owner, group and mode were {files.describe_status(status)}"
    for name in ("layout_id", "record_size", "slot_count", "slot_stride"):
        if getattr(found, name) != getattr(wanted, name):
            return f"its {name} was {getattr(found, name)} and is now {getattr(wanted, name)}"
    if os.pread(fd, found.description_size, found.description_offset) != description.to_json():
        return "its self-description differs"
    return _head_without_slot(fd, found)


def _head_without_slot(fd: int, found: Identity) -> str:
    """Return a text if head refers to a slot with another message; otherwise empty."""
    head = _word(fd, spec.WRITER_LINE["head"])
    for _ in range(_LOOKS):
        slot = found.slots_offset + head % found.slot_count * found.slot_stride
        if head == 0 or _word(fd, slot + spec.SLOT_HEADER["sequence"]) == head:
            return ""
        # The PLC goes on meanwhile, and may have come round to this slot: only under a head that
        # does not move is the slot's word evidence.
        before, head = head, _word(fd, spec.WRITER_LINE["head"])
        if before == head:
            return f"head is {head}, but its slot contains another message"
    return ""  # it moves faster than we can look: somebody writes


def _word(fd: int, offset: int) -> int:
    return int.from_bytes(os.pread(fd, 4, offset), "little")


def retire_file(fd: int) -> None:
    """Mark an object as RETIRED in place, before another object gets its name (M19)."""
    first, size = files.read_header(fd)
    # Of LIVE and RETIRED only one byte differs, so this is one access whatever the kernel copies with.
    # What is not ours by its magic is left as it is.
    ours = size >= spec.HEADER_SIZE and int.from_bytes(first[:4], "little") == spec.MAGIC
    if ours and first[12:16] != _state(spec.STATE_RETIRED):
        os.pwrite(fd, _state(spec.STATE_RETIRED), spec.IDENTITY["state"])


def _state(value: int) -> bytes:
    return struct.pack("<I", value)


if _state(spec.STATE_LIVE)[1:] != _state(spec.STATE_RETIRED)[1:]:  # pragma: no cover - found at import
    raise AssertionError("LIVE and RETIRED differ in more than one byte")
