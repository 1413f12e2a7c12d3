"""Everything that the doctor can find: one line per kind, from which the reference page is made.

A code never changes its meaning, as with errors. Where a kind is about what a bridge would report
too, its text names that error.
"""

from __future__ import annotations

from rosplc.doctor.finding import Area, Kind, Level

__all__ = ["KINDS", "kind"]

KINDS: dict[str, Kind] = {}


def kind(code: str) -> Kind:
    """Return what a code stands for; KeyError if there is no such kind."""
    return KINDS[code]


def _register(code: str, area: Area, level: Level, title: str, meaning: str, remedy: str) -> None:
    if code in KINDS:  # pragma: no cover - a programming error, found at import
        raise ValueError(f"{code} is registered twice")
    KINDS[code] = Kind(code, area, level, title, meaning, remedy)


_E, _W, _N = Level.ERROR, Level.WARNING, Level.NOTE

_A = Area.DOCTOR
_register("DOC001", _A, _W, "an examination that failed", "It could not be done, so nothing is known about what it looks at.", "See what it says; run the doctor again, as root if a right is missing.")
_register("DOC002", _A, _W, "an examination that did not end", "It was given up after its time, so nothing is known about what it looks at. What it looks at probably hangs itself.", "Look at what it names: a file system or a network name that does not answer is the usual cause.")
_register("DOC003", _A, _N, "something that only another user may see", "The rights of this user do not suffice to look at it.", "Run the doctor as root.")

_A = Area.MACHINE
_register("DOC101", _A, _W, "kernel and architecture", "rosplc is tested on x86-64, and with cross-compilers and an emulator on ARM; the format needs a little-endian machine.", "Run it on x86-64 or ARM.")
_register("DOC102", _A, _N, "word size of kernel and programs", "The kernel has 64 bits and this Python 32, as on many single-board computers. Channels do not mind; a classic topic's semaphore needs both sides to have the same word size.", "Nothing, unless a classic topic is used with a 64-bit PLC runtime.")
_register("DOC103", _A, _W, "the clock", "The clock is earlier than this release, so stamps of messages will be wrong, and jump when it is set.", "Set the clock.")
_register("DOC104", _A, _E, "open files", "A bridge holds files and sockets open, several per topic; without enough of them it ends with SYS006.", "Raise the limit in the shell or the service that starts the bridge.")
_register("DOC105", _A, _N, "rights for real time", "Without them a bridge runs with ordinary priority; beside a busy PLC its messages may come later.", "Nothing, unless a few milliseconds matter.")
_register("DOC106", _A, _W, "what happens at log-out", "systemd removes what an ordinary user owns in /dev/shm when the last session ends: objects of a running bridge, too.", "Run the bridge as a system user, or tell systemd not to.")
_register("DOC110", _A, _E, "installed packages", "A package that rosplc needs is missing.", "Install rosplc again, with its packages.")
_register("DOC111", _A, _N, "ways into ROS that this machine has no package for", "PyPI has no wheel for this architecture or this Python.", "Use another backend, or build the package.")
_register("DOC112", _A, _E, "which way into ROS `auto` takes", "No backend is installed that would reach the graph; the bridge would not start (ROS001).", "Install one of those named.")
_register("DOC113", _A, _E, "the backend that the configuration names", "Its package is not installed; the bridge would not start (ROS001).", "Install it, or choose another in ros.backend.")

