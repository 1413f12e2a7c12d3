"""The configuration's keys: pydantic models, from which schema and reference are generated.

Each field's ``description`` is its entry in ``docs/reference/configuration.md``. Durations
are nanoseconds (``…_ns``), written in the file with a unit and under the name without it.
"""

from __future__ import annotations

import re
from types import SimpleNamespace
from typing import Annotated, Any, Literal

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Discriminator,
    Field,
    StrictInt,
    Tag,
    WithJsonSchema,
    model_validator,
)

from rosplc.config.quantities import format_duration, parse_duration, parse_mode, parse_rate, parse_stale
from rosplc.config.yaml_source import did_you_mean
from rosplc.model import DISTROS
from rosplc.ros import BACKENDS
from rosplc.ros.parameters import Kind

LONGEST_NAME = 247  # characters of a topic's or namespace's name, as in ROS
LONGEST_TYPE = 255  # characters of a type's name
LONGEST_TEXT = 4096  # characters of a path or an address, as of a path in Linux
MOST_TOPICS = 10_000  # topics of one bridge
MOST_SERVICES = 1_000  # services of one bridge, and actions
MOST_CLIENTS = 256  # uses of one service or action in the PLC's program
MOST_TASKS = 64  # tasks of the PLC; PLC code serves fewer
MOST_PATHS = 256  # folders with messages, and addresses of Zenoh
MOST_REMAPPINGS = 10_000  # names that are replaced

_TOPIC = r"(/[A-Za-z_][A-Za-z0-9_]*)+"
_DURATION_PATTERN = r"^[0-9]{1,14}(\.[0-9]{1,9})? ?(ns|us|µs|ms|s|min|h)$"
_EITHER_PATTERN = r"^[0-9]{1,14}(\.[0-9]{1,9})? ?(ns|us|µs|ms|s|min|h|mHz|Hz|kHz)$"


def between(shortest: str, longest: str) -> AfterValidator:
    """Return a validator for a :data:`Duration` with bounds, such as ``between("50us", "1s")``."""
    low, high = parse_duration(shortest), parse_duration(longest)

    def check(ns: int) -> int:
        if not low <= ns <= high:
            raise ValueError(f"{format_duration(ns)!r} is not between {shortest} and {longest}")
        return ns

    return AfterValidator(check)


def _text(pattern: str, *examples: str) -> WithJsonSchema:
    return WithJsonSchema({"type": "string", "pattern": pattern, "examples": list(examples)})


Duration = Annotated[int, BeforeValidator(parse_duration), _text(_DURATION_PATTERN, "10ms", "1s")]
"""Nanoseconds, written with a unit."""

Interval = Annotated[int, BeforeValidator(parse_rate), _text(_EITHER_PATTERN, "10Hz", "100ms")]
"""Nanoseconds, written as a rate or as a duration."""

StaleAfter = Annotated[
    int,
    BeforeValidator(parse_stale),
    WithJsonSchema({"anyOf": [{"const": "never"}, {"type": "string", "pattern": _DURATION_PATTERN}]}),
]
"""Nanoseconds; 0 for ``never``."""

FileMode = Annotated[
    int,
    BeforeValidator(parse_mode),
    Field(ge=0),
    WithJsonSchema({"type": "string", "pattern": "^(0o?)?[0-7]{3}$"}),
]
"""Permission bits."""


def _absolute(what: str) -> AfterValidator:
    def check(name: str) -> str:
        _not_longer(name, LONGEST_NAME)
        if not re.fullmatch(_TOPIC, name):
            nearest = "/" + "/".join(part for part in re.sub(r"[^A-Za-z0-9_/]", "_", name).split("/") if part)
            hint = f", such as {nearest!r}" if re.fullmatch(_TOPIC, nearest) else ""
            raise ValueError(f"{what} start with / and consist of letters, digits, _ and single /{hint}")
        return name

    return AfterValidator(check)


def _not_longer(text: str, most: int) -> None:
    if len(text) > most:
        raise ValueError(f"the text has {len(text)} characters; the limit is {most}")


def _pattern(expression: str, wording: str, longest: int = LONGEST_NAME) -> AfterValidator:
    def check(value: str) -> str:
        _not_longer(value, longest)
        if not re.fullmatch(expression, value):
            raise ValueError(f"{value!r} should be {wording}")
        return value

    return AfterValidator(check)


