"""The PLC's side of the cell: collect parts and ask for them to be picked.

rosplc run examples/cell/rosplc.yaml &
python examples/cell/plc.py --seconds 60
"""

from __future__ import annotations

import argparse

from rosplc.virtual_plc import ReadBlock, VirtualPlc, WriteBlock

SCREW = 1  # cell_msgs_Part_SCREW in the PLC


class PickParts:
    """PROGRAM PickParts: four parts make a list; screws make it urgent."""

    def __init__(self, prefix: str) -> None:
        # Every part counts, so each is taken in order, at most eight in one scan.
        self.part = ReadBlock("/camera/part", prefix=prefix, mode="every", stale_after=2.0)
        self.pick_list = WriteBlock("/pick_list", prefix=prefix)
        self.waiting: list[dict[str, object]] = []

    def __call__(self) -> None:
        """Run one scan."""
        for part in self.part.each():
            self.waiting.append({"kind": part.kind, "x": part.x, "y": part.y, "label": part.label})
        full = len(self.waiting) >= 4 and self.pick_list.msg is not None
        if full:
            chosen, self.waiting = self.waiting[:4], self.waiting[4:]
            self.pick_list.msg.header.frame_id = "table"
            self.pick_list.msg.parts = chosen
            self.pick_list.msg.urgent = any(part["kind"] == SCREW for part in chosen)
        self.pick_list.xEnable = full
        self.pick_list()


def main() -> None:
    """Run the program for the time that the command line gives."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--seconds", type=float, default=None, help="how long; without it until Ctrl-C")
    parser.add_argument("--prefix", default="cell")
    arguments = parser.parse_args()
    plc = VirtualPlc()
    task = plc.task("RosTask", interval=0.01, priority=4)
    program = PickParts(arguments.prefix)
    task.program(program)
    plc.run(arguments.seconds)
    print(f"{program.pick_list.udiPublished} lists, {task.stats.scans} scans, {task.stats.missed} missed")


if __name__ == "__main__":
    main()
