"""Everything that the doctor can find: one line per kind, from which the reference page is generated.

As with errors, a code never changes its meaning. If a bridge would report the same problem, the text of the
kind contains the code of that error.
"""

from __future__ import annotations

from rosplc.doctor.finding import Area, Finding, Kind, Level

KINDS: dict[str, Kind] = {}


def fine(code: str, seen: str) -> Finding:
    """Return the finding that a check passed."""
    return Finding(code, KINDS[code].area, Level.OK, seen)


def found(
    code: str, seen: str, remedy: str | None = None, command: str = "", level: Level | None = None
) -> Finding:
    """Return the finding that a check did not pass.

    ``seen`` is a sentence without a full stop, ``command`` the exact command that helps; ``remedy`` (a full
    sentence) and ``level`` replace the usual ones.
    """
    usual = KINDS[code]
    wanted, how = usual.level if level is None else level, usual.remedy if remedy is None else remedy
    return Finding(code, usual.area, wanted, seen, how, command)


def judged(
    code: str, seen: str, well: str, remedy: str | None = None, command: str = "", level: Level | None = None
) -> Finding:
    """Return the finding of :func:`found` or, if ``seen`` is empty, the finding that the check passed."""
    return found(code, seen, remedy, command, level) if seen else fine(code, well)


def _register(code: str, area: Area, level: Level, title: str, meaning: str, remedy: str) -> None:
    KINDS[code] = Kind(code, area, level, title, meaning, remedy)


_E, _W, _N = Level.ERROR, Level.WARNING, Level.NOTE

_A = Area.DOCTOR
_register("DOC001", _A, _W, "failed examination", "The examination could not be completed, so the result is unknown.", "See the message, and run the doctor again; if a permission is missing, run it as root.")
_register("DOC002", _A, _W, "examination that timed out", "The examination did not finish within its time limit, so the result is unknown. The resource being checked is probably not responding.", "Check the resource shown in the message. Common causes are unresponsive file systems and slow host name lookups.")
_register("DOC003", _A, _N, "resources that only another user may read", "This user has no permission to read the resource shown in the message.", "Run the doctor as root.")

_A = Area.MACHINE
_register("DOC101", _A, _W, "kernel and architecture", "rosplc is tested on x86-64 and, with cross-compilers and an emulator, on ARM. The shared-memory format requires a little-endian machine.", "Run rosplc on x86-64 or ARM.")
_register("DOC102", _A, _N, "word size of kernel and programs", "The kernel is 64-bit and this Python is 32-bit, as on many single-board computers. Channels work; the semaphore of a classic topic requires the same word size on both sides.", "No action needed unless a classic topic is used with a 64-bit PLC runtime.")
_register("DOC103", _A, _W, "the clock", "The clock shows a time earlier than this release: message time stamps are wrong, and will jump when the clock is set.", "Set the clock.")
_register("DOC104", _A, _E, "open files", "A bridge keeps several files and sockets open per topic; if the limit is too low, the bridge exits with SYS006.", "Raise the limit in the shell or the service that starts the bridge.")
_register("DOC105", _A, _N, "real-time permissions", "Without these permissions, a bridge can only run at normal priority, where a busy PLC can delay its messages.", "No action needed unless delays of a few milliseconds matter.")
_register("DOC106", _A, _W, "logout", "When the last session of an ordinary user ends, systemd removes everything that the user owns in /dev/shm, including objects of a running bridge.", "Run the bridge as a system user, or disable RemoveIPC in systemd.")
_register("DOC110", _A, _E, "installed packages", "A package that rosplc needs is missing.", "Reinstall rosplc with its dependencies.")
_register("DOC111", _A, _N, "backends without a package for this machine", "PyPI has no wheel of the backend's package for this architecture or Python version.", "Use another backend, or build the package from source.")
_register("DOC112", _A, _E, "backend that `auto` selects", "No installed backend can connect to the ROS graph; the bridge would not start (ROS001).", "Install one of the backends listed in the message.")
_register("DOC113", _A, _E, "backend of the configuration", "The package of the configured backend is not installed; the bridge would not start (ROS001).", "Install the package, or set another backend in ros.backend.")

