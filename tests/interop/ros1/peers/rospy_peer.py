"""A plain rospy program: typed publishers and subscribers, driven by lines on standard input.

Runs in the system's own Python, without anything of rosplc. Commands: ``subscribe TOPIC TYPE QUEUE``,
``advertise TOPIC TYPE QUEUE LATCH``, ``write TOPIC HEX``, ``matched TOPIC``, ``unadvertise TOPIC``,
``serve SERVICE TYPE``, ``proxy SERVICE TYPE PERSISTENT`` and then ``call SERVICE HEX``, ``unserve SERVICE``.
Each answers with a line; a message that arrives prints ``message TOPIC HEX``, a request ``message
request:SERVICE HEX``, and a call's end ``message reply:SERVICE HEX`` or ``message error:SERVICE HEX``.
Messages go through rospy's generated classes, both ways. The end of the input ends the program.

A server of std_srvs/SetBool answers TRUE with success and "done", and fails with "not now" for FALSE; one
whose name ends in ``silent`` keeps every caller waiting.
"""

import functools
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


def answer(request, service):
    receive(request, "request:" + service)
    if service.endswith("silent"):
        threading.Event().wait()
    if not request.data:
        raise rospy.ServiceException("not now")
    return True, "done"


def call(proxy, payload, service):
    request = proxy.request_class()
    request.deserialize(payload)
    try:
        receive(proxy.call(request), "reply:" + service)
    except Exception as error:
        say("message", "error:" + service, str(error).encode().hex())


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
        elif command == "serve":
            kind = roslib.message.get_service_class(rest[0])
            handler = functools.partial(answer, service=topic)
            endpoints[topic] = rospy.Service(topic, kind, handler, error_handler=lambda *_: None)
        elif command == "unserve":
            endpoints.pop(topic).shutdown()
        elif command == "proxy":
            kind = roslib.message.get_service_class(rest[0])
            endpoints[topic] = rospy.ServiceProxy(topic, kind, persistent=rest[1] == "1")
        elif command == "call":
            payload = b"" if rest[0] == "-" else bytes.fromhex(rest[0])
            threading.Thread(target=call, args=(endpoints[topic], payload, topic), daemon=True).start()
        elif command == "unadvertise":
            endpoints.pop(topic).unregister()
        if command == "matched":
            say("matched", topic, endpoints[topic].get_num_connections())
        else:
            say("done", command, topic)
    rospy.signal_shutdown("end of input")


main()
