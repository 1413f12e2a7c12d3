"""The errors of the whole package: each has a code, a description, a place and a remedy.

Every error that a user can encounter is a :class:`RosplcError`. Its ``code`` never changes its
meaning: ``docs/reference/errors.md``, generated from :data:`CODES`, has one entry per code.
The numbers of the codes that begin with ``SHM`` are also the error numbers that a PLC's
function block shows; ``spec/shm-format.md`` section 9 lists them.

This module is at the bottom of the dependency order and imports nothing of rosplc.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import ClassVar

__all__ = [
    "CODES", "LONGEST_TEXT", "BackendError", "ChannelError", "CodeInfo", "CodecError", "ConfigError",
    "GenerationError", "LayoutError", "MessageTypeError", "RecordingError", "RosplcError", "SetupError",
    "WebError",
]  # fmt: skip


@dataclass(frozen=True)
class CodeInfo:
    """The meaning of an error code, for the reference page and for errors raised without a remedy.

    Attributes:
        code: The stable code, such as ``"SHM112"``.
        title: The meaning in a few words.
        remedy: What usually helps.
    """

    code: str
    title: str
    remedy: str


CODES: dict[str, CodeInfo] = {}

LONGEST_TEXT = 2000
"""The maximum length of each text of an error; longer texts are shortened in the middle."""


def _register(code: str, title: str, remedy: str) -> None:
    if code in CODES:  # pragma: no cover - a programming error, found at import
        raise ValueError(f"error code {code} is registered twice")
    CODES[code] = CodeInfo(code, title, remedy)


class RosplcError(Exception):
    """The base of every error that rosplc raises on purpose.

    Args:
        code: A code registered in :data:`CODES`.
        what: What happened, one sentence without a full stop at the end.
        where: The place: ``file:line: key``, an object's path, a topic, a field path.
        remedy: What the reader can do; the code's usual remedy if empty.

    Attributes:
        code: As above, like ``what``, ``where`` and ``remedy``.
    """

    family: ClassVar[str] = ""

    def __init__(self, code: str, what: str, *, where: str = "", remedy: str = "") -> None:
        if not code.startswith(self.family) or code not in CODES:
            raise ValueError(f"{code} is not a registered code of {type(self).__name__}")
        self.code = code
        self.what = _bounded(what)
        self.where = _bounded(where)
        self.remedy = _bounded(remedy) or CODES[code].remedy
        super().__init__(code, self.what, self.where, remedy)

    def __str__(self) -> str:
        place = f"{self.where}: " if self.where else ""
        return f"{place}{self.what} [{self.code}] {self.remedy}".rstrip()

    def __reduce__(self) -> tuple[object, ...]:
        # Exceptions with keyword arguments do not survive pickling by default.
        return partial(type(self), where=self.where, remedy=self.remedy), (self.code, self.what)

    def to_dict(self) -> dict[str, str]:
        """Return the error as plain data, for ``--json`` output."""
        return {"code": self.code, "what": self.what, "where": self.where, "remedy": self.remedy}


def _bounded(text: str) -> str:
    """Return an overlong text, which comes from another program, without its middle part."""
    return text if len(text) <= LONGEST_TEXT else f"{text[: LONGEST_TEXT - 300]} … {text[-200:]}"


class MessageTypeError(RosplcError):
    """A ROS message type is unknown, malformed or not supported by rosplc."""

    family = "TYP"


class LayoutError(RosplcError):
    """A layout cannot be computed, or two layouts that must agree differ."""

    family = "LAY"


class CodecError(RosplcError):
    """Wire bytes or a record were rejected; the text shows the field, size and limit."""

    family = "COD"


class ChannelError(RosplcError):
    """A shared-memory object cannot be created, opened, claimed or trusted."""

    family = "SHM"


class ConfigError(RosplcError):
    """The configuration is wrong; ``where`` is ``file:line: key``."""

    family = "CFG"


class BackendError(RosplcError):
    """The ROS side failed: a backend is missing, or the middleware refused something."""

    family = "ROS"


class GenerationError(RosplcError):
    """PLC code cannot be generated, or would overwrite an edited file."""

    family = "PLC"


class RecordingError(RosplcError):
    """A recording cannot be made, read or replayed."""

    family = "REC"


class SetupError(RosplcError):
    """The machine lacks a package, permission, ``/dev/shm`` space or other resource."""

    family = "SYS"


class WebError(RosplcError):
    """The web page cannot be served, or a browser's request was refused."""

    family = "WEB"