def _known_distro(name: str) -> str:
    if name not in DISTROS:
        hint = did_you_mean(name, DISTROS)
        listed = "" if "; known" in hint else f" Known: {', '.join(DISTROS)}"
        raise ValueError(f"{name!r} is not a bundled distribution{hint}{listed}")
    return name


def _known_backend(name: str) -> str:
    known = ("auto", *BACKENDS)
    if name not in known:
        raise ValueError(f"{name!r} is not a backend{did_you_mean(name, known)}")
    return name


def _schema(expression: str) -> WithJsonSchema:
    return WithJsonSchema({"type": "string", "pattern": f"^({expression})$"})


_WORD = r"[A-Za-z][A-Za-z0-9_-]{0,31}"
_NODE = r"[A-Za-z_][A-Za-z0-9_]{0,254}"
_NAMESPACE = r"/|(/[A-Za-z_][A-Za-z0-9_]*)+"
_SHM_NAME = r"(?!sem\.)[A-Za-z0-9_][A-Za-z0-9_.-]{0,79}"
_TASK = r"[A-Za-z_][A-Za-z0-9_]{0,63}"
_TYPE = r"[A-Za-z][A-Za-z0-9_]*(/msg)?/[A-Za-z][A-Za-z0-9_]*"
_SERVICE_TYPE = r"[A-Za-z][A-Za-z0-9_]*(/srv)?/[A-Za-z][A-Za-z0-9_]*"
_ACTION_TYPE = r"[A-Za-z][A-Za-z0-9_]*(/action)?/[A-Za-z][A-Za-z0-9_]*"
_CLIENT = r"[A-Za-z][A-Za-z0-9_]{0,31}"

_FRAME = r"[A-Za-z0-9_][A-Za-z0-9_./-]{0,79}"
_NAME = r"(/|~/)?[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*"
_PARAMETER = r"[A-Za-z][A-Za-z0-9_]*(\.[A-Za-z][A-Za-z0-9_]*)*"
_LOCATOR = r"[a-z0-9_-]+/.+"

TopicName = Annotated[str, _absolute("topic names"), _schema(_TOPIC)]
ServiceName = Annotated[str, _absolute("service names"), _schema(_TOPIC)]
ActionName = Annotated[str, _absolute("action names"), _schema(_TOPIC)]
ClientName = Annotated[str, _pattern(_CLIENT, "a letter and up to 31 letters, digits or _"), _schema(_CLIENT)]
FrameName = Annotated[
    str, _pattern(_FRAME, "a frame name of letters, digits, _ . / or -, without leading /"), _schema(_FRAME)
]
Word = Annotated[str, _pattern(_WORD, "a letter and up to 31 letters, digits, _ or -"), _schema(_WORD)]
GraphName = Annotated[str, _pattern(_NAME, "a name such as /cmd_vel, cmd_vel or ~/cmd_vel"), _schema(_NAME)]
Locator = Annotated[
    str,
    _pattern(_LOCATOR, "protocol/address:port, such as tcp/192.168.1.10:7447", LONGEST_TEXT),
    _schema(_LOCATOR),
]
NodeName = Annotated[str, _pattern(_NODE, "letters, digits and _, no leading digit", 255), _schema(_NODE)]
NamespaceName = Annotated[str, _pattern(_NAMESPACE, "/ or a name such as /robot1"), _schema(_NAMESPACE)]
SharedName = Annotated[
    str,
    _pattern(_SHM_NAME, "at most 80 letters, digits, _ . or -, without leading . - or sem."),
    _schema(_SHM_NAME),
]
TaskName = Annotated[str, _pattern(_TASK, "letters, digits and _, no leading digit"), _schema(_TASK)]
TypeName = Annotated[
    str, _pattern(_TYPE, "package/msg/Name, such as geometry_msgs/msg/Twist", LONGEST_TYPE), _schema(_TYPE)
]
ServiceTypeName = Annotated[
    str,
    _pattern(_SERVICE_TYPE, "package/srv/Name, such as std_srvs/srv/Trigger", LONGEST_TYPE),
    _schema(_SERVICE_TYPE),
]
ActionTypeName = Annotated[
    str,
    _pattern(_ACTION_TYPE, "package/action/Name, such as example_interfaces/action/Fibonacci", LONGEST_TYPE),
    _schema(_ACTION_TYPE),
]
ParameterName = Annotated[
    str, _pattern(_PARAMETER, "words of letters, digits and _, separated by dots"), _schema(_PARAMETER)
]
BackendName = Annotated[
    str, AfterValidator(_known_backend), WithJsonSchema({"type": "string", "enum": ["auto", *BACKENDS]})
]
Distro = Annotated[
    str, AfterValidator(_known_distro), WithJsonSchema({"type": "string", "enum": list(DISTROS)})
]


