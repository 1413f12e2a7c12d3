"""Everything that the doctor can find: one line per kind, from which the reference page is made.

A code never changes its meaning, as with errors. Where a kind is about what a bridge would report too, its
text names that error.
"""

from __future__ import annotations

from rosplc.doctor.finding import Area, Finding, Kind, Level

KINDS: dict[str, Kind] = {}


def fine(code: str, seen: str) -> Finding:
    """Return that it was looked for and that all is well."""
    return Finding(code, KINDS[code].area, Level.OK, seen)


def found(
    code: str, seen: str, remedy: str | None = None, command: str = "", level: Level | None = None
) -> Finding:
    """Return that it was found.

    ``seen`` is a sentence without a full stop, ``command`` the exact command that helps; remedy (a full
    sentence) and level replace the usual ones.
    """
    usual = KINDS[code]
    wanted, how = usual.level if level is None else level, usual.remedy if remedy is None else remedy
    return Finding(code, usual.area, wanted, seen, how, command)


def judged(
    code: str, seen: str, well: str, remedy: str | None = None, command: str = "", level: Level | None = None
) -> Finding:
    """Return what was found as :func:`found` does, or, where ``seen`` is empty, that all is well."""
    return found(code, seen, remedy, command, level) if seen else fine(code, well)


def _register(code: str, area: Area, level: Level, title: str, meaning: str, remedy: str) -> None:
    KINDS[code] = Kind(code, area, level, title, meaning, remedy)


_E, _W, _N = Level.ERROR, Level.WARNING, Level.NOTE

_A = Area.DOCTOR
_register("DOC001", _A, _W, "failed examination", "The examination could not be completed, so the result is unknown.", "See the message; run the doctor again, as root if a permission is missing.")
_register("DOC002", _A, _W, "examination that timed out", "The examination did not end within its time limit, so the result is unknown. The resource being checked is probably not responding.", "Check the named resource: a file system or a network name that does not respond is a common cause.")
_register("DOC003", _A, _N, "things that only another user may read", "This user has no permission to read the named resource.", "Run the doctor as root.")

_A = Area.MACHINE
_register("DOC101", _A, _W, "kernel and architecture", "rosplc is tested on x86-64, and with cross-compilers and an emulator on ARM; the format needs a little-endian machine.", "Run it on x86-64 or ARM.")
_register("DOC102", _A, _N, "word size of kernel and programs", "The kernel has 64 bits and this Python 32, as on many single-board computers. Channels work; the semaphore of a classic topic needs the same word size on both sides.", "No action needed unless a classic topic is used with a 64-bit PLC runtime.")
_register("DOC103", _A, _W, "the clock", "The clock is earlier than this release: time stamps of messages are wrong, and jump when it is set.", "Set the clock.")
_register("DOC104", _A, _E, "open files", "A bridge keeps several files and sockets open per topic; if it may not open enough of them, it ends with SYS006.", "Raise the limit in the shell or the service that starts the bridge.")
_register("DOC105", _A, _N, "permission for real time", "Without this permission a bridge runs with ordinary priority; its messages may be delayed beside a busy PLC.", "No action needed unless a few milliseconds matter.")
_register("DOC106", _A, _W, "log-out", "When the last session of an ordinary user ends, systemd removes everything that the user owns in /dev/shm, including objects of a running bridge.", "Run the bridge as a system user, or disable RemoveIPC in systemd.")
_register("DOC110", _A, _E, "installed packages", "A package that rosplc needs is missing.", "Reinstall rosplc with its packages.")
_register("DOC111", _A, _N, "backends without a package for this machine", "PyPI has no wheel for this architecture or this Python.", "Use another backend, or build the package.")
_register("DOC112", _A, _E, "backend that `auto` selects", "No installed backend can reach the graph; the bridge would not start (ROS001).", "Install one of the named backends.")
_register("DOC113", _A, _E, "backend of the configuration", "The package of the backend is not installed; the bridge would not start (ROS001).", "Install the package, or choose another backend in ros.backend.")