_register("TYP001", "unknown message type", "Check the spelling with `rosplc types`, or add the folder of the type's package to types.paths.")
_register("TYP002", "syntax error in a .msg definition", "Correct the reported line; see https://docs.ros.org for the .msg syntax.")
_register("TYP003", "message type contains itself", "Break the cycle in the .msg files; ROS does not allow cycles either.")
_register("TYP004", "unsupported field type", "wstring and long double are not supported; use string or float64.")
_register("TYP005", "two definitions of one message type differ", "Keep one of the definitions, or move the custom definition to a package with a different name.")
_register("TYP006", "unknown ROS distribution", "Use one of the bundled distributions; `rosplc types --distros` lists them.")
_register("TYP007", "definition exceeds a limit", "Make the definition smaller: its size, depth and number of fields are limited, since definitions may come from the network.")
_register("TYP008", "folder of definitions cannot be used", "Specify a folder with PACKAGE/msg/NAME.msg files (or .srv, .action), a package's own folder, or a single file.")
_register("TYP009", "message definition cannot be saved", "Choose another folder, or remove the file that is in the way.")
_register("TYP010", "node describes a type incorrectly", "Add the folder of the type's package to types.paths; restart the node if it was rebuilt while running.")

_register("LAY001", "capacity is not valid", "Use a whole number: 1 to 65534 for a string, 1 to 16777216 for a sequence.")
_register("LAY002", "limit for a field that the type does not have", "Use the field path as `rosplc types TYPE` prints it, for example header.frame_id or points[].x.")
_register("LAY003", "record is too large", "Lower the limits of the largest fields; `rosplc types TYPE` shows the sizes.")
_register("LAY004", "capacity exceeds the bound in the .msg definition", "Use a capacity no larger than the bound in the definition.")
_register("LAY005", "layouts differ", "Generate the PLC code again from the same configuration, or restart the side that uses the old layout.")
_register("LAY006", "value does not fit its field", "Use a value of the field's type that is within its range and capacity.")

_register("COD001", "message is truncated", "Use the same type definition as the sender; if the definitions agree, the bytes were damaged.")
_register("COD002", "message has trailing bytes", "Use the same type definition as the sender; if the definitions agree, the bytes were damaged.")
_register("COD003", "unsupported encapsulation", "Send plain CDR (version 1, either byte order), as ROS 2 does.")
_register("COD004", "string does not fit", "Raise this field's limit in the configuration, or set on_overflow: truncate.")
_register("COD005", "sequence does not fit", "Raise this field's limit in the configuration, or set on_overflow: truncate.")
_register("COD006", "bool is neither 0 nor 1", "Use the same type definition as the sender; if the definitions agree, the bytes were damaged.")
_register("COD007", "string is not terminated, or contains a NUL", "Use the same type definition as the sender; if the definitions agree, the bytes were damaged.")
_register("COD008", "sequence exceeds the bound in its type", "Use the same type definition as the sender; if the definitions agree, the bytes were damaged.")
_register("COD009", "record has the wrong size", "Pass a buffer of exactly the layout's record size.")