class _Section(BaseModel):
    model_config = ConfigDict(
        extra="forbid",
        frozen=True,
        validate_default=True,
        alias_generator=lambda name: name.removesuffix("_ns"),
    )

    def __reduce__(self) -> tuple[object, ...]:
        # For a bridge, which carries without pydantic: 10 MB of memory.
        return SimpleNamespace, (), {**vars(self), "model_fields_set": self.model_fields_set}


def _f(default: Any, description: str, **constraints: Any) -> Any:
    return Field(default, description=description, **constraints)


class ZenohSettings(_Section):
    """Connections of the `zenoh` backend; the defaults are those of rmw_zenoh."""

    mode: Literal["peer", "client"] | None = _f(
        None, "`peer` discovers peers by gossip and connects to them directly; `client` uses a router."
    )
    connect: Annotated[tuple[Locator, ...], Field(max_length=MOST_PATHS)] | None = _f(
        None, "Addresses of routers or peers, such as `tcp/192.168.1.10:7447`."
    )
    listen: Annotated[tuple[Locator, ...], Field(max_length=MOST_PATHS)] | None = _f(
        None, "Addresses to listen on, such as `tcp/0.0.0.0:0`."
    )
    config: Annotated[str, Field(min_length=1, max_length=LONGEST_TEXT)] | None = _f(
        None, "Path of a Zenoh configuration file (JSON5), relative to this file; the keys above override it."
    )


class RclpySettings(_Section):
    """Start options of the `rclpy` backend's node."""

    ros_args: tuple[Annotated[str, Field(min_length=1, max_length=LONGEST_TEXT)], ...] = _f(
        (), "ROS arguments of the node, as a list of the words after `--ros-args`."
    )
    parameters: dict[str, str | list[str]] = _f(
        {}, "Read-only parameters of the node, by name: strings or lists of strings."
    )


class RosSettings(_Section):
    """The connection to ROS."""

    backend: BackendName = _f(
        "auto",
        "The backend that connects to ROS. `auto` selects it by distribution, environment and installed "
        "packages; `rosplc check` shows the choice and reason. `memory` is for tests within one "
        "process.",
    )
    distro: Distro = _f("jazzy", "The distribution whose message definitions apply; `noetic` is ROS 1.")
    domain: StrictInt | None = _f(None, "The ROS domain. Default: `ROS_DOMAIN_ID`, else 0.", ge=0, le=232)
    node_name: NodeName | None = _f(None, "The node's name. Default: `rosplc_` plus the bridge's name.")
    namespace: NamespaceName = _f(
        "/", "The node's namespace; it does not affect the topics in this file, which are absolute."
    )
    remap: dict[GraphName, GraphName] = _f(
        {},
        "Renamed topics, as `old: new`; `-r old:=new` overrides this key. Names in the PLC do not change.",
        max_length=MOST_REMAPPINGS,
    )
    zenoh: ZenohSettings | None = _f(None, "Settings of the `zenoh` backend; if set, `auto` selects `zenoh`.")
    rclpy: RclpySettings | None = _f(None, "Settings of the `rclpy` backend.")


class TypesSettings(_Section):
    """Custom message types, in addition to the bundled ones."""

    paths: tuple[Annotated[str, Field(min_length=1, max_length=LONGEST_TEXT)], ...] = _f(
        (),
        "Paths of custom `.msg`, `.srv` and `.action` files, relative to this file: folders with "
        "`pkg/msg/Name.msg` files, packages' folders or single files.",
        max_length=MOST_PATHS,
    )


