"""Plain cyclonedds 11.0.1: topics of many nested types, opened and closed, end the process within seconds.

Usage: python cyclonedds_types.py SEED SECONDS [keep]; with "keep" one topic per type stays open.
"""

import faulthandler
import random
import sys
import time

from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import make_idl_struct, types
from cyclonedds.pub import DataWriter
from cyclonedds.topic import Topic

faulthandler.enable()
seed, seconds, keep = int(sys.argv[1]), float(sys.argv[2]), "keep" in sys.argv[3:]
choose = random.Random(seed).choice


def struct(name: str, fields: dict) -> type:
    made = make_idl_struct(name, f"pkg.msg.{name}", fields)
    made.__idl_annotations__["extensibility"] = "final"
    return made


COUNT = 40
leaves = [struct(f"L{i}_", {f"x{j}": types.float64 for j in range(1 + i % 5)}) for i in range(COUNT)]
middle = [struct(f"M{i}_", {f"m{j}": choose(leaves) for j in range(4)}) for i in range(COUNT)]
top = [struct(f"T{i}_", {f"t{j}": types.sequence[choose(middle)] for j in range(3)}) for i in range(COUNT)]
everything = leaves + middle + top

participant = DomainParticipant(seed % 100)
kept = [Topic(participant, f"kept{i}", kind) for i, kind in enumerate(everything)] if keep else []
end, opened = time.monotonic() + seconds, 0
while time.monotonic() < end:
    opened += 1
    topic = Topic(participant, f"topic{opened}", choose(everything))
    writer = DataWriter(participant, topic)
    del writer, topic
print(f"opened and closed {opened} topics")
