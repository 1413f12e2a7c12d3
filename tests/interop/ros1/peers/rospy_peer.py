"""A plain rospy program: typed publishers and subscribers, driven by lines on standard input.

Runs in the system's own Python, without anything of rosplc. Commands: ``subscribe TOPIC TYPE QUEUE``,
``advertise TOPIC TYPE QUEUE LATCH``, ``write TOPIC HEX``, ``matched TOPIC``, ``unadvertise TOPIC``.
Each answers with a line; a message that arrives prints ``message TOPIC HEX``. Messages go through
rospy's generated classes, both ways. The end of the input ends the program.
"""

import io
import sys
import threading

import roslib.message
import rospy

_print_lock = threading.Lock()


def say(*words):
    with _print_lock:
        print(*words, flush=True)


def receive(message, topic):
    buffer = io.BytesIO()
    message.serialize(buffer)
    say("message", topic, buffer.getvalue().hex() or "-")


def main():
    rospy.init_node(sys.argv[1], argv=[sys.argv[0]], disable_signals=True)
    endpoints = {}
    say("ready")
    for line in sys.stdin:
        command, topic, *rest = line.split()
        if command == "subscribe":
            kind = roslib.message.get_message_class(rest[0])
            endpoints[topic] = rospy.Subscriber(
                topic, kind, receive, callback_args=topic, queue_size=int(rest[1]), tcp_nodelay=True
            )
        elif command == "advertise":
            kind = roslib.message.get_message_class(rest[0])
            endpoints[topic] = rospy.Publisher(topic, kind, queue_size=int(rest[1]), latch=rest[2] == "1")
        elif command == "write":
            message = endpoints[topic].data_class()
            message.deserialize(b"" if rest[0] == "-" else bytes.fromhex(rest[0]))
            endpoints[topic].publish(message)
        elif command == "unadvertise":
            endpoints.pop(topic).unregister()
        if command == "matched":
            say("matched", topic, endpoints[topic].get_num_connections())
        else:
            say("done", command, topic)
    rospy.signal_shutdown("end of input")


main()