_A = Area.MEMORY
_register("DOC201", _A, _E, "/dev/shm is a memory file system", "Without /dev/shm there is no shared memory; on a disk, it would be slow and would survive a restart of the machine.", "Mount /dev/shm as tmpfs.")
_register("DOC202", _A, _E, "mode of /dev/shm", "The folder must be writable by all users, with the sticky bit: 1777.", "Restore the mode.")
_register("DOC203", _A, _E, "room for the configuration's objects", "The objects do not fit; the bridge would not start (SHM117).", "Enlarge /dev/shm, or lower limits and depth.")
_register("DOC204", _A, _W, "free room", "Less than a tenth of /dev/shm is free; a bridge may fail to create an object.", "Remove what is not in use, or enlarge /dev/shm.")
_register("DOC205", _A, _N, "objects without a bridge", "A bridge that stopped leaves its objects so that the PLC keeps its last values; the next start reuses them.", "No action needed if the bridge will start again; otherwise remove them.")
_register("DOC206", _A, _W, "objects that are not in the configuration", "The objects have the prefix of the configuration, but none of its topics: another bridge uses this prefix, or a topic was removed.", "Remove the objects if no other configuration has this prefix.")
_register("DOC207", _A, _N, "temporaries", "A bridge was killed while it created an object. The next start removes these files.", "Start the bridge, or remove the files.")
_register("DOC208", _A, _N, "retired objects", "A bridge was killed between retiring an object and creating its successor. The next start replaces such objects.", "Start the bridge.")
_register("DOC209", _A, _W, "objects of another user", "No bridge uses these objects, and a bridge of this user could not reuse them (SHM119).", "Start the bridge as their owner, or remove the objects.")
_register("DOC210", _A, _W, "objects that are open to all users", "Every user of this machine may read or change the data that robot and PLC exchange.", "Restrict shm.mode, and give the objects to one group.")
_register("DOC211", _A, _E, "damaged objects", "Another program wrote into the objects, or uses their names; a PLC refuses them.", "Restart the bridge: it replaces its own objects.")
_register("DOC212", _A, _E, "plain files at the objects' names", "A link, a folder or a device has the name of an object; rosplc never follows it (SHM121).", "Remove the link, folder or device.")
_register("DOC213", _A, _W, "lock files", "A running bridge has an object whose lock file was removed, so a second bridge could start.", "Restart the bridge, and never remove PREFIX.l.* while it is running.")
_register("DOC214", _A, _W, "locks of classic topics", "A semaphore was locked at every check, so its holder has probably died. A bridge frees it after classic: recover_after.", "Start the bridge, or remove the semaphore while no program uses it.")
_register("DOC215", _A, _E, "word size of semaphores", "Programs of another word size created the semaphore (SHM133).", "Run both sides with the same word size, or carry the topic over the default channel.")
_register("DOC216", _A, _W, "semaphores that admit more than one process", "A program created the semaphore with a value above 1, or posted it twice; a bridge corrects it (SHM132).", "Start the bridge, and find the program that causes this.")
_register("DOC217", _A, _E, "sizes of classic memories", "A memory is smaller than the record, so the other side has a different struct (SHM129).", "Correct type, limits or name of the topic, or remove a memory that is not in use.")
_register("DOC218", _A, _W, "permission to create-or-open classic objects", "The kernel (fs.protected_regular) does not let any user, not even root, create-or-open another user's file in /dev/shm; programs of the original design do so and fail.", "Run the bridge as the runtime's user.")

