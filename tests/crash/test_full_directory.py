"""No room, and directories that cannot be used: spec/shm-format.md, M1 and section 9."""

from __future__ import annotations

import os
import resource
import signal
import sys
from pathlib import Path

import pytest

from rosplc.errors import ChannelError
from rosplc.shm import Namespace, attach
from tests.lib.channels import open_channel
from tests.lib.isolated import mounted

_TOPIC = "/robot1/cmd_vel"
_ROOT = Path(__file__).resolve().parents[2]


def test_full_directory(tmp_path: Path) -> None:
    """A directory without room is an error at creation, never a SIGBUS later; what lives there lives on."""
    script = """
import os, sys
from rosplc.errors import ChannelError
from rosplc.shm import Namespace, attach
from tests.lib.channels import open_channel, pattern
namespace = Namespace("full", sys.argv[1])
small = open_channel(namespace, topic="/small", record_size=64)
writer = small.writer()
for size in (1 << 20, 1 << 28):
    try:
        open_channel(namespace, topic="/large", record_size=size)
    except ChannelError as error:
        assert error.code == "SHM117", error
    else:
        raise AssertionError("there was room")
assert sorted(os.listdir(sys.argv[1])) == ["full.l.large", "full.l.small", "full.t.small"]
free = os.statvfs(sys.argv[1])
assert free.f_bavail > 8, "the failed creation has given its room back"
reader = attach(namespace, "/small").reader()
for number in range(1, 50):
    writer.publish(pattern(number, 64))
out = bytearray(64)
assert reader.latest(out).sequence == 49
open_channel(namespace, topic="/other", record_size=64).close()
print("fine")
"""
    done = mounted(tmp_path, "size=128k", 'exec "$0" -c "$1" "$2"', sys.executable, script, str(tmp_path))
    assert done.stdout.strip() == "fine", done.stderr


def test_file_size_limit(shm_namespace: Namespace) -> None:
    """A limit on file sizes is no room too, and leaves nothing behind."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4096, before[1]))
    try:
        with pytest.raises(ChannelError) as caught:
            open_channel(shm_namespace, record_size=1 << 16)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        signal.signal(signal.SIGXFSZ, handler)
    assert caught.value.code == "SHM117"
    assert shm_namespace.topics() == []
    assert not list(Path(shm_namespace.directory).glob(f"{shm_namespace.prefix}.n.*"))
    open_channel(shm_namespace, record_size=1 << 16).close()


@pytest.mark.needs(when=os.geteuid() == 0, why="only root can become another user")
@pytest.mark.parametrize(
    ("case", "code"),
    [("closed directory", "SHM123"), ("closed object", "SHM102"), ("own", "SHM119"), ("read-only", "SHM122")],
)
def test_another_user(tmp_path: Path, case: str, code: str) -> None:
    """A process without the rights gets the number that says which right is missing."""
    tmp_path.chmod(0o1777)
    for parent in list(tmp_path.parents)[:3]:
        if parent != Path("/tmp"):
            parent.chmod(0o755)
    namespace = Namespace("rosplc", tmp_path)
    mode = 0o644 if case == "read-only" else 0o600
    with open_channel(namespace):
        pass
    namespace.path(_TOPIC).chmod(mode)
    namespace.lock_path(_TOPIC).chmod(0o666)
    if case == "closed directory":
        tmp_path.chmod(0o755)
    pid = os.fork()
    if pid == 0:
        answer = 1
        try:
            os.setgroups([])
            os.setgid(54321)
            os.setuid(12345)
            if case == "closed directory":
                open_channel(namespace, topic="/other")
            elif case == "own":
                open_channel(namespace)
            elif case == "closed object":
                attach(namespace, _TOPIC)
            else:
                with attach(namespace, _TOPIC) as attached:
                    attached.reader(observe=False)
        except ChannelError as error:
            answer = 0 if error.code == code else int(error.code[3:])
        finally:
            os._exit(answer)
    _, status = os.waitpid(pid, 0)
    assert os.waitstatus_to_exitcode(status) == 0