class LimitSettings(_Section):
    """Default capacities; an entry's `limits` or a smaller bound in the definition takes precedence."""

    string: StrictInt = _f(80, "Maximum length in bytes.", ge=1, le=65534)
    sequence: StrictInt = _f(16, "Maximum number of elements.", ge=1, le=1 << 24)


class ShmSettings(_Section):
    """The objects in shared memory."""

    mode: FileMode = _f(
        "0660", "Permission bits, as text. If the PLC runs as another user, set a common `group`."
    )
    owner: Annotated[str, Field(max_length=255)] | StrictInt | None = _f(
        None, "User that owns the objects, by name or number. Only root can give objects to another user."
    )
    group: Annotated[str, Field(max_length=255)] | StrictInt | None = _f(
        None, "Group that owns the objects, by name or number."
    )
    directory: Annotated[str, _pattern(r"/.*", "an absolute path", LONGEST_TEXT)] = _f(
        "/dev/shm", "The folder that contains the objects; change it only for tests and containers."
    )


class DiagnosticsSettings(_Section):
    """The bridge's reports on `/diagnostics`."""

    enabled: bool = _f(True, "Publish diagnostics (`diagnostic_msgs/msg/DiagnosticArray`).")
    period_ns: Annotated[Duration, between("100ms", "1h")] = _f(
        "1s", "Time between two diagnostic messages, 100ms to 1h."
    )
    debounce_ns: Annotated[Duration, between("1ms", "1h")] = _f(
        "500ms",
        "How long a source must be silent beyond `stale_after` before its diagnostic level changes, and "
        "how long it must keep sending before the level recovers, 1ms to 1h. One late message has no effect.",
    )


class RosoutSettings(_Section):
    """Logs that go to `/rosout`, where ROS collects the logs of nodes."""

    bridge: bool = _f(
        True, "Publish the bridge's log on `/rosout`, unless `--ros-args --disable-rosout-logs` is given."
    )
    plc: bool = _f(False, "Let the PLC program log to `/rosout` with `RosPlc_Log` blocks.")
    task: TaskName | None = _f(None, "The PLC task that calls these blocks. Default: the first of `tasks`.")


class TimeSettings(_Section):
    """ROS time in the PLC."""

    plc: bool = _f(False, "Provide ROS time in the PLC, with the `RosPlc_Time` block `ROS_Read.ros_time`.")
    use_sim_time: bool = _f(False, "Take the time from `/clock`, as with `--ros-args -p use_sim_time:=true`.")
    task: TaskName | None = _f(None, "The PLC task that calls the block. Default: the first of `tasks`.")


class RealtimeSettings(_Section):
    """Real-time scheduling of the bridge's threads; without this section, the bridge is an ordinary process.

    The settings apply to the threads that carry messages and send heartbeats, including those of the ROS
    side, but not to the reporter thread, which queries ROS and publishes diagnostics.
    """

    policy: Literal["fifo"] | None = _f(
        None, "`fifo`: SCHED_FIFO, with precedence over ordinary threads; requires permission (SYS010)."
    )
    priority: StrictInt = _f(
        20, "SCHED_FIFO priority, 1 to 99. CODESYS tasks use 52 to 67; choose a lower value.", ge=1, le=99
    )
    affinity: tuple[Annotated[StrictInt, Field(ge=0, le=4095)], ...] = _f(
        (), "Processors that these threads may run on, such as `[1]`. Default: all."
    )
    lock_memory: bool = _f(False, "Lock all used pages in memory, so that they cannot be swapped out.")
    gc: Literal["auto", "off", "freeze"] = _f(
        "auto",
        "Python's garbage collector. `freeze`: it ignores objects created during startup. `off`: it also "
        "runs only on a timer, with a short collection each second and a full one each minute.",
    )

    @model_validator(mode="after")
    def _priority_has_a_policy(self) -> RealtimeSettings:
        if self.policy is None and "priority" in self.model_fields_set:
            raise ValueError("priority has no effect without policy: fifo")
        return self


