"""The PLC of the end-to-end tests: a process of its own that keeps every message it reads.

    python plc_program.py PREFIX OUT.pickle READ_TOPICS_JSON WRITE_TOPIC POSE_TOPIC

It reads each topic in order, answers each new pose with a command, and writes what it saw to
OUT.pickle when a line comes on standard input.
"""

from __future__ import annotations

import json
import pickle
import sys
import threading
from pathlib import Path

from rosplc.layout.view import plain
from rosplc.virtual_plc import ReadBlock, VirtualPlc, WriteBlock


def main() -> None:
    prefix, out, topics, write_topic, pose_topic = sys.argv[1:6]
    plc = VirtualPlc()
    task = plc.task("RosTask", interval=0.005)
    reads = {
        topic: ReadBlock(topic, prefix=prefix, mode="every", max_per_cycle=500, stale_after=None)
        for topic in json.loads(topics)
    }
    command = WriteBlock(write_topic, prefix=prefix)
    seen: dict[str, list[object]] = {topic: [] for topic in reads}
    sent: list[float] = []

    @task.program
    def scan() -> None:
        poses = 0
        for topic, block in reads.items():
            for message in block.each():
                seen[topic].append(plain(message))
                if topic == pose_topic and command.msg is not None:
                    poses += 1
        command.xEnable = False
        if poses and command.xReady:
            pose = seen[pose_topic][-1]
            command.msg.linear.x = float(pose["x"])
            command.msg.angular.z = -float(pose["theta"])
            command.xEnable = True
        command()
        if command.xPublished:
            sent.append((float(command.msg.linear.x), float(command.msg.angular.z)))

    with plc:
        announced = False
        stop = threading.Event()
        threading.Thread(target=lambda: (sys.stdin.readline(), stop.set()), daemon=True).start()
        while not stop.wait(0.02):
            plc.check()
            if not announced and command.xReady and all(block.xAttached for block in reads.values()):
                announced = True
                print("attached", flush=True)
    result = {
        "seen": seen,
        "sent": sent,
        "lost": {topic: block.udiLost for topic, block in reads.items()},
        "errors": {topic: block.udiError for topic, block in reads.items()},
    }
    Path(out).write_bytes(pickle.dumps(result))


if __name__ == "__main__":
    main()