_register("SHM101", "object does not exist", "Start the bridge that carries this topic, and check the prefix and the topic name.")
_register("SHM102", "no permission to open the object", "Run the program as the object's owner or as a member of its group; see shm.group and shm.mode in the configuration.")
_register("SHM103", "object is smaller than a header", "Another program uses this name; choose another prefix.")
_register("SHM104", "not a rosplc object", "Another program uses this name; choose another prefix.")
_register("SHM105", "format version is not supported", "Use the same rosplc release on both sides.")
_register("SHM106", "object requires features that this side lacks", "Use the same rosplc release on both sides.")
_register("SHM107", "identity is damaged", "Another program wrote into the object. Restart the bridge; it replaces the object.")
_register("SHM108", "geometry is not consistent", "Another program wrote into the object. Restart the bridge; it replaces the object.")
_register("SHM109", "object is smaller than its header states", "Another program truncated the object. Restart the bridge; it replaces the object.")
_register("SHM110", "wrong kind or direction", "The topic is configured in the opposite direction: correct `to:`, or use the matching function block.")
_register("SHM111", "object is retired", "Open the name again: the bridge creates a new object.")
_register("SHM112", "layout differs", "Generate the PLC code again from the same configuration, or restart the side that uses the old layout.")
_register("SHM113", "self-description cannot be read", "Another program wrote into the object. Restart the bridge; it replaces the object.")
_register("SHM114", "another writer holds the claim", "Only one program may write to a topic. Stop the other writer, or wait until its heartbeat stops.")
_register("SHM115", "writer's claim was taken over", "Another writer claimed the object while this writer was silent. Stop one of the two writers.")
_register("SHM116", "another bridge uses this name", "Stop the other bridge, or set a different `prefix:` in the configuration of this bridge.")
_register("SHM117", "not enough room in shared memory", "Free space in /dev/shm, enlarge it (mount -o remount,size=...), or lower the limits or depth of topics.")
_register("SHM118", "name is not valid", "Use letters, digits, _ and / in a topic; letters, digits, _ and - in a prefix.")
_register("SHM119", "object belongs to another user", "Remove the object, run the program as the object's owner, or choose another prefix.")
_register("SHM120", "name refers to another object", "No action needed: the file was removed or replaced while the bridge was running, and the bridge creates the object again within 5 s.")
_register("SHM121", "not a plain file", "Remove the link or device that has this name; rosplc never follows links in this folder.")
_register("SHM122", "this side maps the object read-only", "To publish, attach with write access.")
_register("SHM123", "shared memory directory cannot be used", "Check that /dev/shm is mounted and writable by this user.")
_register("SHM124", "function block was called by two tasks at once", "An instance belongs to one task; declare one instance per task.")
_register("SHM125", "peer is silent", "Start the other side, or find out why it stopped; it reconnects automatically.")
_register("SHM126", "handshake took too long", "Find out why the other side did not signal completion.")
_register("SHM127", "lock was not free in time", "A program holds the semaphore, or died while holding it; the bridge frees it after the time in `classic: recover_after`.")
_register("SHM128", "semaphore cannot be opened", "Give both sides write permission for /dev/shm/sem.NAME (the same user or group). If the semaphore is not in use, remove it.")
_register("SHM129", "classic memory is smaller than the record", "The other side has a different struct: correct the topic's type, limits or name. If the shared memory is not in use, remove it.")
_register("SHM130", "classic memory has an unexpected size", "Compare the structs on both sides. They probably differ: the size is neither the record's nor a multiple of the page size.")
_register("SHM131", "lock of a dead process was freed", "Find out why the process that held the lock died or hung; if it was only slow, raise `classic: recover_after`.")
_register("SHM132", "semaphore admitted more than one process", "Find the program that created the semaphore with a value above 1 or posted it twice; the bridge has corrected the value.")
_register("SHM133", "semaphore belongs to programs of another word size", "A 32-bit and a 64-bit program cannot share a semaphore: run both sides with the same word size, or use the default channel for the topic.")
_register("SHM140", "call was not executed", "It is safe to call again; the returned reason shows what to correct.")
_register("SHM141", "fate of the call is unknown", "The call may have been executed, or may still be executed: check this before you call again.")
_register("SHM142", "call was executed, but its answer cannot be shown", "Raise the limits of the service or action, and generate the PLC code again.")
_register("SHM143", "goal was aborted", "The server aborted the goal; see its result for the reason.")
_register("SHM144", "goal was canceled", "The server canceled the goal, as requested.")
_register("SHM145", "step is not allowed in this state", "Set only the inputs that the state of the call allows; the block reference lists these inputs.")

