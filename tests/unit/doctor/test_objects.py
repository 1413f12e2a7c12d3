"""Looking at objects: who holds them and who beats, without touching them."""

from __future__ import annotations

import os
import sys
from dataclasses import replace
from pathlib import Path

from rosplc.config.plans import ClassicPlan
from rosplc.doctor import Level
from rosplc.doctor.leftovers import locks, soundness
from rosplc.doctor.objects import Objects, look_at_objects
from rosplc.errors import ChannelError
from rosplc.proc import held_files
from rosplc.shm import Direction, Namespace, attach
from rosplc.shm.classic import Semaphore
from tests.lib.channels import open_channel, start_child, until
from tests.unit.doctor.stage import problems

TOPIC = "/robot1/cmd_vel"

_OWNER = """
import sys, time
from rosplc.shm import Namespace
from tests.lib.channels import open_channel
channel = open_channel(Namespace(sys.argv[1]))
writer = channel.writer(beat_ms=100)
print("ready", flush=True)
while True:
    writer.beat()
    time.sleep(0.01)
"""


def look(namespace: Namespace, **how: object) -> Objects:
    held = held_files(Path("/proc"))
    return look_at_objects(Path(namespace.directory), held, prefix=namespace.prefix, **how)  # type: ignore[arg-type]


def test_a_holder_is_seen_and_its_death_too(shm_namespace: Namespace) -> None:
    """A bridge in another process holds its object and beats; when it is killed it does neither."""
    child = start_child(_OWNER, shm_namespace.prefix)
    try:
        until(child, "ready")
        (seen,) = look(shm_namespace).objects
        while not seen.bridge_beats:  # on a machine with much else to do; pytest's timeout is the watchdog
            (seen,) = look(shm_namespace).objects
        assert seen.topic == TOPIC and seen.held and not seen.plc_beats
    finally:
        child.kill()
        child.communicate()
    (seen,) = look(shm_namespace).objects
    assert seen.held is False and not seen.bridge_beats and not seen.live


def test_looking_takes_no_lock_and_changes_no_byte(shm_namespace: Namespace) -> None:
    """While the doctor looks, the locks of the machine and the object stay as they are."""
    open_channel(shm_namespace).close()
    path = shm_namespace.path(TOPIC)
    before = path.read_bytes()
    seen_locks = []

    def sleep(seconds: float) -> None:
        held = held_files(Path("/proc"))
        lock = shm_namespace.lock_path(TOPIC).stat()
        seen_locks.append(
            held is not None and (os.major(lock.st_dev), os.minor(lock.st_dev), lock.st_ino) in held
        )

    with open_channel(shm_namespace) as channel:
        channel.writer(beat_ms=10)
        look(shm_namespace, sleep=sleep)
    assert seen_locks and all(seen_locks)
    seen_locks.clear()
    look(shm_namespace, sleep=sleep)
    assert not any(seen_locks)
    with open_channel(shm_namespace) as channel:
        assert channel.adopted
    assert path.read_bytes()[:128] == before[:128]


def test_a_plc_that_writes_is_seen(shm_namespace: Namespace) -> None:
    """Towards ROS the PLC is the writer, and the bridge reader line 0."""
    with (
        open_channel(shm_namespace, Direction.TO_ROS) as channel,
        attach(shm_namespace, TOPIC, write=True) as plc,
    ):
        writer = plc.writer(beat_ms=100)
        reader = channel.reader(beat_ms=100)

        def both(seconds: float) -> None:
            writer.beat()
            reader.beat()

        (seen,) = look(shm_namespace, sleep=both).objects
        assert seen.bridge_beats and seen.plc_beats
        (seen,) = look(shm_namespace, sleep=lambda seconds: writer.beat(), seconds=0.2).objects
        assert seen.plc_beats and not seen.bridge_beats


