"""What is kept of a round in which something did not hold: enough to look into it later, and to repeat it."""

from __future__ import annotations

import json
import shutil
from contextlib import suppress
from dataclasses import asdict, is_dataclass
from pathlib import Path
from typing import Any

from tests.soak.cell import SHM, Cell
from tests.soak.pattern import ALL, TOPICS

__all__ = ["keep"]

_TAIL = 1 << 20
_STATUS = ("State", "Threads", "VmSize", "RssAnon")


def keep(cell: Cell, number: int, round_: Any, seed: int, where: Path) -> None:
    """Write the bundle of a round.

    Args:
        cell: The cell, as it stands after the round.
        number: The round's.
        round_: The round, a dataclass.
        seed: The campaign's.
        where: The folder; made if it is missing.
    """
    where.mkdir(parents=True, exist_ok=True)
    for part in cell.parts.values():
        (where / part.log.name).write_text(part.told()[-_TAIL:])
    for path in (cell.config, cell.folder / "ledger"):
        with suppress(OSError):
            shutil.copy(path, where / path.name)
    memory = where / "shm"
    memory.mkdir(exist_ok=True)
    for path in SHM.glob(f"*{cell.prefix}*"):
        with suppress(OSError):
            shutil.copy(path, memory / path.name)
    plc = f" --plc {cell.plc}" if cell.plc != "python" else ""
    assert is_dataclass(round_) and not isinstance(round_, type)
    known = {
        "round": asdict(round_),
        "repeat": f"python -m tests.soak --backend {cell.backend}{plc} --seed {seed} "
        f"--from-round {number} --rounds 1",
        "topics": {ALL[index]: _numbers(cell, index) for index in range(len(ALL))},
        "shared memory": sorted(path.name for path in SHM.glob(f"*{cell.prefix}*")),
        "expected": sorted(cell.expected_objects()),
        "processes": {name: _process(part.pid) for name, part in cell.parts.items()},
    }
    (where / "round.json").write_text(json.dumps(known, indent=1) + "\n")


def _numbers(cell: Cell, index: int) -> dict[str, int]:
    counters = cell.ledger.counters[index]
    found = {name: int(counters[name]) for name in counters.dtype.names}
    if ALL[index] in TOPICS:
        bridge = cell.ledger.bridge[index]
        found |= {f"bridge {name}": int(bridge[name]) for name in bridge.dtype.names}
    return found


def _process(pid: int) -> dict[str, str]:
    try:
        lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    except OSError:
        return {"State": "ended"}
    fields = (line.partition(":") for line in lines)
    return {name: value.strip() for name, _, value in fields if name in _STATUS}