_register("CFG001", "file cannot be read", "Check the path and the permissions.")
_register("CFG002", "not valid YAML", "Correct the reported line; indentation and colons are the usual causes.")
_register("CFG003", "unknown key", "Check the spelling; `rosplc check --schema` prints every key.")
_register("CFG004", "value is not valid", "Correct the value; `rosplc check --schema` lists the values that each key accepts.")
_register("CFG005", "key is missing", "Add the missing key.")
_register("CFG006", "topic is configured twice", "A topic has only one direction: keep one of the entries.")
_register("CFG007", "two topics have the same object name", "Rename one of the topics, or use a second bridge with another prefix.")
_register("CFG008", "too few slots for the topic's rate", "Raise `slots:` so that no slot is reused while a preempted task is still copying it.")
_register("CFG009", "aliases and custom tags are not accepted", "Write out the value; configurations are plain YAML.")
_register("CFG010", "key is written twice", "Keep only one of the keys; YAML readers silently drop the other.")
_register("CFG011", "ROS argument is not valid", "Correct the argument: --ros-args -r from:=to, or __name:=node __ns:=/namespace from:=to in ROS 1.")
_register("CFG012", "key cannot change while the bridge is running", "Restore the old value of the key, or restart the bridge; until then, nothing in the new file is applied.")
_register("CFG013", "configuration already exists", "Choose another file with --output, or overwrite the existing file with --force.")
_register("CFG014", "configuration cannot be written", "Check the folder and the permissions, or choose another file with --output.")

_register("ROS001", "backend is not available", "Install the backend's package, or set another backend in ros.backend.")
_register("ROS002", "middleware reported an error", "See the message; domain, network interface and QoS are the usual causes.")
_register("ROS003", "peer has a different definition of this type", "Install the same message package on both sides; DDS silently ignores such peers.")
_register("ROS004", "QoS of a peer is not compatible", "Set the topic's reliability and durability as shown in the message.")
_register("ROS005", "topic name is not valid in ROS", "Follow the naming rules: https://design.ros2.org/articles/topic_and_service_names.html.")
_register("ROS006", "recording cannot be read", "Check the file with `rosbags-convert` or `ros2 bag info`.")
_register("ROS007", "QoS settings are not valid", "Correct the reported setting.")
_register("ROS008", "payload is not a message of the topic's type", "Send serialized bytes of the advertised type, with their 4-byte header.")
_register("ROS009", "backend or endpoint is closed", "Open a new backend or endpoint; a closed one cannot be reused.")
_register("ROS010", "ROS environment variable is not valid", "Correct the reported environment variable.")
_register("ROS011", "message package is not installed in ROS", "Install the package for the ROS distribution, or build it, and source its setup.bash.")
_register("ROS012", "installed message type differs from the bridge's", "Set ros.distro to the installed distribution, or add the installed package's .msg folder to types.paths.")
_register("ROS013", "backend option is not valid", "See the message for the keys and values that the backend accepts.")
_register("ROS014", "ROS master is not reachable", "Start roscore, or set ROS_MASTER_URI to the master's address; the bridge connects when the master answers.")
_register("ROS015", "node was told to shut down", "Start the node again. If another node has the same name, set a different name in ros.node_name.")
_register("ROS016", "Zenoh router is not reachable", "Start a router at the address in ros.zenoh.connect (`ros2 run rmw_zenoh_cpp rmw_zenohd`, or `zenohd`); the bridge connects when the router answers.")
_register("ROS017", "definition cannot be received from a publisher", "Start a publisher of the topic; `rostopic info TOPIC` lists its publishers.")
_register("ROS018", "ROS side does not respond", "See the log for the call that hangs; if the bridge does not recover, restart it.")
_register("ROS019", "backend does not support this quality of service", "Remove deadline and lease from the topic's qos, or use the dds backend; stale_after works without them.")
_register("ROS020", "ROS graph is empty", "Start the robot's nodes, and check the domain (ROS_DOMAIN_ID), network (also ROS_LOCALHOST_ONLY) and ROS version; for ROS 1, use --distro noetic.")
_register("ROS021", "peer's services use another protocol", "Set ros.backend: rclpy. DDS has no common service protocol; the dds backend supports only that of rmw_cyclonedds.")
_register("ROS022", "service has several servers", "Stop all but one of the reported nodes, or rename the services of the other nodes: each server executes every request, and the first response counts.")
_register("ROS023", "transform is not available", "See the message for the frame. `ros2 run tf2_tools view_frames` (ROS 1: `rosrun tf view_frames`) shows all frames. Also compare the clocks of the robot's computers.")

