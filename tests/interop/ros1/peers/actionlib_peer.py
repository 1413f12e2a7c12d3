"""A program of Debian's actionlib: a client and a server of actionlib/TestAction.

Driven by lines on standard input, each answered with a line: ``client ACTION``, which waits for the server;
``goal ACTION KEY NUMBER``; ``cancel ACTION KEY``; ``server ACTION``. A client prints the states of its goal
(``message KEY HEX`` of ``PENDING``, ``ACTIVE``, ``feedback 50``, in the end ``SUCCEEDED 100``), a server its
goals and cancels.

What the server does with a goal is the goal's number: 1 succeeds with feedback, 2 is rejected, 3 runs until
it is canceled, 4 is aborted, 5 stays pending until it is canceled.
"""

import sys
import threading

import actionlib
import rospy
from actionlib.msg import TestAction, TestFeedback, TestGoal, TestResult
from actionlib_msgs.msg import GoalStatus

_print_lock = threading.Lock()


def say(*words):
    with _print_lock:
        print(*words, flush=True)


def tell(key, text):
    say("message", key, text.encode().hex())


class Client:
    def __init__(self, action):
        self._client = actionlib.ActionClient(action, TestAction)
        self._client.wait_for_server()
        self._goals = {}

    def send(self, key, number):
        def changed(handle):
            state = actionlib.CommState.to_string(handle.get_comm_state())
            if state == "DONE":
                result = handle.get_result()
                state = f"{TERMINAL[handle.get_terminal_state()]} {result.result if result else '-'}"
            tell(key, state)

        def feedback(_handle, feedback):
            tell(key, f"feedback {feedback.feedback}")

        self._goals[key] = self._client.send_goal(TestGoal(int(number)), changed, feedback)

    def cancel(self, key):
        self._goals[key].cancel()


TERMINAL = {
    getattr(GoalStatus, name): name
    for name in ("PREEMPTED", "SUCCEEDED", "ABORTED", "REJECTED", "RECALLED", "LOST")
}


def serve(action):
    def goal(handle):
        number = handle.get_goal().goal
        tell(action, f"goal {number}")
        if number == 2:
            handle.set_rejected(TestResult(2))
        elif number != 5:
            handle.set_accepted()
        if number == 1:
            handle.set_succeeded(TestResult(100))
        elif number == 3:  # it goes on: a result may overtake what another topic carries
            handle.publish_feedback(TestFeedback(50))
        elif number == 4:
            handle.set_aborted(TestResult(4))

    def cancel(handle):
        tell(action, f"cancel {handle.get_goal().goal}")
        handle.set_canceled(TestResult(3))

    server = actionlib.ActionServer(action, TestAction, goal, cancel, auto_start=False)
    server.start()
    return server


def main():
    rospy.init_node(sys.argv[1], argv=[sys.argv[0]], disable_signals=True)
    ends = {}
    say("ready")
    for line in sys.stdin:
        command, action, *rest = line.split()
        if command == "client":
            ends[action] = Client(action)
        elif command == "goal":
            ends[action].send(*rest)
        elif command == "cancel":
            ends[action].cancel(*rest)
        elif command == "server":
            ends[action] = serve(action)
        say("done", command, action)
    rospy.signal_shutdown("end of input")


main()
