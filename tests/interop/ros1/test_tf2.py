"""The buffer of transforms beside Debian's tf2::BufferCore: the same transforms, the same answers."""

from __future__ import annotations

import json
import math
import random
import subprocess
from pathlib import Path
from typing import Any

import pytest

from rosplc.bridge.transforms import Buffer, Pose
from rosplc.config.transforms import TransformError

pytestmark = [
    pytest.mark.needs("python3-tf2", "python3-geometry-msgs"),
    pytest.mark.verifies("tf", real="Debian's tf2"),
]
PEER = Path(__file__).parent / "peers" / "tf2_buffer.py"
TREES, AT_ONCE = 10_000, 1_000
S = 1_000_000_000
ERRORS = {
    TransformError.UNKNOWN_FRAME: "LookupException",
    TransformError.LOOP: "LookupException",
    TransformError.NOT_CONNECTED: "ConnectivityException",
    TransformError.NO_COMMON_TIME: "ExtrapolationException",
}
Transform = tuple[bool, str, str, int, Pose]


def some_pose(rng: random.Random) -> Pose:
    """Return a pose; sometimes with a rotation that is none, nearly none, or half a turn."""
    axis = [rng.gauss(0, 1) for _ in range(3)]
    angle = rng.choice((rng.uniform(-math.pi, math.pi), 0.0, 1e-9, math.pi))
    scale = math.sin(angle / 2) / math.hypot(*axis)
    position = (rng.uniform(-9, 9) for _ in range(3))
    return (*position, *(scale * each for each in axis), math.cos(angle / 2))  # type: ignore[return-value]


def some_tree(rng: random.Random) -> tuple[list[Transform], list[tuple[str, str]]]:
    """Return transforms in the order of their arrival, and pairs of frames to look up."""
    number, transforms = rng.randint(2, 12), []
    gaps = rng.random() < 0.2  # parts that are not connected, and frames that change their parents
    for child in range(1, number):
        if gaps and rng.random() < 0.2:
            continue
        static = rng.random() < 0.3
        start, period = rng.randint(1, 3 * S), rng.randint(S // 500, 4 * S)
        stamps = [start + index * period for index in range(rng.randint(1, 8))]
        parent = rng.randrange(child)
        for stamp in stamps:
            if gaps and rng.random() < 0.1:
                parent = rng.randrange(child)
            transforms.append((static, f"f{child}", f"f{parent}", stamp, some_pose(rng)))
    rng.shuffle(transforms)
    transforms += rng.sample(transforms, len(transforms) // 8)
    pairs = [tuple(rng.sample(range(number + 1), 2)) for _ in range(8)]
    return transforms, [(f"f{target}", f"f{source}") for target, source in pairs]


def agree(own: Buffer, target: str, source: str, theirs: Any) -> bool:
    """Compare one lookup; return whether there is a pose."""
    found = own.lookup(target, source)
    if found.error:
        assert ERRORS[found.error] == theirs
        return False
    stamp, pose = theirs
    assert found.stamp_ns == stamp
    assert found.pose == pytest.approx(pose, abs=1e-9, rel=1e-9)
    return True


@pytest.mark.parametrize("part", range(TREES // AT_ONCE))
def test_random_trees(part: int) -> None:
    """Stamps, poses and kinds of errors are those of tf2, for random trees, times, rates and orders."""
    rng = random.Random(part)
    trees = [some_tree(rng) for _ in range(AT_ONCE)]
    lines = "".join(json.dumps(tree) + "\n" for tree in trees)
    command = ["/usr/bin/python3", str(PEER)]
    answers = subprocess.run(command, input=lines, capture_output=True, text=True, check=True).stdout
    poses, errors = 0, 0
    for (transforms, pairs), line in zip(trees, answers.splitlines(), strict=True):
        own = Buffer()
        for static, child, parent, stamp, pose in transforms:
            own.put(child, parent, stamp, pose, static=static)
        for (target, source), theirs in zip(pairs, json.loads(line), strict=True):
            there = agree(own, target, source, theirs)
            poses, errors = poses + there, errors + (not there)
    assert min(poses, errors) > AT_ONCE
