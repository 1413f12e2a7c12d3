"""Write docs/reference/limits.md from the limits in the code; ``--verify`` only compares."""

from __future__ import annotations

import importlib
from dataclasses import dataclass

from generated_page import REFERENCE, filled, run

PAGE = REFERENCE / "limits.md"


@dataclass(frozen=True)
class Limit:
    """One limit.

    Attributes:
        what: What it limits, in words.
        module: Where the number stands.
        name: Under which name.
        unit: Its unit.
        beyond: What happens beyond it: an error's code, or words.
    """

    what: str
    module: str
    name: str
    unit: str
    beyond: str

    @property
    def value(self) -> int:
        """The number, as the code has it."""
        return int(getattr(importlib.import_module(self.module), self.name))


TABLE = """\
Configuration:
    size of the configuration file | config.yaml_source.LARGEST_FILE | bytes | CFG001
    levels of nesting | config.yaml_source.DEEPEST | levels | CFG002
    errors reported at once | config.yaml_source.MOST_ERRORS | errors | only the first are reported
    topics | config.settings.MOST_TOPICS | topics | CFG004
    tasks | config.settings.MOST_TASKS | tasks | CFG004
    message folders, Zenoh addresses | config.settings.MOST_PATHS | each | CFG004
    names in `ros.remap` | config.settings.MOST_REMAPPINGS | names | CFG004
    name of a topic or namespace | config.settings.LONGEST_NAME | characters | CFG004
    name of a message type | config.settings.LONGEST_TYPE | characters | CFG004
    path or address | config.settings.LONGEST_TEXT | characters | CFG004
    capacity of a string | layout.nodes.MAX_STRING | bytes | LAY001
    capacity of a sequence | layout.nodes.MAX_SEQUENCE | elements | LAY001
Message definitions:
    text of one definition, including the types that it uses | model.parse.MAX_TEXT | bytes | TYP007
    fields and constants in one definition | model.parse.MAX_FIELDS | fields | TYP007
    name of a type | model.parse.MAX_NAME | characters | TYP001
    nesting of types | model.store.MAX_DEPTH | levels | TYP007
    definitions below one folder | model.folders.MAX_FILES | files | TYP008
    files of any kind below one folder | model.folders.MAX_ENTRIES | files | TYP008
    fields of one record, including those of nested types | layout.nodes.MAX_ITEMS | fields | LAY003
    size of one record | layout.nodes.MAX_RECORD | bytes | LAY003
    nesting of sequences | codec.compile.MAX_LOOPS | levels | TYP007
Objects in shared memory:
    name of an object | shm.constants.MAX_NAME | characters | shortened with a hash
    size of an object | shm.constants.MAX_OBJECT_SIZE | bytes | SHM108
    size of a record | shm.constants.MAX_RECORD_SIZE | bytes | SHM108
    self-description | shm.constants.MAX_DESCRIPTION_SIZE | bytes | SHM108
    slots | shm.constants.MAX_SLOTS | slots | SHM108
    readers visible to others | shm.constants.READER_LINES | readers | further readers are invisible
    retries when reading a message | shm.constants.MAX_RETRIES | retries | the last good message is kept
    promised time between beats | shm.constants.MAX_BEAT_MS | ms | treated as this value
ROS:
    name of a topic | ros.names.LONGEST_NAME | characters | ROS005
    peers listed in one reason | ros._base.MOST_REASONS | peers | further peers are only counted
    text about one peer | ros._base.LONGEST_REASON | characters | cut off
    different reasons in the log | ros._base.MOST_REMEMBERED | reasons | further reasons are not logged
ROS over DDS:
    name of a node in an announcement | ros.dds.peers.LONGEST_NAME | bytes | refused
    participants with stored announcements | ros.dds.peers.MOST_PARTICIPANTS | participants | not stored
    domain | ros.dds.backend.MAX_DOMAIN |  | ROS010
ROS over Zenoh:
    liveliness token | ros.zenoh.keys.LONGEST_TOKEN | characters | refused, counted
    stored tokens | ros.zenoh.keys.MOST_TOKENS | tokens | refused, counted
    Zenoh's configuration file | ros.zenoh.backend.LARGEST_FILE | bytes | ROS013, ROS010
ROS 1:
    connection header | ros.rospy.handshake.MOST_HEADER | bytes | connection closed
    message | ros.rospy.topics.LARGEST_MESSAGE | bytes | connection closed
    response of a node or master | ros.rospy.master.MOST_ANSWER | bytes | treated as no response
    request to the node's XML-RPC interface | ros.rospy.slave.MOST_REQUEST | bytes | HTTP 413
    simultaneous callers | ros.rospy.slave.MOST_CALLERS | connections | connection closed
    subscribers whose header is awaited | ros.rospy.slave.MOST_GREETINGS | connections | connection closed
PLC code:
    tasks | plc.build.MOST_TASKS | tasks | PLC003
    name of a topic | plc.build.LONGEST_TOPIC | characters | PLC006
    name of a classic shared memory or semaphore | plc.plan.LONGEST_NAME | characters | PLC007
    list of generated files | plc.delivery.LARGEST_MANIFEST | bytes | PLC001
    generated file that the doctor reads | doctor.code.LARGEST_FILE | bytes | cut off
Recordings, monitoring, the web page:
    uncompressed size of a chunk of a recording | recorder.mcap_file.MAX_CHUNK | bytes | REC003
    monitored channels | monitor.watch.MAX_CHANNELS | channels | further channels are not shown
    record of a monitored channel | monitor.watch.MAX_RECORD | bytes | not shown
    open messages per page | web.live.MAX_MESSAGES | messages | WEB009
    plotted fields per page | web.live.MAX_PLOTS | fields | WEB009
    path of a field | web.live.MAX_PATH | characters | WEB009
Errors:
    each text in an error | errors.LONGEST_TEXT | characters | the middle is omitted
"""
"""Title, then lines: what | where in ``rosplc`` | unit | what happens beyond it."""


def groups() -> dict[str, list[Limit]]:
    """Return the limits by their title."""
    found: dict[str, list[Limit]] = {}
    for line in TABLE.splitlines():
        if not line.startswith(" "):
            found[line.rstrip(":")] = []
            continue
        what, place, unit, beyond = (part.strip() for part in line.split("|"))
        module, _, name = place.rpartition(".")
        found[list(found)[-1]].append(Limit(what, f"rosplc.{module}", name, unit, beyond))
    return found


def parts() -> dict[str, str]:
    """Return the page's generated part."""
    found = []
    for title, limits in groups().items():
        rows = ["| what | at most | beyond | in `rosplc.…` |", "| --- | ---: | --- | --- |"]
        for limit in limits:
            place = f"{limit.module.removeprefix('rosplc.')}.{limit.name}"
            rows.append(f"| {limit.what} | {_number(limit)} | {_beyond(limit.beyond)} | `{place}` |")
        table = "\n".join(rows)
        found.append(f"## {title}\n\n{table}\n")
    return {"limits": "\n".join(found)}


def _number(limit: Limit) -> str:
    value = limit.value
    if limit.unit == "bytes" and value >= 1 << 20 and value % (1 << 20) == 0:
        return f"{value >> 20} MiB"
    return f"{value:,} {limit.unit}".rstrip()


def _beyond(text: str) -> str:
    codes = [word for word in text.split(", ") if len(word) == 6 and word[3:].isdigit()]
    return ", ".join(f"[{code}](errors.md#{code.lower()})" for code in codes) or text


if __name__ == "__main__":
    raise SystemExit(run(__doc__, {PAGE: filled(PAGE, parts())}))