class TaskSettings(_Section):
    """A task of the PLC; `rosplc generate` creates it, and the bridge derives the number of slots from it."""

    kind: Literal["cyclic", "freewheeling"] = _f("cyclic", "How the task runs.")
    interval_ns: Duration = _f("10ms", "The cycle time.")
    priority: StrictInt = _f(4, "The priority: 0 is the highest, 31 the lowest.", ge=0, le=31)
    watchdog_ns: Duration | None = _f(None, "The maximum time that a cycle may take. Default: no watchdog.")
    watchdog_sensitivity: StrictInt = _f(1, "Consecutive overruns that trigger the watchdog.", ge=1, le=255)


class QosSettings(_Section):
    """Quality of service in ROS 2; omitted keys come from the preset."""

    preset: Literal["default", "sensor_data", "latched"] | None = _f(
        None,
        "`default`: reliable, volatile, depth 10. `sensor_data`: best effort, volatile, depth 5. "
        "`latched`: reliable, transient local, depth 1000. Default: depends on the direction.",
    )
    reliability: Literal["reliable", "best_effort"] | None = _f(None, "Whether lost messages are sent again.")
    durability: Literal["volatile", "transient_local"] | None = _f(
        None,
        "Whether the middleware keeps messages for late subscribers; with `to: plc`, the bridge requests "
        "this from publishers. Default: as given by `latched` if set, else by the preset or the direction.",
    )
    depth: StrictInt | None = _f(
        None, "The maximum number of queued messages (in ROS 1: `queue_size`).", ge=1, le=100_000
    )
    deadline_ns: Interval | None = _f(
        None,
        "`dds` only: the longest time between messages. With `to: ros`, the bridge offers this deadline; "
        "with `to: plc`, it requests the deadline and ignores publishers that do not offer it. Missed "
        "deadlines are counted.",
    )
    lease_ns: Annotated[Duration, between("100ms", "1h")] | None = _f(
        None,
        "`dds` only: how long after its last sign of life a publisher is considered lost (automatic "
        "liveliness), 100ms to 1h. The bridge requests or offers this time like `deadline`.",
    )


class ClassicSettings(_Section):
    """Classic mode: the bare record at offset 0 of a shared memory, guarded by a named semaphore.

    This mode is for existing PLC projects. `classic: true` uses all defaults.
    """

    name: SharedName | None = _f(
        None,
        "Name of the shared memory, without a slash. Default: the topic's name with dots as separators, "
        "such as `arm.cmd_vel` for `/arm/cmd_vel`.",
    )
    semaphore: SharedName | None = _f(
        None,
        "Name of the semaphore, without the prefix `sem.`. Default: the name of the shared memory. `none`: "
        "no lock protects the memory, as in the CODESYS sample.",
    )
    wait_ns: Annotated[Duration, between("100us", "1s")] = _f(
        "5ms", "How long each side waits for the lock before giving up until its next cycle, 100us to 1s."
    )
    recover_after_ns: Annotated[Duration, between("20ms", "1h")] = _f(
        "1s",
        "How long the lock must be held without any sign of life before the bridge considers its holder dead "
        "and frees the lock, 20ms to 1h. It must exceed any pause of a running holder.",
    )


class OnStaleSettings(_Section):
    """A message that replaces those of a silent source."""

    value: dict[str, Any] = Field(
        description="The message's fields, as in `{linear: {x: 0.1}}`; omitted fields have the type's "
        "initial value, which is zero for most fields."
    )
    period_ns: Interval | None = _f(
        None,
        "Required for `to: ros`: how often the message is published while the PLC is silent, such as "
        "`10Hz` or `100ms`.",
    )


def _on_stale_form(value: Any) -> str:
    return "none" if value is None else "group" if isinstance(value, (dict, OnStaleSettings)) else "word"


OnStale = Annotated[
    Annotated[OnStaleSettings, Tag("group")]
    | Annotated[Literal["hold", "zero", "stop"], Tag("word")]
    | Annotated[None, Tag("none")],
    Discriminator(_on_stale_form),
]


