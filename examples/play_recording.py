"""Play a recording onto ROS 2 topics, as a program of its own that knows nothing of the bridge.

    python examples/play_recording.py FILE.bag --speed 2 --topic /turtle1/pose --wait 10

ROS 1 recordings are translated into ROS 2 types; what is mapped or dropped is printed.
"""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import replace
from pathlib import Path

from rosplc.errors import RosplcError
from rosplc.recorder.replay import Player, ReplayOptions, RosTarget, wait_for_readers
from rosplc.recorder.source import open_source
from rosplc.ros.backend import Qos


def stopped(seconds: float) -> bool:
    """Wait; nothing but Ctrl-C ends this program early."""
    time.sleep(seconds)
    return False


def main() -> int:
    """Play the recording that the command line names."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("file", type=Path, help="the recording: a .bag, or the folder of a ROS 2 recording")
    parser.add_argument("--distro", default="jazzy", help="whose message definitions hold on the wire")
    parser.add_argument("--speed", type=float, default=1.0, help="1 is as recorded, 0 as fast as possible")
    parser.add_argument("--topic", action="append", default=[], help="only this topic (may be repeated)")
    parser.add_argument(
        "--wait", type=float, default=30.0, help="seconds to wait for a subscriber of each topic"
    )
    parser.add_argument("--linger", type=float, default=2.0, help="seconds to stay after the last message")
    arguments = parser.parse_args()

    source = open_source(arguments.file, arguments.distro)
    qos = Qos(reliability="reliable", durability="transient_local", depth=1000)
    topics = {
        name: replace(topic, qos=qos)
        for name, topic in source.topics.items()
        if not arguments.topic or name in arguments.topic
    }
    target = RosTarget(topics, backend="dds", distro=arguments.distro)
    print("\n".join(target.notes))
    if missing := wait_for_readers(target, arguments.wait, stopped):
        print(f"nobody subscribes to {', '.join(missing)}", file=sys.stderr)
        return 1
    Player(source, target, topics, ReplayOptions(speed=arguments.speed, stamps="original")).play(stopped)
    time.sleep(arguments.linger)
    target.close()
    source.close()
    print(f"played {sum(one.sent for one in target.counts.values())} messages on {len(topics)} topics")
    return 0


if __name__ == "__main__":
    try:
        sys.exit(main())
    except RosplcError as error:
        sys.exit(str(error))
