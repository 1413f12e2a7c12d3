"""Memory and lock of a classic topic, without a bridge."""

from __future__ import annotations

import os
import struct
from collections.abc import Iterator
from pathlib import Path

import posix_ipc
import pytest

from rosplc.errors import ChannelError
from rosplc.shm.classic import SEMAPHORE_SIZE, ClassicLock, ClassicMemory, ClassicObject, Entry
from rosplc.shm.files import Rights
from tests.classic_cell import remove, unique_name

SECOND = 10**9
MILLI = 10**6


@pytest.fixture
def name() -> Iterator[str]:
    """Give a name of the test's own, and remove what stands under it."""
    made = unique_name()
    yield made
    remove(made)


def code_of(error: pytest.ExceptionInfo[ChannelError]) -> str:
    return error.value.code


def held(name: str) -> posix_ipc.Semaphore:
    """Return a semaphore that somebody has taken."""
    return posix_ipc.Semaphore(f"/{name}", posix_ipc.O_CREX, initial_value=0)


def watch(lock: ClassicLock, start_ns: int, end_ns: int, step_ns: int = 5 * MILLI) -> list[Entry]:
    """Look at a lock for a time; return all that was not BUSY."""
    looks = [lock.look(now) for now in range(start_ns, end_ns, step_ns)]
    return [entry for entry in looks if entry is not Entry.BUSY]


def test_a_missing_memory_is_made_zeroed_and_whole(tmp_path: Path) -> None:
    """What is made has the record's size, zeros and the mode that was asked for, and no leftovers."""
    with ClassicMemory(tmp_path / "io", 48, rights=Rights(0o640)) as memory:
        assert memory.created and memory.size == 48 and memory.read() == bytes(48)
        assert (tmp_path / "io").stat().st_mode & 0o777 == 0o640
    assert [path.name for path in tmp_path.iterdir()] == ["io"]
    with ClassicMemory(tmp_path / "io", 48) as again:
        assert not again.created


def test_a_larger_memory_is_as_good(tmp_path: Path) -> None:
    """Sizes are compared with >=; rounding to pages is ordinary, and anything else is odd."""
    for size, odd in ((48, False), (4096, False), (8192, False), (56, True)):
        (tmp_path / "io").write_bytes(bytes(size))
        with ClassicMemory(tmp_path / "io", 48) as memory:
            assert (memory.odd_size, len(memory.read())) == (odd, 48)


@pytest.mark.parametrize(("size", "words"), [(8, "but the record needs 48"), (0, "the memory is empty")])
def test_a_smaller_memory_is_refused_with_both_sizes(tmp_path: Path, size: int, words: str) -> None:
    """A record is never read or written beyond the end."""
    (tmp_path / "io").write_bytes(bytes(size))
    with pytest.raises(ChannelError, match=words) as error:
        ClassicMemory(tmp_path / "io", 48)
    assert code_of(error) == "SHM129"
    assert (tmp_path / "io").stat().st_size == size


def test_a_memory_that_shrinks_is_an_error_and_no_signal(tmp_path: Path) -> None:
    """A peer's ftruncate under a running bridge gives an error with both sizes, on both ways."""
    with ClassicMemory(tmp_path / "io", 8192) as memory:
        os.truncate(tmp_path / "io", 100)
        for use in (memory.read, lambda: memory.write(bytes(8192))):
            with pytest.raises(ChannelError, match="100 bytes, but the record needs 8192"):
                use()
        assert (tmp_path / "io").stat().st_size == 100


def test_a_replaced_memory_is_noticed(tmp_path: Path) -> None:
    """The name is compared with what is held, by device and inode."""
    with ClassicMemory(tmp_path / "io", 48) as memory:
        assert memory.in_place()
        (tmp_path / "io").unlink()
        assert not memory.in_place()
        (tmp_path / "io").write_bytes(bytes(48))
        assert not memory.in_place()


