"""Tricks in the directory of objects, each tried as its own user's process and, as root, as another user's.

What a directory such as /dev/shm lets everybody do: put links, pipes and files at names that a bridge
will use. Nothing of it may be followed, changed or waited for; it is refused with a name, or replaced.
"""

from __future__ import annotations

import os
import socket
import stat
import sys
import traceback
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from rosplc.errors import ChannelError
from rosplc.shm import Namespace, OwnedChannel, attach
from rosplc.shm.classic import SEMAPHORE_SIZE, ClassicLock, ClassicMemory, ClassicObject
from rosplc.shm.files import NameLock, Rights
from tests.classic_cell import remove, unique_name
from tests.lib.channels import describe, open_channel

pytestmark = pytest.mark.verifies("users", own="processes of other users")

_TOPIC = "/robot1/cmd_vel"
_BRIDGE, _OTHER, _GROUP = 12345, 12346, 54321

as_root = pytest.mark.needs(when=os.geteuid() == 0, why="only root can become two other users")


def run_as(user: int, work: Callable[[], None], group: int = _GROUP) -> None:
    """Do something in a process of another unprivileged user; what it raises fails the test."""
    pid = os.fork()
    if pid == 0:
        status = 1
        try:
            os.setgroups([])
            os.setgid(group)
            os.setuid(user)
            work()
            status = 0
        except BaseException:
            traceback.print_exc(file=sys.stderr)
        finally:
            os._exit(status)
    _, waited = os.waitpid(pid, 0)
    assert os.waitstatus_to_exitcode(waited) == 0, "see the traceback on stderr"


@pytest.fixture
def shared(tmp_path: Path) -> Namespace:
    """Give a directory that everybody may write to, as /dev/shm is."""
    directory = tmp_path / "shm"
    directory.mkdir()
    directory.chmod(0o1777)
    for parent in directory.parents:
        if parent.is_relative_to("/tmp") and parent != Path("/tmp"):
            parent.chmod(0o755)
    return Namespace("rosplc", directory)


@pytest.fixture
def name() -> Iterator[str]:
    """Give a classic name of the test's own."""
    made = unique_name()
    yield made
    remove(made)


def refused(code: str, work: Callable[[], object], words: str | None = None) -> None:
    """Expect one error; for use in a child process too."""
    with pytest.raises(ChannelError, match=words) as caught:
        work()
    assert caught.value.code == code, str(caught.value)


@pytest.mark.parametrize("which", ["path", "lock_path"])
def test_hard_link_to_another_file_is_refused(shared: Namespace, which: str) -> None:
    """A hard link at the name of an object or its lock is refused, and the file behind it is left alone."""
    victim = Path(shared.directory) / "victim"
    victim.write_bytes(b"RPLC" + bytes(508) if which == "path" else b"")
    victim.chmod(0o600)
    before = victim.stat()
    os.link(victim, getattr(shared, which)(_TOPIC))
    refused("SHM121", lambda: open_channel(shared), "2 names")
    after = victim.stat()
    assert (after.st_mode, after.st_gid, after.st_size) == (before.st_mode, before.st_gid, before.st_size)
    assert victim.read_bytes()[4:] == bytes(max(0, before.st_size - 4))


def test_program_writes_through_no_hard_link(shared: Namespace) -> None:
    """A program that attaches to write refuses an object that has a second name."""
    open_channel(shared).close()
    os.link(shared.path(_TOPIC), Path(shared.directory) / "second")
    refused("SHM121", lambda: attach(shared, _TOPIC, write=True))
    attach(shared, _TOPIC).close()


def test_guessed_temporary_is_not_followed(shared: Namespace, monkeypatch: pytest.MonkeyPatch) -> None:
    """A link at the name of the next temporary costs an attempt, and what it leads to is left alone."""
    import secrets

    victim = Path(shared.directory) / "victim"
    victim.write_bytes(b"precious")
    numbers = iter(["00000000", "00000000", "11111111"])
    monkeypatch.setattr(secrets, "token_hex", lambda _=0: next(numbers))
    trap = Path(shared.directory) / (shared.temporary_prefix(_TOPIC) + "00000000")
    real = os.listdir
    monkeypatch.setattr(os, "listdir", lambda _: [])  # it was laid after the sweep
    trap.symlink_to(victim)
    open_channel(shared).close()
    assert victim.read_bytes() == b"precious" and trap.is_symlink()
    monkeypatch.setattr(os, "listdir", real)
    open_channel(shared).close()
    assert not trap.is_symlink(), "a temporary is swept, link or not"
    assert victim.read_bytes() == b"precious"