_A = Area.MEMORY
_register("DOC201", _A, _E, "/dev/shm is a memory file system", "Without it there is no shared memory; on a disk it would be slow, and survive a restart of the machine.", "Mount it.")
_register("DOC202", _A, _E, "mode of /dev/shm", "It has to be open to everybody, with the sticky bit: 1777.", "Give it its mode back.")
_register("DOC203", _A, _E, "room for the configuration's objects", "The objects do not fit; the bridge would not start (SHM117).", "Enlarge it, or lower limits and depth.")
_register("DOC204", _A, _W, "free room", "Less than a tenth of /dev/shm is free; a bridge that has to make an object anew may not be able to.", "Remove what nobody needs, or enlarge it.")
_register("DOC205", _A, _N, "objects that no bridge holds", "A bridge that stopped leaves its objects, so that the PLC keeps its last values; the next start goes on with them.", "Nothing, if the bridge will start again; otherwise remove them.")
_register("DOC206", _A, _W, "objects that the configuration does not have", "They have the configuration's prefix, but no topic of it: another bridge uses this prefix, or a topic was removed.", "Remove them, if no other configuration has this prefix.")
_register("DOC207", _A, _N, "temporaries", "A bridge was killed while it made an object. The next start removes them.", "Start the bridge, or remove them.")
_register("DOC208", _A, _N, "retired objects", "A bridge was killed between retiring an object and making its successor. The next start replaces them.", "Start the bridge.")
_register("DOC209", _A, _W, "objects of another user", "Nobody holds them, and a bridge of the user who asked the doctor could not take them over (SHM119).", "Start the bridge as their owner, or remove them.")
_register("DOC210", _A, _W, "objects that are open to everybody", "Every user of this machine may read or change what the robot and the PLC tell each other.", "Restrict shm.mode, and give the objects to one group.")
_register("DOC211", _A, _E, "damaged objects", "Another program wrote into them, or uses the name; a PLC refuses them.", "Restart the bridge: it replaces objects that are its own.")
_register("DOC212", _A, _E, "plain files at the objects' names", "A link, a folder or a device stands at an object's name; rosplc never follows it (SHM121).", "Remove it.")
_register("DOC213", _A, _W, "lock files", "A bridge beats in an object whose lock it does not hold: somebody removed the lock file, so a second bridge could start.", "Restart the bridge, and never remove PREFIX.l.* while it runs.")
_register("DOC214", _A, _W, "locks of classic topics", "A semaphore was taken at every look, so its holder has probably died inside. A bridge frees it after classic: recover_after.", "Start the bridge, or remove the semaphore while nobody runs.")
_register("DOC215", _A, _E, "word size of semaphores", "Programs of another word size made the semaphore (SHM133).", "Run both sides with the same word size, or carry the topic over the default channel.")
_register("DOC216", _A, _W, "semaphores that let in more than one", "Somebody made it with more than 1, or left it twice; a bridge corrects it (SHM132).", "Start the bridge, and look which program does it.")
_register("DOC217", _A, _E, "sizes of classic memories", "A memory is smaller than the record, so the other side has another struct (SHM129).", "Correct type, limits or name of the topic, or remove a memory that nobody uses.")
_register("DOC218", _A, _W, "who may create-or-open classic objects", "The kernel (fs.protected_regular) lets nobody, not even root, create-or-open another user's file in /dev/shm; programs of the original design do so, and fail.", "Run the bridge as the runtime's user.")

_A = Area.PLC
_register("DOC301", _A, _N, "a CODESYS runtime", "No process named codesyscontrol runs here, or it runs in a container that this one cannot look into.", "Start the runtime, or name its user with --plc-user.")
_register("DOC302", _A, _N, "word size of the runtime", "The PLC runtime has 32 bits and the kernel 64. Channels do not mind; a semaphore of a classic topic cannot be shared with a 64-bit bridge.", "Use the default channel for topics that are classic now.")
_register("DOC303", _A, _E, "rights of the PLC's user", "The user of the PLC runtime may not open the objects for reading and writing, as its blocks do (SHM102).", "Give the objects to a group that this user is in.")
_register("DOC304", _A, _E, "the same /dev/shm as the PLC", "The runtime sees another /dev/shm, as in a container of its own: neither side finds the other's objects.", "Let the containers share it.")
_register("DOC305", _A, _N, "the container that the doctor runs in", "A container has a /dev/shm, processes and a network of its own, unless it was started otherwise.", "Share them with the PLC's side, and give it the room that is needed.")

_A = Area.ROS
_register("DOC401", _A, _W, "ROS_DISTRO", "The shell's ROS distribution is another than the configuration's, whose message definitions hold.", "Set ros.distro to the installed distribution, or source the other's setup.bash.")
_register("DOC402", _A, _W, "the ROS domain", "The configuration names another domain than ROS_DOMAIN_ID: nodes that are started from this shell do not see the bridge.", "Make the two agree, or remove one of them.")
_register("DOC403", _A, _E, "values of ROS's variables", "A variable has a value that ROS does not know; the bridge would refuse it (ROS010).", "Correct the named variable.")
_register("DOC404", _A, _W, "RMW_IMPLEMENTATION", "Nodes that are started from this shell speak another protocol than the configuration's backend.", "Make ros.backend and RMW_IMPLEMENTATION agree.")
_register("DOC405", _A, _N, "how far discovery reaches", "A variable limits which nodes are found.", "Nothing, if it is meant.")
_register("DOC406", _A, _W, "host names", "A name that ROS was given has no address on this machine.", "Correct the name, or give it an address in /etc/hosts.")
_register("DOC407", _A, _W, "multicast", "No interface that is up takes multicast, by which ROS 2 over DDS finds other machines.", "Bring a network interface up, or name the others in ROS_STATIC_PEERS.")
_register("DOC408", _A, _W, "the ROS master", "Nobody answers at ROS_MASTER_URI. A bridge starts without it, and connects as soon as it answers (ROS014).", "Start the master.")
_register("DOC409", _A, _W, "the Zenoh router", "Nobody answers there. A bridge starts without it, and connects as soon as it answers (ROS016).", "Start a router there, or correct ros.zenoh.connect.")
_register("DOC410", _A, _W, "this machine's address in ROS 1", "Other nodes are told an address that this machine does not have, so they connect to nobody.", "Set ROS_IP to an address of this machine, or unset it.")

