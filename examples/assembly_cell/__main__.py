"""``python -m examples.assembly_cell``: run the cell, break it on the way, and count."""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import json
import signal
import subprocess
import sys
from collections.abc import Iterator
from typing import IO

from examples.assembly_cell.cell import Cell
from examples.assembly_cell.view import View
from rosplc.errors import RosplcError


def main() -> int:
    """Run; the status is 0 if every handle was delivered once and nothing else happened."""
    parser = argparse.ArgumentParser(prog="python -m examples.assembly_cell", description=__doc__)
    parser.add_argument("--plc", choices=("python", "st"), default="python", help="the PLC's program")
    parser.add_argument("--handles", type=int, default=8, help="how many are made")
    parser.add_argument("--no-faults", action="store_true", help="break nothing")
    parser.add_argument("--seed", type=int, help="break at random moments, the whole time")
    parser.add_argument("--web", action="store_true", help="show the channels in a browser, too")
    parser.add_argument("--json", action="store_true", help="print the result as JSON")
    options = parser.parse_args()
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # it leaves nothing behind then, either
    live = sys.stdout.isatty() and not options.json
    view = (lambda cell: None) if options.json else View(live=live)
    cell = Cell(options.plc, options.handles, not options.no_faults, options.seed, view)
    try:
        with cell, page(cell, wanted=options.web):
            result = cell.run()
            if isinstance(view, View):
                view(cell, last=True)
    except KeyboardInterrupt:
        return 130
    except RosplcError as error:
        print(f"{error.code}: {error.what}\n{error.remedy}", file=sys.stderr)
        return 1
    if options.json:
        print(json.dumps({**dataclasses.asdict(result), "good": result.good}))
    else:
        for fault in result.faults:
            print(f"broken: {fault}")
        for mishap in result.mishaps:
            print(f"MISHAP: {mishap}")
        word = "each once, in order, nothing else happened" if result.good else "this must not be"
        print(f"{len(result.delivered)} of {result.asked} handles in {result.seconds:.1f} s: {word}")
    return 0 if result.good else 1


def address(stream: IO[str]) -> str:
    """Return the page's address from the document that ``rosplc web --json`` prints."""
    text = ""
    for line in stream:
        text += line
        with contextlib.suppress(ValueError):
            return str(json.loads(text)["url"])
    return "it did not start"


@contextlib.contextmanager
def page(cell: Cell, *, wanted: bool) -> Iterator[None]:
    """Let ``rosplc web`` show this cell's channels meanwhile."""
    if not wanted:
        yield
        return
    options = ["--prefix", cell.prefix, "--config", str(cell.folder / "rosplc.yaml"), "--port", "0", "--json"]
    command = [sys.executable, "-m", "rosplc", "web", *options]
    child = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, text=True)
    assert child.stdout is not None
    print(f"in the browser: {address(child.stdout)}", flush=True)
    try:
        yield
    finally:
        child.terminate()
        child.wait()


if __name__ == "__main__":
    sys.exit(main())