@pytest.mark.needs(when=os.geteuid() == 0, why="only root can be another user")
def test_rights_that_are_missing_are_named(tmp_path: Path, name: str) -> None:
    """Who owns what is closed to this process is in the error, with what helps."""
    for part in (tmp_path, *tmp_path.parents[:-1]):
        part.chmod(part.stat().st_mode | 0o011)
    (tmp_path / "io").write_bytes(bytes(48))
    (tmp_path / "io").chmod(0o750)
    posix_ipc.Semaphore(f"/{name}", posix_ipc.O_CREX, mode=0o700, initial_value=1).close()
    reader, writer = os.pipe()
    child = os.fork()
    if child == 0:  # pragma: no cover - another process
        os.setegid(65534)
        os.seteuid(65534)
        said = []
        for attempt in (lambda: ClassicMemory(tmp_path / "io", 48), lambda: ClassicLock(name, SECOND)):
            try:
                attempt()
            except ChannelError as error:
                said.append(str(error))
        os.write(writer, "\n".join(said).encode())
        os._exit(0)
    os.waitpid(child, 0)
    os.close(writer)
    said = os.read(reader, 10_000).decode().splitlines()
    os.close(reader)
    assert "the memory (root:root 0750) is not accessible to user 65534 [SHM102]" in said[0]
    assert "run the bridge as the runtime's user" in said[0]
    assert "the semaphore (root:root 0700)" in said[1] and "[SHM128]" in said[1]


def test_a_lock_is_made_free_with_the_mode_asked_for(name: str) -> None:
    """A new semaphore lets in one, and its group may use it."""
    lock = ClassicLock(name, SECOND, rights=Rights(0o660))
    assert lock.created and lock.value == 1
    assert lock.path.stat().st_mode & 0o777 == 0o660
    assert lock.enter(0) is Entry.ENTERED and lock.enter(0) is Entry.BUSY
    lock.leave()
    assert lock.value == 1
    lock.close()
    lock.close()


def test_a_lock_created_locked_is_freed_once(name: str) -> None:
    """Nobody inside and value 0 from birth: after recover_after the lock works, and stays as it is."""
    held(name).close()
    lock = ClassicLock(name, SECOND)
    assert watch(lock, 0, SECOND - MILLI) == []
    assert watch(lock, SECOND - MILLI, SECOND + 20 * MILLI)[0] is Entry.RECOVERED
    assert (lock.value, lock.recovered, lock.mended) == (1, 1, 0)
    assert set(watch(lock, SECOND + 20 * MILLI, 5 * SECOND)) == {Entry.ENTERED}
    assert lock.recovered == 1


def test_a_sign_of_life_keeps_the_lock(name: str) -> None:
    """A holder that is slow but seen to work is never called dead."""
    held(name).close()
    lock = ClassicLock(name, SECOND)
    for now in range(0, 10 * SECOND, 100 * MILLI):
        assert lock.enter(now, alive=True) is Entry.BUSY
    assert lock.recovered == 0