_A = Area.MEMORY
_register("DOC201", _A, _E, "file system of /dev/shm", "Without /dev/shm there is no shared memory. On a disk, shared memory would be slow and would survive a reboot.", "Mount /dev/shm as tmpfs.")
_register("DOC202", _A, _E, "mode of /dev/shm", "The folder must be writable by all users and have the sticky bit set (mode 1777).", "Restore the mode.")
_register("DOC203", _A, _E, "space for the configuration's objects", "The configuration's objects do not fit into /dev/shm; the bridge would not start (SHM117).", "Enlarge /dev/shm, or lower the limits or depth of topics.")
_register("DOC204", _A, _W, "free space", "Less than a tenth of /dev/shm is free; a bridge may fail to create an object.", "Remove files that are not in use, or enlarge /dev/shm.")
_register("DOC205", _A, _N, "objects without a bridge", "A stopped bridge leaves its objects in place, so that the PLC keeps the last values. The bridge reuses the objects at its next start.", "No action needed if the bridge will start again; otherwise remove the objects.")
_register("DOC206", _A, _W, "objects that are not in the configuration", "The objects have the configuration's prefix, but belong to none of its topics: another bridge uses this prefix, or a topic was removed from the configuration.", "Remove the objects if no other configuration uses this prefix.")
_register("DOC207", _A, _N, "temporary files", "A bridge was killed while it was creating an object. The bridge removes these files at its next start.", "Start the bridge, or remove the files.")
_register("DOC208", _A, _N, "retired objects", "A bridge was killed after it retired an object and before it created the object's successor. The bridge replaces such objects at its next start.", "Start the bridge.")
_register("DOC209", _A, _W, "objects of another user", "No bridge uses these objects, and a bridge of this user could not reuse them (SHM119).", "Start the bridge as their owner, or remove the objects.")
_register("DOC210", _A, _W, "objects accessible to all users", "Every user on this machine can read or change the data that the robot and the PLC exchange.", "Restrict shm.mode, and give the objects to one group.")
_register("DOC211", _A, _E, "damaged objects", "Another program wrote into the objects, or uses their names; the PLC rejects such objects.", "Restart the bridge: it replaces its own objects.")
_register("DOC212", _A, _E, "file types of the objects", "A link, folder or device has the name of an object; rosplc accepts only plain files (SHM121).", "Remove the link, folder or device.")
_register("DOC213", _A, _W, "lock files", "A running bridge has an object whose lock file was removed, so a second bridge could start.", "Restart the bridge, and never remove PREFIX.l.* while it is running.")
_register("DOC214", _A, _W, "locks of classic topics", "A semaphore was locked at every check, so its holder has probably died. A bridge frees it after the time in `classic: recover_after`.", "Start the bridge, or remove the semaphore while no program uses it.")
_register("DOC215", _A, _E, "word size of semaphores", "A program with a different word size created the semaphore (SHM133).", "Run both sides with the same word size, or use the default channel for the topic.")
_register("DOC216", _A, _W, "semaphores that admit more than one process", "A program created the semaphore with a value above 1, or posted it twice; a bridge corrects the value (SHM132).", "Start the bridge, and find the program that causes this.")
_register("DOC217", _A, _E, "sizes of classic shared memory", "The shared memory is smaller than the record, so the other side has a different struct (SHM129).", "Correct the type, limits or name of the topic. If the shared memory is not in use, remove it.")
_register("DOC218", _A, _W, "permission to open classic objects with O_CREAT", "The kernel (fs.protected_regular) prevents all users, even root, from opening another user's file in /dev/shm with O_CREAT. Programs of the original design open objects this way, so they fail.", "Run the bridge as the user of the runtime.")