class TopicSettings(_Section):
    """One topic, carried in one direction."""

    type: TypeName = Field(description="The message type, `package/msg/Name`.")
    to: Literal["plc", "ros"] = Field(description="The destination of the messages.")
    task: TaskName | None = _f(None, "The PLC task that handles the topic. Default: the first of `tasks`.")
    limits: dict[str, StrictInt] = _f(
        {},
        "Capacities by field path (`name: 6`, `name[]: 32`, `points[].label: 20`); `string` and `sequence` "
        "replace the defaults for this topic.",
    )
    qos: Annotated[
        QosSettings, BeforeValidator(lambda value: {"preset": value} if isinstance(value, str) else value)
    ] = _f(
        {},
        "Quality of service, or the name of a preset. Default for `to: plc`: reliable, volatile, depth "
        "1000. Default for `to: ros`: reliable, transient local (latched), depth 1000.",
    )
    latched: bool | None = _f(
        None,
        "Whether a message already in shared memory at startup is used. `to: plc`: a starting PLC treats "
        "it as new. `to: ros`: a starting bridge publishes it again. `classic` with `to: plc`: the bridge "
        "writes the last message to new memory. `classic` with `to: ros`: the record in memory at "
        "startup counts as a message. Default: true if `qos` requests transient local.",
    )
    every: bool | None = _f(
        None,
        "Whether every message is delivered in order, instead of only the newest. "
        "Default: true with `to: ros`, false with `to: plc`.",
    )
    slots: StrictInt | None = _f(
        None,
        "Slots in shared memory, rounded up to a power of two; N slots hold N-1 messages. Default: from "
        "rate and task; with `to: ros`, enough for a bridge to pause for 200 ms without loss.",
        ge=4,
        le=65536,
    )
    expected_rate_ns: Interval | None = _f(
        None, "The highest rate at which messages arrive. It affects `slots`; `rate_limit` limits the rate."
    )
    rate_limit_ns: Interval | None = _f(
        None,
        "Highest rate (`10Hz`) or shortest interval (`100ms`) at which messages are passed on. "
        "Messages that arrive faster replace each other; the last message is never dropped.",
    )
    on_change: bool = _f(
        False,
        "Pass a message on only if it differs from the previous one. Default with `classic` and `to: "
        "ros`: true, since only a change reveals a new message; with `false`, the bridge publishes at every "
        "poll, with the period of `rate_limit`, else of `expected_rate`, else of the task.",
    )
    on_overflow: Literal["refuse", "truncate"] = _f(
        "refuse", "Whether a message that exceeds a limit is refused and counted, or truncated and counted."
    )
    stale_after_ns: StaleAfter | None = _f(
        None,
        "Age at which the last message counts as stale, or `never`. "
        "Default: `1s` with `to: plc`, `never` with `to: ros`.",
    )
    on_stale: OnStale = _f(
        None,
        "What happens while the source is silent for longer than `stale_after`. `to: plc`: `hold` (default) "
        "keeps the last message, `zero` sets every byte to zero, and `{value: …}` gives the PLC program "
        "that message. `to: ros`: `stop` (default) publishes nothing, and `{value: …, period: …}` "
        "publishes that message, which is counted as substituted.",
    )
    print: bool = _f(False, "Log each message, for debugging.")
    classic: Annotated[
        ClassicSettings | None,
        BeforeValidator(lambda value: {True: {}, False: None}[value] if isinstance(value, bool) else value),
    ] = _f(
        None,
        "`true`, or the keys below: carry this topic as existing shared-memory projects do. There is only "
        "one record, so `slots` and `every` cannot be set.",
    )

    @model_validator(mode="after")
    def _classic_memory_holds_one_record(self) -> TopicSettings:
        if self.classic is not None and (self.slots is not None or self.every):
            word = "every: true" if self.every else "slots"
            raise ValueError(f"{word} cannot be set with classic, which has one record; remove one key")
        return self


class ClientSettings(_Section):
    """One use of a service or action in the PLC's program."""

    task: TaskName | None = _f(None, "The client's PLC task. Default: the task of the service or action.")


def _clients(value: Any) -> Any:
    if not isinstance(value, list):
        return value
    names = [name for name in value if isinstance(name, str)]
    if len(names) < len(value) or len(set(names)) < len(names):
        raise ValueError("clients must be a list of distinct names, or a group such as pick: {task: …}")
    return {name: {} for name in names}


