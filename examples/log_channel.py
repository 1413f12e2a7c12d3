"""Follow a channel and write each message as a line of CSV, whatever its type.

    python examples/log_channel.py /cmd_vel --count 100 > cmd_vel.csv

Nothing is needed but the channel: it describes itself, and nobody notices the reader.
"""

from __future__ import annotations

import argparse
import csv
import sys

import rosplc


def main() -> int:
    """Log the channel that the command line names."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("topic")
    parser.add_argument("--prefix", default="rosplc")
    parser.add_argument("--count", type=int, default=None, help="end after so many messages")
    parser.add_argument("--timeout", type=float, default=None, help="seconds to wait for the next message")
    arguments = parser.parse_args()
    out = csv.writer(sys.stdout)
    try:
        channel = rosplc.attach(arguments.topic, prefix=arguments.prefix)
    except rosplc.RosplcError as error:
        print(error, file=sys.stderr)
        return 1
    with channel:
        # Single values become columns; arrays and sequences stay out of a table.
        paths = [path for path, _, _ in channel.layout.fields() if "[]" not in path]
        out.writerow(["sequence", "stamp_ns", "lost", *paths])
        for number, message in enumerate(channel.every(timeout=arguments.timeout), start=1):
            info = channel.info
            assert info is not None
            out.writerow([info.sequence, info.stamp_ns, info.lost, *(value(message, path) for path in paths)])
            sys.stdout.flush()
            if number == arguments.count:
                break
    return 0


def value(message: object, path: str) -> object:
    """Return what is at a path such as ``pose.position.x``."""
    for name in path.split("."):
        message = getattr(message, name)
    return message


if __name__ == "__main__":
    raise SystemExit(main())