_A = Area.CONFIG
_register("DOC501", _A, _E, "the configuration", "It cannot be used; `rosplc check` shows the same.", "Correct the named key.")
_register("DOC502", _A, _E, "owner and group of the objects", "The configuration gives the objects to somebody that this machine does not know; or, as a warning, whom the user who asked the doctor may not give them to.", "Create the user or group, or start the bridge as a user who is in it.")

_A = Area.GRAPH
_register("DOC510", _A, _E, "joining the ROS graph", "The doctor could not join it, and the bridge would fare alike.", "See what it says.")
_register("DOC511", _A, _W, "somebody at the other end", "Nobody publishes a topic that goes to the PLC, or nobody subscribes to one that comes from it.", "Start the node, and compare topic name and domain.")
_register("DOC512", _A, _E, "types of topics", "Another node uses the topic with another type (ROS003); nothing is exchanged.", "Correct `type:` of the topic, or the node.")
_register("DOC513", _A, _E, "definitions of types", "Another node has another definition of the type (ROS003); nothing is exchanged.", "Install the same message package on both sides, or correct ros.distro or types.paths.")
_register("DOC514", _A, _E, "quality of service", "Publisher and subscriber exclude each other (ROS004); nothing is exchanged.", "Set `qos:` of the topic as named.")
_register("DOC515", _A, _W, "names of topics", "Nobody uses the topic, but the graph has one of a similar name.", "Correct the name in the configuration, or use ros.remap.")
_register("DOC516", _A, _W, "anybody in the graph", "No other node was seen.", "Start the robot's nodes; if they run, compare domain, backend, container and firewall.")
_register("DOC517", _A, _W, "the bridge in the graph", "A bridge holds the configuration's objects, but its node is not seen from here: it is in another domain, or speaks another protocol.", "Start both with the same environment.")
_register("DOC518", _A, _N, "definitions that nobody announces", "The other side does not say which definition of the type it has (Humble, ROS 1), so only the name was compared.", "Nothing; the bridge's /diagnostics say what comes of it.")

_A = Area.LIVE
_register("DOC601", _A, _N, "a bridge that holds the configuration's topics", "No bridge runs, or it carries only a part of the topics; or, as an error, it holds them and does not beat. Without a configuration, every bridge of the machine is looked at, whatever its prefix.", "Start the bridge.")
_register("DOC602", _A, _E, "layouts of the running bridge", "The objects have other layouts, directions or sizes than the configuration gives: the bridge runs on an older one.", "Restart the bridge with this configuration, and generate the PLC's code again.")
_register("DOC603", _A, _W, "the PLC's task", "The bridge holds the object, and no task of a PLC beats in it.", "Start the PLC's program; if it runs, its block shows an error number (112: its code was generated for another layout).")
_register("DOC604", _A, _E, "layouts that the running PLC expects", "The PLC's program was generated for another layout and refuses the topic (SHM112).", "Generate the PLC's code again, import it and download it.")
_register("DOC605", _A, _W, "refused and shortened messages", "Messages were larger than the limits of their topic.", "Raise the limits of the topic, and generate the PLC's code again.")

_A = Area.CODE
_register("DOC701", _A, _E, "a folder of generated code", "There is no code of `rosplc generate` in it, or it cannot be read.", "Name the folder that `rosplc generate` wrote.")
_register("DOC702", _A, _E, "the code's layouts and the configuration's", "They differ: the PLC would refuse these topics (SHM112).", "Generate the code again, import it and download it.")
_register("DOC703", _A, _E, "the code's layouts and the running bridge's", "They differ: the PLC would refuse these topics (SHM112).", "Restart the bridge with the configuration that the code was generated from, or generate the code again.")
_register("DOC704", _A, _E, "topics that the code does not have", "The configuration has topics without a block in the code, or with one for the other direction.", "Generate the code again, import it and download it.")
_register("DOC705", _A, _W, "topics that only the code has", "The code has blocks for topics that the configuration does not carry; they wait for ever (SHM101).", "Generate the code again, or add the topics.")
_register("DOC706", _A, _E, "the code's prefix", "The code looks for objects of another prefix than the configuration's (SHM101).", "Generate the code again.")
_register("DOC707", _A, _W, "the code's fences", "The code was generated for x86, and this is an ARM machine, where its fence orders nothing.", "Generate it for ARM.")
_register("DOC708", _A, _N, "code of another release, or edited", "The layouts agree, but a file is not what this release would generate.", "Nothing, if it was edited on purpose; otherwise generate the code again.")