_A = Area.PLC
_register("DOC301", _A, _N, "a CODESYS runtime", "No process named codesyscontrol is running here, or it runs in a container that is not visible from here.", "Start the runtime, or give its user with --plc-user.")
_register("DOC302", _A, _N, "word size of the runtime", "The PLC runtime has 32 bits and the kernel 64. Channels work; a semaphore of a classic topic cannot be shared with a 64-bit bridge.", "Use the default channel for topics that are now classic.")
_register("DOC303", _A, _E, "permissions of the PLC user", "The user of the PLC runtime may not open the objects for reading and writing, as its blocks do (SHM102).", "Give the objects to a group that this user is in.")
_register("DOC304", _A, _E, "the same /dev/shm as the PLC", "The runtime has another /dev/shm, as in a separate container: neither side finds the other's objects.", "Let the containers share /dev/shm.")
_register("DOC305", _A, _N, "the doctor's container", "A container has its own /dev/shm, processes and network unless it was started otherwise.", "Share these with the PLC's side, and make /dev/shm large enough.")

_A = Area.ROS
_register("DOC401", _A, _W, "ROS_DISTRO", "The shell's ROS distribution differs from the configuration's, whose message definitions apply.", "Set ros.distro to the installed distribution, or source setup.bash of the configured distribution.")
_register("DOC402", _A, _W, "the ROS domain", "The domain of the configuration differs from ROS_DOMAIN_ID: nodes started from this shell do not see the bridge.", "Set both to the same domain, or remove one of them.")
_register("DOC403", _A, _E, "values of ROS variables", "A variable has a value that is not valid in ROS; the bridge would refuse it (ROS010).", "Correct the named variable.")
_register("DOC404", _A, _W, "RMW_IMPLEMENTATION", "Nodes started from this shell use a different protocol than the backend of the configuration.", "Make ros.backend and RMW_IMPLEMENTATION agree.")
_register("DOC405", _A, _N, "range of discovery", "A variable limits which nodes are found.", "No action needed if this is intended.")
_register("DOC406", _A, _W, "host names", "A configured name has no address on this machine.", "Correct the name, or give it an address in /etc/hosts.")
_register("DOC407", _A, _W, "multicast", "No active interface supports multicast, by which ROS 2 over DDS finds other machines.", "Bring up a network interface, or list the other machines in ROS_STATIC_PEERS.")
_register("DOC408", _A, _W, "the ROS master", "No master answers at ROS_MASTER_URI. A bridge starts without a master and connects when one answers (ROS014).", "Start the master.")
_register("DOC409", _A, _W, "the Zenoh router", "No router answers at this address. A bridge starts without a router and connects when one answers (ROS016).", "Start a router there, or correct ros.zenoh.connect.")
_register("DOC410", _A, _W, "this machine's address in ROS 1", "Other nodes receive an address that this machine does not have, so they cannot connect.", "Set ROS_IP to an address of this machine, or unset it.")
_register("DOC411", _A, _W, "receive buffers of sockets", "The largest message of a topic does not fit into the buffer of a DDS subscriber. If it is best effort, most large messages are lost; if both sides are reliable, parts are sent again, which takes time (the finding is then a note).", "Raise net.core.rmem_default on the subscriber's machine, or use reliable on both sides.")

_A = Area.CONFIG
_register("DOC501", _A, _E, "the configuration", "The configuration cannot be used; `rosplc check` shows the same errors.", "Correct the named key.")
_register("DOC502", _A, _E, "owner and group of the objects", "The configured user or group does not exist on this machine. If this is a warning, this user may not give objects to them.", "Create the user or group, or start the bridge as a user who is in it.")

