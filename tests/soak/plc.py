"""The PLC's process: reads two topics and writes two, in every scan."""

from __future__ import annotations

import contextlib
import signal
import sys
from pathlib import Path
from typing import Any

from rosplc.virtual_plc import ReadBlock, VirtualPlc, WriteBlock
from tests.soak.messages import IN, OUT, Counters, fill

_SCAN_S = 0.01
_BEAT_MS = 100


class Program:
    """One PLC program over both directions."""

    def __init__(self, counters: Counters, generation: int, prefix: str) -> None:
        self._counters = counters
        self._generation = generation
        modes = ("every", "latest")
        self._reads = [
            ReadBlock(topic, prefix=prefix, mode=mode, max_per_cycle=64, beat_ms=_BEAT_MS)  # type: ignore[arg-type]
            for topic, mode in zip(IN, modes, strict=True)
        ]
        self._writes = [WriteBlock(topic, prefix=prefix, beat_ms=_BEAT_MS) for topic in OUT]
        self._numbers = [1] * len(OUT)
        self._lost = [0] * len(IN)

    def __call__(self) -> None:
        """Run one scan."""
        counters = self._counters
        for index, block in enumerate(self._reads):
            for message in block.each():
                counters.take(index, message.data)
            counters.counters[index]["block_lost"] += (block.udiLost - self._lost[index]) % 2**32
            self._lost[index] = block.udiLost
        for index, writer in enumerate(self._writes):
            self._write(index, writer)
        counters.control["plc_scans"] += 1

    def close(self) -> None:
        """Let go of the objects."""
        for reader in self._reads:
            reader.close()
        for writer in self._writes:
            writer.close()

    def _write(self, index: int, block: WriteBlock) -> None:
        topic, number = len(IN) + index, self._numbers[index]
        flood = max(1, int(self._counters.control["flood"]))
        for _ in range(flood):
            if block.msg is not None:
                block.xEnable = True
                block.msg.data = fill(topic, self._generation, number)
                self._counters.announce(topic, self._generation, number)
            if not block():
                return  # the same number again, so that it is no gap
            number = self._numbers[index] = number + 1


def main() -> None:
    """Run until killed: arguments are counters, generation, and a prefix or the files of Structured Text."""
    path, generation, *rest = sys.argv[1:]
    plc = VirtualPlc()
    program: Any
    if len(rest) == 1:
        program = Program(Counters(Path(path)), int(generation), rest[0])
    else:
        from tests.soak import st  # imports what a PLC in Python need not wait for

        program = st.Program(Counters(Path(path)), int(generation), Path(rest[0]), Path(rest[1]))
    plc.task("Soak", _SCAN_S).program(program)
    # A PLC that is stopped in an orderly way gives its claims back; one that is killed cannot.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    with contextlib.suppress(KeyboardInterrupt):
        plc.run()
    program.close()


if __name__ == "__main__":
    main()