def test_a_plc_that_reads_is_seen_with_its_layout(shm_namespace: Namespace) -> None:
    """Towards the PLC a reader line tells task and layout."""
    with open_channel(shm_namespace) as channel, attach(shm_namespace, TOPIC, write=True) as plc:
        reader = plc.reader("RosTask", observe=False, beat_ms=100)
        (seen,) = look(shm_namespace, sleep=lambda seconds: reader.beat()).objects
        (line,) = seen.plc_lines
        assert line.task == "RosTask" and line.layout_id == channel.identity.layout_id


def test_an_unreadable_list_of_locks_is_not_taken_for_no_lock(
    shm_namespace: Namespace, tmp_path: Path
) -> None:
    """Where the kernel does not list locks, nobody is said to hold nothing."""
    assert held_files(tmp_path) is None
    with open_channel(shm_namespace):
        found = look_at_objects(Path(shm_namespace.directory), None, prefix=shm_namespace.prefix, seconds=0.0)
        assert found.objects[0].held is None


def test_locks_are_read_as_the_kernel_writes_them(tmp_path: Path) -> None:
    """Only flock entries count; device numbers are hexadecimal."""
    (tmp_path / "locks").write_text(
        "1: FLOCK  ADVISORY  WRITE 77 00:1b:181942 0 EOF\n2: POSIX  ADVISORY  READ 78 08:01:5 0 EOF\n"
        "2: -> FLOCK  ADVISORY  WRITE 79 00:1b:4 0 EOF\n3: FLOCK  ADVISORY  READ 80 fd:0a:12 0 EOF\n"
    )
    assert set(held_files(tmp_path)) == {(0, 0x1B, 181942), (0xFD, 0x0A, 12)}


def test_objects_that_come_and_go_disturb_nobody(shm_namespace: Namespace) -> None:
    """An object that is retired and replaced while it is looked at does no harm."""
    channel = open_channel(shm_namespace)
    channel.writer(beat_ms=100)

    def remove(seconds: float) -> None:
        channel.retire() if shm_namespace.path(TOPIC).exists() else None

    (seen,) = look(shm_namespace, sleep=remove, seconds=0.2).objects
    assert seen.topic == TOPIC
    assert look(shm_namespace).objects == ()


def test_an_object_that_may_not_be_opened_is_not_called_damaged(shm_namespace: Namespace) -> None:
    """Without a right or a descriptor to look at an object, nothing is said about its content."""
    open_channel(shm_namespace).close()
    found = look(shm_namespace, seconds=0.0)
    for code in ("SHM102", "SHM123"):
        (seen,) = found.objects
        hidden = replace(seen, error=ChannelError(code, "no"), identity=None, description=None, snapshot=None)
        codes = problems(soundness(replace(found, objects=(hidden,)), shm_namespace.prefix))
        assert set(codes) == {"DOC003"}


def test_a_real_semaphore_is_read(shm_namespace: Namespace) -> None:
    """The value that the C library keeps is seen, and looking leaves it as it is."""
    name = f"{shm_namespace.prefix}.x"
    semaphore = Semaphore(name, create=True)
    path = Path(shm_namespace.directory) / f"sem.{name}"
    try:
        plan = ClassicPlan(name, name, 1, 1)
        bits = 64 if sys.maxsize > 1 << 32 else 32

        def codes() -> set[str]:
            return set(problems(locks(path.parent, [plan], bits, sleep=lambda seconds: None)))

        assert codes() == set()
        assert semaphore.enter()
        assert codes() == {"DOC214"}
        semaphore.leave()
        semaphore.leave()
        assert codes() == {"DOC216"} and semaphore.value == 2
    finally:
        semaphore.close()
        path.unlink()


def test_a_damaged_object_that_no_configuration_names_is_a_warning(shm_namespace: Namespace) -> None:
    """Only with a configuration is it known that somebody needs the name."""
    open_channel(shm_namespace).close()
    shm_namespace.path(TOPIC).write_bytes(b"x" * 600)
    found = look(shm_namespace, seconds=0.0)
    assert problems(soundness(found, None))["DOC211"].level is Level.WARNING
    assert problems(soundness(found, shm_namespace.prefix))["DOC211"].level is Level.ERROR
    strangers = replace(found, locks=frozenset())
    assert not problems(soundness(strangers, None))  # any program may have a file of such a name