_A = Area.PLC
_register("DOC301", _A, _N, "CODESYS runtime", "No process named codesyscontrol is running on this machine, or its container is not visible from here.", "Start the runtime, or specify its user with --plc-user.")
_register("DOC302", _A, _N, "word size of the runtime", "The PLC runtime is 32-bit and the kernel is 64-bit. Channels work, but a semaphore of a classic topic cannot be shared with a 64-bit bridge.", "Use the default channel for topics that are now classic.")
_register("DOC303", _A, _E, "permissions of the PLC user", "The user of the PLC runtime has no permission to read and write the objects, which the PLC blocks require (SHM102).", "Set shm.group to a group that the PLC user belongs to.")
_register("DOC304", _A, _E, "the same /dev/shm as the PLC", "The runtime uses a different /dev/shm, for example in a separate container: neither side can see the other's objects.", "Let the containers share /dev/shm.")
_register("DOC305", _A, _N, "the doctor's container", "By default, a container has its own /dev/shm, processes and network.", "Start the container so that it shares these with the PLC runtime, and make /dev/shm large enough.")

_A = Area.ROS
_register("DOC401", _A, _W, "ROS_DISTRO", "The ROS distribution of the shell differs from ros.distro. The bridge uses the message definitions of ros.distro.", "Set ros.distro to the installed distribution, or source setup.bash of the configured distribution.")
_register("DOC402", _A, _W, "the ROS domain", "The domain of the configuration differs from ROS_DOMAIN_ID: nodes started from this shell do not discover the bridge.", "Set both to the same domain, or remove one of them.")
_register("DOC403", _A, _E, "values of ROS variables", "An environment variable has a value that is not valid in ROS; the bridge would reject it (ROS010).", "Correct the variable.")
_register("DOC404", _A, _W, "RMW_IMPLEMENTATION", "Nodes started from this shell use a different protocol than the backend of the configuration.", "Set ros.backend and RMW_IMPLEMENTATION to the same protocol.")
_register("DOC405", _A, _N, "discovery range", "An environment variable limits which nodes are discovered.", "No action needed if this is intended.")
_register("DOC406", _A, _W, "host names", "A configured host name cannot be resolved on this machine.", "Correct the name, or add it to /etc/hosts.")
_register("DOC407", _A, _W, "multicast", "No active network interface supports multicast, which ROS 2 over DDS uses to discover other machines.", "Bring up a network interface, or list the other machines in ROS_STATIC_PEERS.")
_register("DOC408", _A, _W, "the ROS master", "No master answers at ROS_MASTER_URI. A bridge starts without a master and connects when one answers (ROS014).", "Start the master.")
_register("DOC409", _A, _W, "the Zenoh router", "No router answers at this address. A bridge starts without a router and connects when one answers (ROS016).", "Start a router there, or correct ros.zenoh.connect.")
_register("DOC410", _A, _W, "this machine's address in ROS 1", "Other nodes receive an address that this machine does not have, so they cannot connect.", "Set ROS_IP to an address of this machine, or unset it.")
_register("DOC411", _A, _W, "receive buffers of sockets", "The largest message of a topic does not fit into the receive buffer of a DDS subscriber. With best effort, most large messages are lost. If both sides are reliable, lost parts are resent, which takes time, and the finding is a note.", "Raise net.core.rmem_default on the subscriber's machine, or set reliability to reliable on both sides.")

_A = Area.CONFIG
_register("DOC501", _A, _E, "the configuration", "The configuration cannot be used; `rosplc check` shows the same errors.", "Correct the reported key.")
_register("DOC502", _A, _E, "owner and group of the objects", "The configured user or group does not exist on this machine. If the level is warning, it exists, but this user may not assign objects to it.", "Create the user or group, or start the bridge as that user or a member of that group.")