def test_looks_that_are_far_apart_prove_nothing(name: str) -> None:
    """A bridge that was stopped itself begins to count again."""
    held(name).close()
    lock = ClassicLock(name, SECOND)
    for now in range(0, 60 * SECOND, SECOND // 2):
        assert lock.look(now) is Entry.BUSY
    assert lock.recovered == 0


def test_a_lock_that_was_free_in_between_is_in_use(name: str) -> None:
    """Each time it is seen free the count begins again."""
    other = posix_ipc.Semaphore(f"/{name}", posix_ipc.O_CREX, initial_value=1)
    lock = ClassicLock(name, SECOND)
    for start in range(0, 5 * SECOND, SECOND):
        other.acquire()
        assert watch(lock, start, start + SECOND - 50 * MILLI) == []
        other.release()
        assert lock.look(start + SECOND - 10 * MILLI) is Entry.ENTERED
    assert lock.recovered == 0


@pytest.mark.parametrize("value", [2, 3, 50])
def test_a_semaphore_that_lets_in_more_than_one_is_mended(name: str, value: int) -> None:
    """It lets in one afterwards, and the attempt that found it did not count as having the lock."""
    posix_ipc.Semaphore(f"/{name}", posix_ipc.O_CREX, initial_value=value).close()
    lock = ClassicLock(name, SECOND)
    assert lock.enter(0) is Entry.BUSY
    assert (lock.value, lock.mended, lock.doubtful) == (1, 1, True)
    assert lock.enter(1) is Entry.ENTERED
    lock.leave()


def test_two_that_free_a_lock_at_once_are_mended(name: str) -> None:
    """If two post for one dead holder, the next look makes one of the two."""
    semaphore = held(name)
    lock = ClassicLock(name, SECOND)
    watch(lock, 0, SECOND + 20 * MILLI)
    semaphore.release()  # what another recoverer would do at the same moment
    assert lock.value == 2
    lock.look(2 * SECOND)
    assert (lock.value, lock.mended) == (1, 1)


def test_a_replaced_semaphore_is_noticed(name: str) -> None:
    """sem_unlink and sem_open by the other side lead to another file."""
    lock = ClassicLock(name, SECOND)
    assert lock.in_place()
    posix_ipc.unlink_semaphore(f"/{name}")
    assert not lock.in_place()
    posix_ipc.Semaphore(f"/{name}", posix_ipc.O_CREX, initial_value=1).close()
    assert not lock.in_place()


def test_a_semaphore_of_the_other_word_size_is_named(name: str) -> None:
    """sem_t has 16 bytes for 32-bit programs and 32 for 64-bit ones; they cannot share one."""
    other = 48 - SEMAPHORE_SIZE
    Path(f"/dev/shm/sem.{name}").write_bytes(struct.pack("<I", 1) + bytes(other - 4))
    with pytest.raises(ChannelError, match=f"a {2 * other}-bit program created the semaphore") as error:
        ClassicLock(name, SECOND)
    assert code_of(error) == "SHM133"


@pytest.mark.parametrize("content", [b"", b"\1" * 7, b"\1" * 4096])
def test_what_is_no_semaphore_is_refused(name: str, content: bytes) -> None:
    """A file of another size is not mapped."""
    Path(f"/dev/shm/sem.{name}").write_bytes(content)
    with pytest.raises(ChannelError) as error:
        ClassicLock(name, SECOND)
    assert code_of(error) == "SHM128"


@pytest.mark.parametrize("byte", [b"\0", b"\1", b"\x80", b"\xff"])
def test_a_scribbled_semaphore_is_refused(name: str, byte: bytes) -> None:
    """The C library would end the process over a semaphore full of nonsense, so it never gets one."""
    Path(f"/dev/shm/sem.{name}").write_bytes(byte * SEMAPHORE_SIZE)
    with pytest.raises(ChannelError, match="not a semaphore") as error:
        ClassicLock(name, SECOND)
    assert code_of(error) == "SHM128"


def test_an_object_is_claimed_by_one_bridge(name: str) -> None:
    """A second bridge on the same memory is refused, whatever its prefix."""
    first, second = (ClassicObject(name, name, 48, write=True, recover_after_ns=SECOND) for _ in range(2))
    first.claim()
    with pytest.raises(ChannelError) as error:
        second.claim()
    assert code_of(error) == "SHM116"
    first.close()
    second.claim()
    second.close()


def test_an_object_without_a_semaphore_has_none(name: str) -> None:
    """CODESYS' own sample guards nothing: no semaphore is made, and every read is made twice."""
    made = ClassicObject(name, "", 8, write=True, recover_after_ns=SECOND)
    made.attach()
    assert made.enter(0) is Entry.ENTERED and made.doubtful
    made.write(b"12345678")
    assert made.read() == made.peek() == b"12345678"
    made.leave()
    assert not Path(f"/dev/shm/sem.{name}").exists()
    made.close()


def test_counts_outlive_an_attachment(name: str) -> None:
    """What was freed and mended is counted over all semaphores of the name."""
    made = ClassicObject(name, name, 8, write=True, recover_after_ns=SECOND)
    made.attach()
    assert made.lock is not None and made.in_place()
    made.lock.recovered = 2
    posix_ipc.unlink_semaphore(f"/{name}")
    assert not made.in_place()
    made.attach()
    assert made.in_place() and (made.recovered, made.attachments) == (2, 2)
    made.close()
