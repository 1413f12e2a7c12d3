"""The life of an object: spec/shm-format.md, section 8."""

from __future__ import annotations

import os
import socket
import struct
from pathlib import Path

import pytest

from rosplc.errors import ChannelError
from rosplc.shm import Direction, Identity, Namespace, OwnedChannel, attach
from rosplc.shm.constants import HEADER_SIZE, IDENTITY, STATE_RETIRED, WRITER_LINE
from rosplc.shm.files import Rights
from tests.lib.channels import describe, open_channel, pattern

pytestmark = pytest.mark.verifies("users", own="processes of other users")

_TOPIC = "/robot1/cmd_vel"


def _code(caught: pytest.ExceptionInfo[ChannelError]) -> str:
    return caught.value.code


def _state(fd: int) -> int:
    return int(struct.unpack("<I", os.pread(fd, 4, IDENTITY["state"]))[0])


def test_new_object(shm_namespace: Namespace) -> None:
    """A new object is complete, has its mode, and tells what it carries."""
    with open_channel(shm_namespace) as channel:
        status = shm_namespace.path(_TOPIC).stat()
        assert not channel.adopted
        assert channel.replaced_reason == ""
        assert status.st_mode & 0o7777 == 0o660
        assert status.st_size == channel.identity.object_size
        assert status.st_blocks * 512 >= status.st_size, "not allocated: a full directory would be SIGBUS"
        assert shm_namespace.topics() == [shm_namespace.object_name(_TOPIC)]
        with attach(shm_namespace, _TOPIC) as attached:
            assert attached.description == describe()
            assert attached.identity == channel.identity


@pytest.mark.parametrize("mode", [0o600, 0o644, 0o666])
def test_mode_ignores_the_umask(shm_namespace: Namespace, mode: int) -> None:
    """The object has the mode that was asked for, whatever the process's umask."""
    before = os.umask(0o077)
    try:
        with OwnedChannel.open(shm_namespace, describe(), record_size=8, rights=Rights(mode)):
            assert shm_namespace.path(_TOPIC).stat().st_mode & 0o7777 == mode
    finally:
        os.umask(before)


def test_same_object_is_adopted_with_its_messages(shm_namespace: Namespace) -> None:
    """A bridge that starts again finds head where it was, and a PLC stays attached (M7)."""
    with open_channel(shm_namespace) as first:
        writer = first.writer()
        for number in range(1, 6):
            writer.publish(pattern(number, 64))
        attached = attach(shm_namespace, _TOPIC)
        reader = attached.reader()
    out = bytearray(64)
    with open_channel(shm_namespace) as second:
        assert second.adopted
        assert second.generation == first.generation
        assert second.writer().publish(pattern(6, 64)) == 6
        info = reader.next(out)
        assert info is not None
        assert (info.sequence, info.flags, info.lost) == (6, 1, 0)
        assert out == pattern(6, 64)
    attached.close()


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"layout_id": "fedcba9876543210"}, "layout_id"),
        ({"record_size": 72}, "record_size"),
        ({"slots": 8}, "slot_count"),
        ({"direction": Direction.TO_ROS}, "SHM110"),
    ],
)
def test_other_object_is_replaced_and_retired(
    shm_namespace: Namespace, changes: dict[str, object], reason: str
) -> None:
    """What differs is replaced, and a program that has the old one mapped notices at the next call (M19)."""
    with open_channel(shm_namespace):
        attached = attach(shm_namespace, _TOPIC)
        reader = attached.reader()
    with open_channel(shm_namespace, **changes) as second:  # type: ignore[arg-type]
        assert not second.adopted
        assert reason in second.replaced_reason
        for call in (attached.valid, lambda: reader.latest(bytearray(64))):
            with pytest.raises(ChannelError) as caught:
                call()
            assert _code(caught) == "SHM111"
        assert not attached.still_there()
        attached.close()
        with attach(shm_namespace, _TOPIC) as again:
            assert again.identity.generation == second.generation


def test_definition_and_mode_are_part_of_the_identity(shm_namespace: Namespace) -> None:
    """A changed definition or mode replaces the object, or its description would be wrong."""
    open_channel(shm_namespace).close()
    changed = describe()
    object.__setattr__(changed, "definition", "uint64[] data\nuint8 LIMIT=7\n")
    with OwnedChannel.open(shm_namespace, changed, record_size=64) as channel:
        assert "self-description" in channel.replaced_reason
    with OwnedChannel.open(shm_namespace, changed, record_size=64, rights=Rights(0o600)) as channel:
        assert "mode" in channel.replaced_reason


def test_head_without_its_slot_is_not_adopted(shm_namespace: Namespace) -> None:
    """An object whose head was scribbled over is replaced: its stream cannot be continued."""
    with open_channel(shm_namespace) as channel:
        channel.writer().publish(pattern(1, 64))
        channel.region.store(WRITER_LINE["head"], 77)
    with open_channel(shm_namespace) as channel:
        assert "head is 77" in channel.replaced_reason