_A = Area.GRAPH
_register("DOC510", _A, _E, "connecting to the ROS graph", "The doctor could not connect to the graph; the bridge probably cannot either.", "See the message.")
_register("DOC511", _A, _W, "publishers and subscribers", "A topic that the PLC reads has no publisher, or a topic that the PLC writes has no subscriber.", "Start the node, and check the topic name and the domain.")
_register("DOC512", _A, _E, "types of topics", "Another node uses the topic with a different type (ROS003); no messages are exchanged.", "Correct the topic's `type:`, or change the node.")
_register("DOC513", _A, _E, "definitions of types", "Another node has a different definition of the type (ROS003); no messages are exchanged.", "Install the same message package on both sides, or correct ros.distro or types.paths.")
_register("DOC514", _A, _E, "quality of service", "The QoS of publisher and subscriber is incompatible (ROS004); no messages are exchanged.", "Set the topic's `qos:` as shown.")
_register("DOC515", _A, _W, "names of topics", "No node uses the topic, but the graph contains a topic with a similar name.", "Correct the name in the configuration, or use ros.remap.")
_register("DOC516", _A, _W, "nodes in the graph", "No other node was seen.", "Start the robot's nodes; if they are running, check the domain, backend, container and firewall.")
_register("DOC517", _A, _W, "the bridge in the graph", "A bridge is running with this configuration, but its node is not visible from here: it is in another domain or uses another protocol.", "Start the bridge and the doctor with the same environment.")
_register("DOC518", _A, _N, "unknown definitions", "The other side does not announce its definition of the type (Humble, ROS 1), so only the type names were compared.", "No action needed: the bridge reports mismatches in /diagnostics.")
_register("DOC519", _A, _W, "servers in the ROS graph", "The PLC calls a service or action that no node serves. Calls from the PLC wait until they time out.", "Start the node, and check the name, type and domain.")
_register("DOC520", _A, _W, "number of servers", "A service or action has several servers (ROS022): each server executes every request, and the first response counts.", "Stop all servers but one, or rename the services of the other servers.")
_register("DOC521", _A, _E, "services over another DDS", "A peer uses a DDS implementation other than Cyclone DDS, with a different protocol for services (ROS021): calls between it and the bridge do not work.", "Set ros.backend: rclpy.")

_A = Area.LIVE
_register("DOC601", _A, _N, "bridge of the configuration", "No bridge is running, or the running bridge carries only some of the topics. If the level is error, the bridge has no heartbeat. Without a configuration, every bridge on the machine is examined.", "Start the bridge.")
_register("DOC602", _A, _E, "layouts of the running bridge", "The layouts, directions or sizes of the objects differ from the configuration: the bridge is running with an older configuration.", "Restart the bridge with this configuration, and generate the PLC code again.")
_register("DOC603", _A, _W, "the PLC's task", "The bridge carries the topic, but no running PLC task uses it; for a service or action, no block calls or serves it.", "Start the PLC program. If it is running, see its block's error number (112: the code was generated for another layout).")
_register("DOC604", _A, _E, "layouts that the running PLC expects", "The PLC code was generated for another layout, so its block does not attach (SHM112).", "Generate the PLC code again, import it and download it.")
_register("DOC605", _A, _W, "refused and truncated messages", "Messages exceeded the limits of their topic.", "Raise the limits of the topic, and generate the PLC code again.")

_A = Area.CODE
_register("DOC701", _A, _E, "generated code", "The folder contains no code from `rosplc generate`, or the code cannot be read.", "Specify the output folder of `rosplc generate`.")
_register("DOC702", _A, _E, "layouts of code and configuration", "The layouts differ: the PLC would reject these objects (SHM112).", "Generate the code again, import it and download it.")
_register("DOC703", _A, _E, "layouts of code and running bridge", "The layouts differ: the PLC would reject these objects (SHM112).", "Restart the bridge with the configuration that the code was generated from, or generate the code again.")
_register("DOC704", _A, _E, "completeness of the code", "The configuration has topics, services or actions without a block in the code, or with a block for the other direction.", "Generate the code again, import it and download it.")
_register("DOC705", _A, _W, "blocks that are only in the code", "The code has blocks for topics, services or actions that are not in the configuration; these blocks never connect (SHM101).", "Generate the code again, or add the entries to the configuration.")
_register("DOC706", _A, _E, "the code's prefix", "The prefix in the code differs from the prefix in the configuration, so the blocks do not find the objects (SHM101).", "Generate the code again.")
_register("DOC707", _A, _W, "the code's memory fences", "The code was generated for x86, but this is an ARM machine, where the code's memory fence has no effect.", "Generate the code for ARM.")
_register("DOC708", _A, _N, "contents of the generated files", "The layouts agree, but a file differs from what this release would generate.", "No action needed if the file was edited on purpose; otherwise generate the code again.")
