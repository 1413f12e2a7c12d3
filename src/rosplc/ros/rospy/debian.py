"""The parts of rospy that the backend stands on, found where Debian and ROS put them.

rospy is no wheel: it lies in the system's ``dist-packages``, which a virtual environment does not
see. Its folder is added to the *end* of the search path, and only while it is being imported: with
``PYTHONPATH`` the system's packages would shadow the environment's.

``rospy.init_node`` is not used. It parses ``sys.argv``, opens log files, waits without end for a
master, and a node that it has closed can never be opened again in the same process. Its parts have
none of these habits, so node and registration are put together from them here.
"""

from __future__ import annotations

import importlib
import logging
import sys
from pathlib import Path
from types import ModuleType

__all__ = [
    "AnyMsg",
    "QueuedConnection",
    "ROSHandler",
    "SilenceableXMLRPCRequestHandler",
    "TCPROSPub",
    "TCPROSTransport",
    "TCPServer",
    "ThreadingXMLRPCServer",
    "TransportError",
    "TransportProtocol",
    "decode_header",
    "encode_header",
    "find",
]

PLACES = ("/opt/ros/noetic/lib/python3/dist-packages", "/usr/lib/python3/dist-packages")
"""Where ROS's own packages for Ubuntu and Debian's put it, in the order of preference."""

_MODULES = (
    "rospy.msg",
    "rospy.exceptions",
    "rospy.impl.masterslave",
    "rospy.impl.tcpros_base",
    "rospy.impl.tcpros_pubsub",
    "rosgraph.network",
    "rosgraph.xmlrpc",
)


def find(places: tuple[str, ...] = PLACES) -> dict[str, ModuleType]:
    """Import what the backend uses of rospy; module name → module.

    Args:
        places: Folders to look into after the search path.

    Raises:
        ImportError: It is not installed, or this interpreter cannot load it; the text says which.
    """
    added = [place for place in places if place not in sys.path and Path(place).is_dir()]
    sys.path += added
    try:
        return {name: importlib.import_module(name) for name in _MODULES}
    except ModuleNotFoundError as error:
        if error.name == "rospy":
            looked = " and ".join(places)
            raise ModuleNotFoundError(
                f"rospy is neither in the search path nor in {looked}: sudo apt-get install python3-rospy",
                name="rospy",
            ) from error
        raise ImportError(_unusable(error), name="rospy") from error
    except Exception as error:  # old code in a new interpreter fails in many ways
        raise ImportError(_unusable(error), name="rospy") from error
    finally:
        for place in added:
            sys.path.remove(place)


def _unusable(error: Exception) -> str:
    version = ".".join(map(str, sys.version_info[:2]))
    return (
        f"rospy is installed, but Python {version} cannot load it ({error}); "
        "make the virtual environment with the system's own /usr/bin/python3"
    )


# Merely imported, it tells every log of its coming and going. A program that configures the logger
# itself, as rospy.init_node does, keeps its settings.
if logging.getLogger("rospy").level == logging.NOTSET:
    logging.getLogger("rospy").setLevel(logging.WARNING)
_found = find()
AnyMsg = _found["rospy.msg"].AnyMsg
ROSHandler = _found["rospy.impl.masterslave"].ROSHandler
TCPServer = _found["rospy.impl.tcpros_base"].TCPServer
TCPROSTransport = _found["rospy.impl.tcpros_base"].TCPROSTransport
TransportProtocol = _found["rospy.impl.tcpros_base"].TCPROSTransportProtocol
TCPROSPub = _found["rospy.impl.tcpros_pubsub"].TCPROSPub
QueuedConnection = _found["rospy.impl.tcpros_pubsub"].QueuedConnection
TransportError = _found["rospy.exceptions"].TransportException
SilenceableXMLRPCRequestHandler = _found["rosgraph.xmlrpc"].SilenceableXMLRPCRequestHandler
ThreadingXMLRPCServer = _found["rosgraph.xmlrpc"].ThreadingXMLRPCServer
decode_header = _found["rosgraph.network"].decode_ros_handshake_header
encode_header = _found["rosgraph.network"].encode_ros_handshake_header