_register("PLC001", "generated file was edited", "Move your changes elsewhere and remove the file, or run the command again with --force.")
_register("PLC002", "output folder cannot be written", "Check the path and the permissions.")
_register("PLC003", "too many tasks", "The PLC blocks support at most 16 tasks; put topics of similar urgency into one task.")
_register("PLC004", "Structured Text cannot be translated", "Correct the reported line; the translator supports only the constructs that generated code uses.")
_register("PLC005", "task names differ only in case", "CODESYS does not distinguish such names; rename one task.")
_register("PLC006", "topic name is too long for the PLC", "Choose a shorter name: blocks accept up to 255 characters, blocks for matiec up to 126.")
_register("PLC007", "name is not valid for a classic topic", "In names of shared memory and semaphores, use 1 to 80 printable characters without slashes or spaces.")
_register("PLC008", "name is not valid in PLC code", "Use letters, digits, _ and / in a topic; letters, digits and _ in a task; letters, digits, _ and - in a prefix.")

_register("SYS001", "a program or package is missing", "Install the Debian package shown in the message.")
_register("SYS002", "child process failed", "See the output of this process above.")
_register("SYS003", "no DDS domain is free", "Stop other ROS programs on this machine; the demo needs its own domain.")
_register("SYS004", "processes did not find each other", "The message shows which process is waiting for which; a firewall on loopback is a common cause.")
_register("SYS005", "output cannot be written", "Free space on the disk to which stdout is written, or redirect stdout.")
_register("SYS006", "too many files are open", "A bridge keeps files open for each topic: raise the limit (ulimit -n, LimitNOFILE= in a systemd unit).")
_register("SYS007", "benchmark report cannot be read", "Specify a report.json written by `rosplc-bench --out DIR` of this release.")
_register("SYS008", "shared memory cannot be used", "Check that /dev/shm is mounted, writable by this user and not full.")
_register("SYS009", "comparison program does not compile", "See the compiler's message; if a header is missing, install its -dev package.")
_register("SYS010", "real-time setting is not permitted", "Run the bridge as a service (rosplc service install), or raise the rtprio and memlock limits. Neither is needed if the configuration has no `realtime:`.")
_register("SYS011", "service cannot be installed", "Run the command as root (sudo), preview it with --dry-run, or use --root to write to another folder.")
_register("SYS012", "terminal is not supported", "Use a common terminal type, such as TERM=xterm-256color; with ssh, add -t. In scripts, use `rosplc status`, which prints the same table once.")
_register("SYS013", "no permission to signal the process", "Run the command as the owner of the process, or with sudo.")
_register("SYS014", "not enough memory", "Raise the memory limit (ulimit -v, MemoryMax= in a systemd unit), or lower the limits or depth of topics.")
_register("SYS015", "a resource in the configuration does not exist yet", "Mount the disk, or create the missing group or file; the service retries automatically.")

_register("REC001", "recording cannot be written", "Check the path and the permissions, or choose another location with --output.")
_register("REC002", "disk is full", "Free space or record to another disk; the file is readable and contains everything recorded so far.")
_register("REC003", "recording cannot be read", "If the file is truncated or damaged, `rosplc record --repair FILE` saves the intact part.")
_register("REC004", "nothing to record", "Start the bridge, or specify its prefix with --prefix; `rosplc show` lists the channels.")
_register("REC005", "trigger is not valid", "Use stale, error, a field such as '/plc/status.fault', or a comparison such as '/tank.level > 0.9'.")
_register("REC006", "nothing to replay", "List the recording's topics with `rosplc replay FILE --list`.")
_register("REC007", "topic cannot be replayed", "Leave out the topic with --exclude, or rename it with --rename.")

_register("WEB001", "cannot listen on this address", "Choose another --port, or stop the program that uses this port. --bind must be an address of this machine.")
_register("WEB002", "token file cannot be used", "Write 16 to 256 printable characters without spaces to the file, and make it readable only by you (chmod 600).")
_register("WEB003", "request is for another host", "Open the page by IP address or as localhost, or start the server with --name NAME.")
_register("WEB004", "request comes from another site's page", "Open this server's own page. A proxy in front of the server must forward the Host header.")
_register("WEB005", "token is missing or wrong", "Enter the token that the server printed at startup, or the token in its --token-file.")
_register("WEB006", "writing is not enabled", "Start the server with --allow-write.")
_register("WEB007", "too many pages are connected", "Close one of the pages.")
_register("WEB008", "channel is not available", "Select a channel in the list.")
_register("WEB009", "request is not valid", "Reload the page: it may come from a different release than the server.")
_register("WEB010", "channel cannot be written to", "Stop the other writer: a test message can be written only to a channel without a writer.")
