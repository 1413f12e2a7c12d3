"""``rosplc.yaml``: text, settings, types, layouts, the words of ``rosplc check``, and the PLC project."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from typing import Any, cast

from rosplc.cli.text import finite
from rosplc.config.file import parse_config
from rosplc.config.resolve import resolve
from rosplc.errors import RosplcError
from rosplc.plc import base
from rosplc.plc.build import plc_project
from rosplc.plc.plan import ProjectOptions
from rosplc.project import check as facts
from tests.fuzz.oracle import refusals
from tests.fuzz.plc_oracle import check_project
from tests.fuzz.scratch import emptied

__all__ = ["check", "seeds"]

_LARGE = 1 << 16
_MOST_TOPICS = 4
base.parse_object = cache(base.parse_object)
base.read_objects = cast(Any, cache(base.read_objects))
_folder = emptied("configuration")
(_folder / "msg").mkdir()
(_folder / "msg/Own.msg").write_text('uint8 A=1\nstring<=9 name "x"\nfloat64[] values\n')

_WHOLE = """\
bridge: cell1
prefix: cell-1
ros: {backend: auto, distro: jazzy, domain: 5, namespace: /a, remap: {/x: /y}, node_name: n}
types: {paths: [./msg]}
limits: {string: 80, sequence: 16}
shm: {mode: "0640", owner: root, group: 0, directory: /dev/shm}
tick: 1ms
beat: 100ms
diagnostics: {enabled: true, period: 1s, debounce: 10ms}
realtime: {policy: fifo, priority: 20, affinity: [0, 1], lock_memory: true, gc: freeze}
tasks:
  Fast: {interval: 1ms, priority: 1, watchdog: 5ms, watchdog_sensitivity: 2}
  Slow: {kind: freewheeling}
topics:
  /cmd_vel: {type: geometry_msgs/msg/Twist, to: plc, on_stale: {value: {linear: {x: 0.5}}}}
  /name: {type: std_msgs/String, to: ros, limits: {data: 9}, qos: {preset: latched, depth: 3, deadline: 1s}}
  /own: {type: fuzz/Own, to: plc, limits: {values: 3}, rate: 50Hz, rate_limit: 10Hz, on_overflow: truncate}
  /old: {type: std_msgs/msg/Int8, to: ros, classic: {name: old, semaphore: none, wait: 5ms}, task: Slow}
"""


def check(data: bytes) -> None:
    """Whatever the text is, it is refused with lines and keys, or can be explained and built."""
    text = data.decode("utf-8", "surrogateescape")
    with refusals(RosplcError):
        project = resolve(parse_config(text, name="rosplc.yaml", base=_folder))
        finite(facts(project))
        sizes = sum(plan.layout.size for plan in project.topics)
        if len(project.topics) <= _MOST_TOPICS and sizes < _LARGE:
            check_project(plc_project(project, ProjectOptions()), [plan.layout for plan in project.topics])


def seeds() -> Iterator[bytes]:
    """Whole files, each section alone, and what YAML is known for."""
    yield _WHOLE.encode()
    for line in _WHOLE.splitlines():
        if not line.startswith(" "):
            yield line.encode()
    yield b"topics: {/a: {type: std_msgs/msg/Int8, to: plc, classic: true}}\n"
    yield b"ros: {distro: noetic}\ntopics: {/a: {type: std_msgs/String, to: ros}}\n"
    yield b"a: &a [x, x]\nb: &b [*a, *a]\nc: [*b, *b]\n"
    yield b"[" * 40
    yield b"{a: " * 40
    yield b"? [a]\n: b\n"
    yield b"topics: !!python/object/apply:os.system [id]\n"
    yield b"tick: 99999999999999999999999999\nlimits: {string: 1e999, sequence: 0x10}\n"
    yield b'types: {paths: [/, /proc, ../.., "\\0", ~]}\n'
    yield 'bridge: \u2028\ntopics: {"/\\uD800": {type: "\\x85", to: plc}}\n'.encode()
    yield b"---\na: b\n---\n"
    yield b"\xef\xbb\xbfbridge: x\r\n%YAML 1.1\n"
    yield b'bridge: "\\e[31m"\ntopics: {"/\\e[2J": {type: x, to: plc}}\n'