_A = Area.GRAPH
_register("DOC510", _A, _E, "connecting to the ROS graph", "The doctor could not connect to the graph; the bridge probably cannot either.", "See the message.")
_register("DOC511", _A, _W, "peers in ROS", "A topic towards the PLC has no publisher, or a topic from the PLC has no subscriber.", "Start the node, and compare topic name and domain.")
_register("DOC512", _A, _E, "types of topics", "Another node uses the topic with another type (ROS003); nothing is exchanged.", "Correct `type:` of the topic, or change the node.")
_register("DOC513", _A, _E, "definitions of types", "Another node has another definition of the type (ROS003); nothing is exchanged.", "Install the same message package on both sides, or correct ros.distro or types.paths.")
_register("DOC514", _A, _E, "quality of service", "Publisher and subscriber are incompatible (ROS004); nothing is exchanged.", "Set `qos:` of the topic as shown.")
_register("DOC515", _A, _W, "names of topics", "No node uses the topic, but the graph has one with a similar name.", "Correct the name in the configuration, or use ros.remap.")
_register("DOC516", _A, _W, "nodes in the graph", "No other node was seen.", "Start the robot's nodes; if they are running, compare domain, backend, container and firewall.")
_register("DOC517", _A, _W, "the bridge in the graph", "A bridge has the configuration's objects, but its node is not visible from here: it is in another domain, or uses another protocol.", "Start both with the same environment.")
_register("DOC518", _A, _N, "unknown definitions", "The other side does not announce its definition of the type (Humble, ROS 1), so only the name was compared.", "No action needed: the bridge's /diagnostics report mismatches.")
_register("DOC519", _A, _W, "servers in ROS", "The PLC calls a service or action that no node serves. A call waits in the PLC until its time-out.", "Start the node, and compare name, type and domain.")
_register("DOC520", _A, _W, "one server each", "A service or action has several servers (ROS022): each executes a request, and the first response counts.", "Stop all but one, or rename their services.")
_register("DOC521", _A, _E, "services over another DDS", "A peer uses a DDS other than Cyclone, with another protocol for services (ROS021): calls between it and the bridge do not work.", "Set ros.backend: rclpy.")

_A = Area.LIVE
_register("DOC601", _A, _N, "bridge of the configuration", "No bridge is running, or it carries only some of the topics. If this is an error, the bridge has no heartbeat. Without a configuration, every bridge of the machine is examined.", "Start the bridge.")
_register("DOC602", _A, _E, "layouts of the running bridge", "The layouts, directions or sizes of the objects differ from the configuration: the bridge is running with an older one.", "Restart the bridge with this configuration, and generate the PLC code again.")
_register("DOC603", _A, _W, "the PLC's task", "The bridge has the object, but no running PLC task uses it; for a service or action, no block calls or serves it.", "Start the PLC program; if it is running, its block shows an error number (112: its code was generated for another layout).")
_register("DOC604", _A, _E, "layouts that the running PLC expects", "The PLC's program was generated for another layout and refuses the topic (SHM112).", "Generate the PLC's code again, import it and download it.")
_register("DOC605", _A, _W, "refused and truncated messages", "Messages exceeded the limits of their topic.", "Raise the limits of the topic, and generate the PLC's code again.")

_A = Area.CODE
_register("DOC701", _A, _E, "generated code", "The folder contains no code from `rosplc generate`, or the code cannot be read.", "Name the folder that `rosplc generate` wrote.")
_register("DOC702", _A, _E, "the code's layouts and the configuration's", "The layouts differ: the PLC would refuse these objects (SHM112).", "Generate the code again, import it and download it.")
_register("DOC703", _A, _E, "the code's layouts and the running bridge's", "The layouts differ: the PLC would refuse these objects (SHM112).", "Restart the bridge with the configuration that the code was generated from, or generate the code again.")
_register("DOC704", _A, _E, "missing in the code", "The configuration has topics, services or actions without a block in the code, or with one for the other direction.", "Generate the code again, import it and download it.")
_register("DOC705", _A, _W, "only in the code", "The code has blocks for topics, services or actions that the configuration does not carry; they never connect (SHM101).", "Generate the code again, or add them to the configuration.")
_register("DOC706", _A, _E, "the code's prefix", "The code looks for objects with a different prefix than the configuration (SHM101).", "Generate the code again.")
_register("DOC707", _A, _W, "the code's fences", "The code was generated for x86, but this is an ARM machine, where its memory fence has no effect.", "Generate the code for ARM.")
_register("DOC708", _A, _N, "code of another release, or edited", "The layouts agree, but a file differs from what this release would generate.", "No action needed if it was edited on purpose; otherwise generate the code again.")