def test_link_that_replaces_the_object_while_it_is_made(
    shared: Namespace, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A link laid between the look and the rename is replaced, never written through."""
    victim = Path(shared.directory) / "victim"
    victim.write_bytes(b"precious")
    real = Path.rename

    def late(self: Path, target: Path) -> Path:
        Path(target).symlink_to(victim)
        return real(self, target)

    monkeypatch.setattr(Path, "rename", late)
    with open_channel(shared) as channel:
        assert channel.still_there()
    assert stat.S_ISREG(shared.path(_TOPIC).lstat().st_mode)
    assert victim.read_bytes() == b"precious"


def test_umask_matters_nowhere(shared: Namespace, name: str) -> None:
    """Object, lock file, classic memory, semaphore and claim have the configured rights under any umask."""
    seen: dict[int, list[int]] = {}
    for umask in (0o000, 0o022, 0o077):
        before = os.umask(umask)
        try:
            OwnedChannel.open(shared, describe(), record_size=64).close()
            claimed = ClassicObject(name, name, 48, write=True, recover_after_ns=10**9)
            claimed.claim()
            claimed.attach()
            claimed.close()
        finally:
            os.umask(before)
        directory = Path("/dev/shm")
        files = [
            shared.path(_TOPIC),
            shared.lock_path(_TOPIC),
            directory / name,
            directory / f"sem.{name}",
            directory / f"rosplc.classic.{name}",
        ]
        seen[umask] = [stat.S_IMODE(path.stat().st_mode) for path in files]
        for path in files:
            path.unlink()
    assert all(modes == [0o660] * 5 for modes in seen.values()), seen


def test_object_that_was_open_is_closed_and_named(shared: Namespace) -> None:
    """An object of this user's that everybody could write is replaced, and who could is said."""
    open_channel(shared).close()
    shared.path(_TOPIC).chmod(0o666)
    shared.lock_path(_TOPIC).chmod(0o666)
    with open_channel(shared) as channel:
        assert "0666" in channel.replaced_reason
    for path in (shared.path(_TOPIC), shared.lock_path(_TOPIC)):
        assert stat.S_IMODE(path.stat().st_mode) == 0o660


def test_object_that_was_cut_is_no_longer_there(shared: Namespace) -> None:
    """A look at an object that somebody has cut to nothing says so, and is no bus error."""
    with open_channel(shared) as channel:
        os.truncate(channel.path, 0)
        assert not channel.still_there()
        # What stands beyond the end is not touched again; the next bridge replaces it.
        channel._users.clear()
    with open_channel(shared) as channel:
        assert "SHM103" in channel.replaced_reason


def test_classic_hard_link_is_refused(tmp_path: Path) -> None:
    """A hard link at the name of a classic memory is refused; the temporary of a killed bridge is removed."""
    victim = tmp_path / "victim"
    victim.write_bytes(bytes(range(48)))
    os.link(victim, tmp_path / "io")
    refused("SHM121", lambda: ClassicMemory(tmp_path / "io", 48), "2 names")
    assert victim.read_bytes() == bytes(range(48))
    ClassicMemory(tmp_path / "out", 48).close()
    os.link(tmp_path / "out", tmp_path / "rosplc.new.0123456789abcdef")
    ClassicMemory(tmp_path / "out", 48).close()
    assert not (tmp_path / "rosplc.new.0123456789abcdef").exists()


def _pipe(path: Path) -> None:
    os.mkfifo(path)


def _link_to_a_pipe(path: Path) -> None:
    # Of the length of a semaphore's content, which is what a careless look compares.
    target = path.parent / ("p" * (SEMAPHORE_SIZE - len(str(path.parent)) - 1))
    os.mkfifo(target)
    path.symlink_to(target)
    assert path.lstat().st_size == SEMAPHORE_SIZE


def _directory(path: Path) -> None:
    path.mkdir()


def _socket(path: Path) -> None:
    with socket.socket(socket.AF_UNIX) as unix:
        unix.bind(str(path))


@pytest.mark.parametrize("make", [_pipe, _directory, _socket])
def test_classic_memory_is_a_plain_file(tmp_path: Path, make: Callable[[Path], None]) -> None:
    """What is no plain file at the name of a classic memory is refused, and nothing waits for it."""
    make(tmp_path / "io")
    refused("SHM121", lambda: ClassicMemory(tmp_path / "io", 48))


@pytest.mark.parametrize("make", [_pipe, _link_to_a_pipe, _directory, _socket])
def test_semaphore_is_a_plain_file(name: str, make: Callable[[Path], None]) -> None:
    """What is no plain file at the name of a semaphore is refused, and nothing waits for it."""
    path = Path("/dev/shm") / f"sem.{name}"
    try:
        make(path)
        refused("SHM121", lambda: ClassicLock(name, 10**9))
    finally:
        if path.is_symlink():
            Path(os.readlink(path)).unlink()
        if path.is_dir():
            path.rmdir()


@as_root
def test_lock_file_of_another_user_is_refused(shared: Namespace) -> None:
    """A lock file that another user has laid is refused and named, though everybody may open it."""

    def lay() -> None:
        path = shared.lock_path(_TOPIC)
        path.touch()
        path.chmod(0o666)

    run_as(_OTHER, lay)
    run_as(_BRIDGE, lambda: refused("SHM119", lambda: open_channel(shared), "12346"))
    refused("SHM119", lambda: open_channel(shared), "12346")
    assert stat.S_IMODE(shared.lock_path(_TOPIC).stat().st_mode) == 0o666


@as_root
def test_object_that_another_user_has_laid_is_refused(shared: Namespace) -> None:
    """An object that another user has laid before the bridge came is neither adopted nor changed."""

    def lay() -> None:
        with OwnedChannel.open(shared, describe(), record_size=64, rights=Rights(0o666)):
            pass
        shared.lock_path(_TOPIC).unlink()

    run_as(_OTHER, lay)
    before = shared.path(_TOPIC).read_bytes()
    run_as(_BRIDGE, lambda: refused("SHM119", lambda: open_channel(shared), "12346"))
    shared.lock_path(_TOPIC).unlink()
    refused("SHM119", lambda: open_channel(shared), "12346")
    assert shared.path(_TOPIC).read_bytes() == before


@as_root
def test_stranger_reads_and_writes_nothing(shared: Namespace, name: str) -> None:
    """With the default rights a user outside the group can neither read nor write what a bridge makes."""

    def make() -> None:
        open_channel(shared).close()
        ClassicObject(name, name, 48, write=True, recover_after_ns=10**9, directory="/dev/shm").attach()

    run_as(_BRIDGE, make)
    paths = [
        shared.path(_TOPIC),
        shared.lock_path(_TOPIC),
        Path("/dev/shm", name),
        Path(f"/dev/shm/sem.{name}"),
    ]

    def pry() -> None:
        for path in paths:
            for flags in (os.O_RDONLY, os.O_RDWR):
                with pytest.raises(PermissionError):
                    os.open(path, flags)
            with pytest.raises(PermissionError):
                path.unlink()

    run_as(_OTHER, pry, group=_GROUP + 1)
    run_as(_OTHER, lambda: attach(shared, _TOPIC, write=True).close())  # of the group: that is what it is for


@as_root
def test_bridge_of_a_plain_user_works_with_its_group(shared: Namespace) -> None:
    """An unprivileged bridge creates, adopts and retires its objects; nothing of it needs root."""

    def live() -> None:
        open_channel(shared).close()
        with open_channel(shared) as channel:
            assert channel.adopted
            channel.retire()
        NameLock(shared.lock_path(_TOPIC), Rights()).release()

    run_as(_BRIDGE, live)
    found = shared.lock_path(_TOPIC).stat()
    assert (found.st_uid, found.st_gid) == (_BRIDGE, _GROUP)


@as_root
def test_root_gives_no_lock_away_that_it_did_not_make(shared: Namespace) -> None:
    """A bridge of root accepts the lock file of the objects' configured owner, and changes nothing of it."""

    def lay() -> None:
        shared.lock_path(_TOPIC).touch(mode=0o600)

    run_as(_BRIDGE, lay)
    before = shared.lock_path(_TOPIC).stat()
    with OwnedChannel.open(shared, describe(), record_size=64, rights=Rights(uid=_BRIDGE, gid=_GROUP)):
        after = shared.lock_path(_TOPIC).stat()
    assert (before.st_uid, before.st_gid, before.st_mode) == (after.st_uid, after.st_gid, after.st_mode)