class _CallSettings(_Section):
    type: str
    server: Literal["plc", "ros"] = Field(description="The side that executes the calls.")
    clients: Annotated[
        dict[ClientName, ClientSettings], Field(max_length=MOST_CLIENTS), BeforeValidator(_clients)
    ] = _f(
        {},
        "`server: ros`: the clients in the PLC program, each with its own block and objects, such as `[pick, "
        "place]` or `{pick: {task: Fast}}`. Default: a single client without a name.",
    )
    task: TaskName | None = _f(None, "The PLC task that handles the calls. Default: the first of `tasks`.")
    limits: dict[str, StrictInt] = _f(
        {},
        "Capacities by field path (`request.name: 6`, `response.message: 200`; for an action `goal.name: "
        "6`); `string` and `sequence` replace the defaults.",
    )
    on_overflow: Literal["refuse", "truncate"] = _f(
        "refuse",
        "What happens to data from ROS that exceeds a limit. `truncate`: it is truncated. `refuse`: requests "
        "and goals are refused, feedback is dropped, calls from the PLC end as `UNREADABLE`, and goals from "
        "the PLC end without a result.",
    )


class ServiceSettings(_CallSettings):
    """One service. With `server: ros`, the PLC calls it; with `server: plc`, the PLC executes it."""

    type: ServiceTypeName = Field(description="The service type, `package/srv/Name`.")
    depth: StrictInt = _f(
        16, "`server: plc`: maximum of waiting and running calls; further calls are refused.", ge=1, le=1000
    )
    per_client: StrictInt | None = _f(
        None,
        "`server: plc`, over `dds`: the same maximum per client. Default: a quarter of `depth`. Other "
        "backends do not distinguish clients.",
        ge=1,
        le=1000,
    )
    rate_limit_ns: Interval | None = _f(
        None, "`server: plc`: minimum time between calls to the PLC, or their maximum rate."
    )
    expire_after_ns: Annotated[Duration, between("1ms", "1h")] = _f(
        "5s", "`server: plc`: how long a call may wait before it is no longer passed to the PLC, 1ms to 1h."
    )
    fallback: dict[str, Any] | None = _f(
        None,
        "`server: plc`: the response to a caller if the PLC sends none, such as `{success: false, "
        "message: PLC is not running}`. Default: no response; in ROS 1, an error.",
    )


class ActionSettings(_CallSettings):
    """One action. With `server: ros`, the PLC uses it; with `server: plc`, the PLC executes it."""

    type: ActionTypeName = Field(description="The action type, `package/action/Name`.")
    on_new_goal: Literal["reject", "abort", "buffer"] = _f(
        "reject",
        "`server: plc`: what happens to a goal that arrives while the PLC has another goal. `reject`: the "
        "new goal is rejected. `abort`: the PLC is asked to end its goal (`xPreempt`), then gets the new "
        "one. `buffer`: the new goal waits.",
    )
    queue: StrictInt | None = _f(
        None, "`on_new_goal: buffer`: how many goals can wait, default 4; others are rejected.", ge=1, le=100
    )
    accept_within_ns: Annotated[Duration, between("1ms", "1h")] = _f(
        "5s",
        "`server: plc`: how long the PLC may take to accept or reject a goal before the goal is withdrawn "
        "and rejected, 1ms to 1h.",
    )
    keep_result_ns: Annotated[Duration, between("100ms", "1h")] = _f(
        "10s", "`server: plc`: how long clients can request the result of a goal that has ended, 100ms to 1h."
    )
    when_plc_down: Literal["cancel", "keep"] = _f(
        "cancel",
        "`server: ros`: what happens to a goal in ROS when the PLC program stops or goes silent. "
        "`cancel`: the server is asked to cancel the goal. `keep`: the goal continues.",
    )


class ParameterSettings(_Section):
    """One parameter of the bridge's node, which is a variable in the PLC."""

    type: Kind = Field(description="The type, one of `rcl_interfaces/msg/ParameterType`.")
    value: Any = _f(None, "The initial value, also in the PLC code. Default: zero, false or empty.")
    range: Annotated[tuple[StrictInt | float, ...], Field(min_length=2, max_length=3)] | None = _f(
        None, "Allowed range of an integer or double: `[minimum, maximum]` or `[minimum, maximum, step]`."
    )
    read_only: bool = _f(False, "Only the PLC program may change the value.")
    description: Annotated[str, Field(max_length=LONGEST_TEXT)] = _f("", "A description for users.")
    capacity: StrictInt | None = _f(
        None, "Maximum number of elements of an array. Default: `limits.sequence`.", ge=1, le=1 << 24
    )
    length: StrictInt | None = _f(
        None, "Maximum length of each string in bytes. Default: `limits.string`.", ge=1, le=65534
    )