@pytest.mark.parametrize(
    ("content", "code"),
    [(b"", "SHM103"), (b"x", "SHM103"), (bytes(4096), "SHM104"), (b"\xff" * 100_000, "SHM104")],
)
def test_foreign_file_is_refused(shm_namespace: Namespace, content: bytes, code: str) -> None:
    """A file of this user's that no bridge has made is refused, at each attempt, and left alone."""
    path = shm_namespace.path(_TOPIC)
    path.write_bytes(content)
    for _ in range(2):
        with pytest.raises(ChannelError) as caught:
            open_channel(shm_namespace)
        assert _code(caught) == code
        assert path.read_bytes() == content
    path.unlink()
    open_channel(shm_namespace).close()


@pytest.mark.parametrize(
    "content", [b"", b"x", b"RPLC", bytes(4096), b"RPLC" + bytes(508), b"\xff" * 100_000]
)
def test_damaged_object_is_replaced(shm_namespace: Namespace, content: bytes) -> None:
    """An object of a bridge that is damaged beyond recognition makes way for a new one."""
    open_channel(shm_namespace).close()
    shm_namespace.path(_TOPIC).write_bytes(content)
    with open_channel(shm_namespace) as channel:
        assert not channel.adopted
        assert "SHM10" in channel.replaced_reason
        attach(shm_namespace, _TOPIC).close()


@pytest.mark.parametrize("content", [b"RPLC", b"RPLC" + bytes(508)])
def test_what_carries_the_magic_is_replaced(shm_namespace: Namespace, content: bytes) -> None:
    """A damaged object whose lock file was removed is known by its magic."""
    shm_namespace.path(_TOPIC).write_bytes(content)
    with open_channel(shm_namespace) as channel:
        assert "SHM10" in channel.replaced_reason


def test_retired_name_is_nobodys(shm_namespace: Namespace) -> None:
    """After an object was retired, a file at its name is somebody's again."""
    open_channel(shm_namespace).retire()
    shm_namespace.path(_TOPIC).write_bytes(b"mine")
    with pytest.raises(ChannelError) as caught:
        open_channel(shm_namespace)
    assert _code(caught) == "SHM103"


def test_failed_creation_claims_no_file(shm_namespace: Namespace, monkeypatch: pytest.MonkeyPatch) -> None:
    """A name at which no object could be made is not taken for a bridge's."""

    def full(*_: int) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(os, "posix_fallocate", full)
        with pytest.raises(ChannelError) as caught:
            open_channel(shm_namespace)
    assert _code(caught) == "SHM117"
    shm_namespace.path(_TOPIC).write_bytes(b"mine")
    with pytest.raises(ChannelError) as caught:
        open_channel(shm_namespace)
    assert _code(caught) == "SHM103"


@pytest.mark.parametrize("busy", [3, 10_000])
def test_object_is_adopted_under_a_running_writer(
    shm_namespace: Namespace, monkeypatch: pytest.MonkeyPatch, busy: int
) -> None:
    """A PLC that laps a bridge's look at head and its slot, once or for ever, keeps its object."""
    open_channel(shm_namespace, Direction.TO_ROS).close()
    with attach(shm_namespace, _TOPIC, write=True) as plc:
        writer = plc.writer()
        writer.publish(bytes(64))
        looks = 0

        def pread(fd: int, size: int, offset: int) -> bytes:
            nonlocal looks
            data = read(fd, size, offset)
            if size == 4 and looks < busy:
                looks += 1
                for _ in range(4):
                    writer.publish(bytes(64))
            return data

        with monkeypatch.context() as patch:
            read = os.pread
            patch.setattr(os, "pread", pread)
            with open_channel(shm_namespace, Direction.TO_ROS) as channel:
                assert channel.adopted, channel.replaced_reason
        assert looks >= 3
        writer.publish(bytes(64))


def test_second_bridge_is_refused(shm_namespace: Namespace) -> None:
    """Two bridges on one name are refused, and the first does not notice (section 8.2)."""
    with open_channel(shm_namespace) as first:
        with pytest.raises(ChannelError) as caught:
            open_channel(shm_namespace, record_size=128)
        assert _code(caught) == "SHM116"
        assert first.still_there()
        first.region.check()


def test_temporaries_are_swept(shm_namespace: Namespace) -> None:
    """What a bridge killed in the middle of a creation has left is removed, and nothing else."""
    directory = Path(shm_namespace.directory)
    mine = directory / (shm_namespace.temporary_prefix(_TOPIC) + "0123abcd")
    others = directory / (shm_namespace.temporary_prefix(_TOPIC + "/sub") + "0123abcd")
    odd = directory / (shm_namespace.temporary_prefix(_TOPIC) + "0123abcde")
    for path in (mine, others, odd):
        path.write_bytes(b"x")
    with open_channel(shm_namespace):
        assert [path.exists() for path in (mine, others, odd)] == [False, True, True]