class ParametersSettings(_Section):
    """The parameters of the bridge's node."""

    initial: Literal["file", "plc"] = _f(
        "file",
        "The values at startup. `file`: at first those of this file, `--params-file` and `-p`; after a "
        "restart, the last values. `plc`: always the PLC's initial values.",
    )
    task: TaskName | None = _f(None, "The PLC task that uses the parameters. Default: the first of `tasks`.")
    declare: dict[ParameterName, ParameterSettings] = _f(
        {}, "The parameters by name.", max_length=MOST_SERVICES
    )


class TransformSettings(_Section):
    """The pose of one frame in another, from the transforms on `/tf` and `/tf_static`."""

    target: FrameName = Field(description="The frame in which the pose is expressed, such as `base_link`.")
    source: FrameName = Field(description="The frame whose pose is given, such as `tool0`.")
    rate_ns: Annotated[Interval, between("1ms", "1h")] = _f(
        "50Hz", "How often the PLC gets the pose, such as `100Hz` or `10ms`."
    )
    max_age_ns: StaleAfter = _f("1s", "Age at which a non-static pose becomes invalid, or `never`.")
    task: TaskName | None = _f(None, "The PLC task that reads the pose. Default: the first of `tasks`.")


class Settings(_Section):
    """A whole configuration file."""

    bridge: Word = _f("rosplc", "The bridge's name, used in logs, diagnostics and the node's name.")
    prefix: Word = _f(
        "rosplc",
        "Prefix of the objects' names, so that two cells on one machine can both carry `/cmd_vel`.",
    )
    ros: RosSettings = _f({}, "The connection to ROS.")
    types: TypesSettings = _f({}, "Custom message types.")
    limits: LimitSettings = _f({}, "Capacities of strings and sequences.")
    shm: ShmSettings = _f({}, "The objects in shared memory.")
    tick_ns: Annotated[Duration, between("50us", "1s")] = _f(
        "1ms",
        "How often the bridge polls for messages from the PLC, 50us to 1s. With no PLC running, every 10 ms; "
        "after 10 s without a message, once per PLC scan and at least every 10 ms.",
    )
    beat_ns: Annotated[Duration, between("10ms", "10s")] = _f(
        "100ms", "Heartbeat period, 10ms to 10s; after three missed heartbeats, the bridge counts as dead."
    )
    diagnostics: DiagnosticsSettings = _f({}, "ROS diagnostics.")
    rosout: RosoutSettings = _f({}, "Logging to ROS.")
    time: TimeSettings = _f({}, "ROS time in the PLC.")
    realtime: RealtimeSettings = _f({}, "Real-time scheduling.")
    tasks: dict[TaskName, TaskSettings] = _f(
        {"RosTask": {}},
        "Tasks of the PLC by name; topics without `task` belong to the first task.",
        min_length=1,
        max_length=MOST_TASKS,
    )
    programs: TaskName = _f(
        "SharedMemory", "Prefix of the generated programs' names; `--programs` overrides it."
    )
    topics: dict[TopicName, TopicSettings] = _f({}, "Topics by their ROS name.", max_length=MOST_TOPICS)
    services: dict[ServiceName, ServiceSettings] = _f(
        {}, "Services by their ROS name.", max_length=MOST_SERVICES
    )
    actions: dict[ActionName, ActionSettings] = _f({}, "Actions by their ROS name.", max_length=MOST_SERVICES)
    parameters: ParametersSettings = _f({}, "Parameters of the bridge's node, as variables in the PLC.")
    transforms: dict[ClientName, TransformSettings] = _f(
        {}, "Poses of frames for the PLC, each under a name of your choice.", max_length=MOST_SERVICES
    )

    @model_validator(mode="before")
    @classmethod
    def _empty_sections_are_absent(cls, data: Any) -> Any:
        return (
            {key: value for key, value in data.items() if value is not None}
            if isinstance(data, dict)
            else data
        )