def test_removed_object_is_noticed_and_created_again(shm_namespace: Namespace) -> None:
    """A bridge whose file was removed, by a session's clean-up, sees it and makes another."""
    channel = open_channel(shm_namespace)
    assert channel.still_there()
    shm_namespace.path(_TOPIC).unlink()
    assert not channel.still_there()
    channel.close()
    with open_channel(shm_namespace) as again:
        assert again.still_there()


def test_removed_lock_is_noticed(shm_namespace: Namespace) -> None:
    """A bridge whose lock file was removed no longer counts as the owner."""
    with open_channel(shm_namespace) as channel:
        shm_namespace.lock_path(_TOPIC).unlink()
        assert not channel.still_there()


@pytest.mark.parametrize("kept", [0, 511, 4096])
def test_object_cut_short_is_noticed(shm_namespace: Namespace, kept: int) -> None:
    """A bridge does not look into an object that somebody has made shorter than it is mapped."""
    with open_channel(shm_namespace, record_size=8192) as channel:
        os.truncate(shm_namespace.path(_TOPIC), kept)
        assert not channel.still_there()
        os.truncate(shm_namespace.path(_TOPIC), channel.identity.object_size)  # closing touches its lines


def test_other_files_at_the_names_are_noticed(shm_namespace: Namespace) -> None:
    """A copy of object or lock file at the name, or a link to it, is another file."""
    for path in (shm_namespace.path(_TOPIC), shm_namespace.lock_path(_TOPIC)):
        with open_channel(shm_namespace) as channel:
            content, aside = path.read_bytes(), path.with_name("aside")
            path.rename(aside)
            path.write_bytes(content)
            assert not channel.still_there()
            path.unlink()
            path.symlink_to(aside)
            assert not channel.still_there()
            aside.rename(path)
            assert channel.still_there()


def test_a_look_shows_that_the_name_is_held(shm_namespace: Namespace) -> None:
    """Each look is noted in the lock file's time, for the next owner; after the end none is."""
    lock = shm_namespace.lock_path(_TOPIC)
    channel = open_channel(shm_namespace)
    os.utime(lock, ns=(0, 0))
    assert channel.still_there()
    assert lock.stat().st_mtime_ns > 0
    channel.close()
    os.utime(lock, ns=(0, 0))
    assert not channel.still_there()
    assert lock.stat().st_mtime_ns == 0


def test_damaged_identity_is_noticed(shm_namespace: Namespace) -> None:
    """A bridge sees that somebody has written over its object's identity."""
    with open_channel(shm_namespace) as channel:
        channel.region.store(IDENTITY["generation"], 5)
        assert not channel.still_there()


def test_retire(shm_namespace: Namespace) -> None:
    """Retiring tells attached programs, removes the name and frees it for the next."""
    channel = open_channel(shm_namespace)
    fd = os.open(shm_namespace.path(_TOPIC), os.O_RDONLY)
    channel.retire()
    assert _state(fd) == STATE_RETIRED
    os.close(fd)
    assert shm_namespace.topics() == []
    with pytest.raises(ChannelError) as caught:
        attach(shm_namespace, _TOPIC)
    assert _code(caught) == "SHM101"


def test_retire_spares_another_object(shm_namespace: Namespace) -> None:
    """A bridge that has lost its name does not remove what is there now."""
    channel = open_channel(shm_namespace)
    path = shm_namespace.path(_TOPIC)
    path.unlink()
    path.write_bytes(b"mine")
    channel.retire()
    assert path.read_bytes() == b"mine"


def test_retired_object_is_replaced(shm_namespace: Namespace) -> None:
    """A bridge killed between retiring and renaming leaves nothing that the next would adopt."""
    with open_channel(shm_namespace) as channel:
        channel.region.store(IDENTITY["state"], STATE_RETIRED)
    with open_channel(shm_namespace) as channel:
        assert "SHM111" in channel.replaced_reason


def _link(path: Path, target: Path) -> None:
    path.symlink_to(target)


def _dangling(path: Path, target: Path) -> None:
    path.symlink_to(target / "none")


def _pipe(path: Path, target: Path) -> None:
    os.mkfifo(path)


def _directory(path: Path, target: Path) -> None:
    path.mkdir()


def _socket(path: Path, target: Path) -> None:
    with socket.socket(socket.AF_UNIX) as unix:
        unix.bind(str(path))


@pytest.mark.parametrize("make", [_link, _dangling, _pipe, _directory, _socket])
@pytest.mark.parametrize("which", ["path", "lock_path"])
def test_what_is_no_plain_file(shm_namespace: Namespace, tmp_path: Path, make: object, which: str) -> None:
    """Links, pipes, sockets and directories at a name are refused and left alone."""
    target = tmp_path / "precious"
    target.write_bytes(b"precious")
    make(getattr(shm_namespace, which)(_TOPIC), target)  # type: ignore[operator]
    with pytest.raises(ChannelError) as caught:
        open_channel(shm_namespace)
    assert _code(caught) == "SHM121"
    if which == "path":
        with pytest.raises(ChannelError) as caught:
            attach(shm_namespace, _TOPIC, write=True)
        assert _code(caught) == "SHM121"
    assert target.read_bytes() == b"precious"


@pytest.mark.needs(when=os.geteuid() == 0, why="only root can give files away")
def test_object_of_another_user(shm_namespace: Namespace) -> None:
    """A bridge takes over nothing that another user made, even where it could."""
    open_channel(shm_namespace).close()
    path = shm_namespace.path(_TOPIC)
    os.chown(path, 12345, 12345)
    with pytest.raises(ChannelError) as caught:
        open_channel(shm_namespace)
    assert _code(caught) == "SHM119"
    assert path.stat().st_uid == 12345


@pytest.mark.needs(when=os.geteuid() == 0, why="only root can give files away")
def test_object_for_another_user(shm_namespace: Namespace) -> None:
    """An object made for the PLC's user is that user's, and is adopted again."""
    for adopted in (False, True):
        with OwnedChannel.open(
            shm_namespace, describe(), record_size=8, rights=Rights(uid=12345, gid=54321)
        ) as channel:
            status = shm_namespace.path(_TOPIC).stat()
            assert (status.st_uid, status.st_gid) == (12345, 54321)
            assert channel.adopted is adopted


def test_group_that_is_not_ours(shm_namespace: Namespace, monkeypatch: pytest.MonkeyPatch) -> None:
    """A group that the object cannot be given to is refused with its number, and the name stays free."""

    def refuse(*_: int) -> None:
        raise PermissionError(1, "Operation not permitted")

    with monkeypatch.context() as patch:
        patch.setattr(os, "fchown", refuse)
        with pytest.raises(ChannelError) as caught:
            OwnedChannel.open(shm_namespace, describe(), record_size=8, rights=Rights(gid=54321))
        assert _code(caught) == "SHM102"
    open_channel(shm_namespace).close()


def test_missing_directory(tmp_path: Path) -> None:
    """A directory that is not there is named with a number of its own."""
    namespace = Namespace("rosplc", tmp_path / "none")
    for call in (lambda: open_channel(namespace), lambda: attach(namespace, _TOPIC)):
        with pytest.raises(ChannelError) as caught:
            call()
        assert _code(caught) == "SHM123"


def test_writing_and_reading_belong_to_one_side(shm_namespace: Namespace) -> None:
    """The bridge writes towards the PLC and reads towards ROS; neither side does the other's part."""
    with open_channel(shm_namespace) as to_plc, attach(shm_namespace, _TOPIC, write=True) as attached:
        for call in (to_plc.reader, attached.writer):
            with pytest.raises(ChannelError) as caught:
                call()
            assert _code(caught) == "SHM110"
    with (
        open_channel(shm_namespace, Direction.TO_ROS, topic="/out") as to_ros,
        pytest.raises(ChannelError) as caught,
    ):
        to_ros.writer()
    assert _code(caught) == "SHM110"


def test_image_is_what_the_format_says(shm_namespace: Namespace) -> None:
    """A new object is zero but for identity, description and, towards ROS, line 0's generation."""
    with open_channel(shm_namespace, Direction.TO_ROS) as channel:
        image = shm_namespace.path(_TOPIC).read_bytes()
        identity = Identity.parse(image[:HEADER_SIZE], len(image))
        assert image[128:192] == bytes(64)
        assert struct.unpack("<16I", image[192:256])[8] == channel.generation
        assert image[256:512] == bytes(256)
        assert (
            image[identity.description_offset :][: identity.description_size] == channel.description.to_json()
        )
        assert not any(image[identity.slots_offset :])


@pytest.mark.parametrize(
    ("rights", "words"),
    [
        (Rights(0o660, gid=995), "cannot set group 995, mode 0660"),
        (Rights(0o600, 1000, 995), "cannot set owner 1000, group 995, mode 0600"),
    ],
)
def test_rights_that_cannot_be_given_are_named(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, rights: Rights, words: str
) -> None:
    """Owner and group are named where they were to be set, and the mode."""

    def refuse(*_: int) -> None:
        raise PermissionError

    monkeypatch.setattr("os.fchown", refuse)
    with (tmp_path / "object").open("wb") as file, pytest.raises(ChannelError, match=words) as caught:
        rights.give(file.fileno(), tmp_path / "object")
    assert caught.value.code == "SHM102"
