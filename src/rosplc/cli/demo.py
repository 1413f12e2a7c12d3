"""``rosplc demo``: robot, bridge and virtual PLC at work, on any machine.

rosplc demo  —  run and watch the demo until Ctrl-C

rosplc demo --duration 20s  —  run, then compare the messages sent with those received

rosplc demo --duration 20s --rate 500 --topics 6 --json

rosplc demo --duration 20s --kill  —  kill and restart the bridge during the run

rosplc demo --plc st --duration 20s  —  the PLC runs generated Structured Text, compiled with gcc

rosplc demo --plc openplc --duration 20s  —  the PLC is the OpenPLC runtime

A simulated robot publishes over DDS; the bridge carries its topics into shared memory; a virtual PLC steers
the robot based on its pose. The three processes use their own DDS domain and prefix. The exit status is 0
only if every message arrived intact and exactly once. With --kill, some messages are lost; the exit status is
0 only if these are consecutive and were sent around the kill, no message is torn or duplicated, and both
directions work again.

With --plc st, the PLC runs Structured Text that is translated to C, without CODESYS: the code generated from
the demo's configuration, and examples/st/PLC_PRG.st. This requires gcc and a checkout of the sources. Because
of the translation, the first run takes a minute or two longer.

With --plc openplc, the PLC is OpenPLC Runtime 4.1. Set ROSPLC_OPENPLC to the folder where it was built and
ROSPLC_STRUCPP to the folder of STruC++, its compiler. The runtime needs /run/runtime, a folder that only root
can create. No other OpenPLC may be running. The mean cycle time covers the last few seconds.
"""

from __future__ import annotations

import contextlib
import signal
import sys
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from rosplc.cli.options import duration as duration_ns
from rosplc.cli.text import ProgressLine, print_json, say, table
from rosplc.cli.verb import EXIT_FAILURE, EXIT_INTERRUPTED, Between, verb

if TYPE_CHECKING:
    from collections.abc import Iterator

    from rosplc.demo.plan import Plan
    from rosplc.demo.supervisor import Outage, Result

_UNATTENDED = 20.0
_MODULES = {"python": "rosplc.demo.plc", "st": "rosplc.demo.st.process", "openplc": "rosplc.demo.openplc"}


@verb
def command(
    *,
    duration: str | None = None,
    rate: Annotated[float, Between(1.0, 1000.0)] = 100.0,
    topics: Annotated[int, Between(1, 32)] = 3,
    plc: Literal["python", "st", "openplc"] = "python",
    kill: bool = False,
    as_json: bool = False,
) -> None:
    """Demonstrate how ROS topics reach a virtual PLC and its commands come back.

    Options:
        duration TIME: How long to send messages, such as 20s; by default until Ctrl-C, or for 20s
            if the output is not a terminal.
        rate HZ: Messages per second on each topic.
        topics N: Number of topics that the robot publishes.
        plc KIND: The PLC program: python; st, which is generated Structured Text translated to C; or
            openplc, which runs in the OpenPLC runtime.
        kill: Kill the bridge (SIGKILL) after a third of the duration, and restart it.
        as_json: Print the result as JSON.
    """
    from rosplc.demo.plan import FreeDomain, Plan

    seconds = None if duration is None else parse_duration(duration)
    if seconds is None and not sys.stdout.isatty():
        seconds = _UNATTENDED
    domain = FreeDomain()
    plan = Plan(domain=domain.number, rate=rate, topics=topics)
    live = sys.stdout.isatty() and not as_json
    made = {"st": _structured_text, "openplc": _openplc}.get(plc, lambda _: contextlib.nullcontext())
    with _ended_by_sigterm(), made(plan) as folder:
        result = _run(plan, seconds, kill=kill, live=live, module=_MODULES[plc], folder=folder)
    if as_json:
        facts = {"rate": rate, "topics": topics, "interval": plan.interval, "plc": plc}
        print_json({"plan": facts, **result.to_dict()})
    else:
        _print(result)
    if not result.good:
        raise typer.Exit(EXIT_FAILURE)


def parse_duration(text: str) -> float:
    """Return the seconds in ``20s``, ``500ms``, ``1.5min`` or, without a unit, ``20``; zero is none."""
    text = text.strip()
    return duration_ns(f"{text}s" if text[-1:].isdigit() else text, "--duration") / 1e9


@contextlib.contextmanager
def _structured_text(plan: Plan) -> Iterator[Path]:
    """Give a folder with the PLC project in Structured Text, compiled by the time it is given."""
    from rosplc.demo.outside import write_configuration
    from rosplc.demo.st.process import find_translator, read_texts, write_texts
    from rosplc.plc.build import plc_project
    from rosplc.plc.plan import ProjectOptions

    translator = find_translator()
    with tempfile.TemporaryDirectory(prefix="rosplc-demo-st-") as name:
        folder = Path(name)
        project = plc_project(write_configuration(folder, plan), ProjectOptions())
        write_texts(folder, plan, project, translator.programs)
        line, text = ProgressLine(), "translating Structured Text to C: {} of {} new objects"
        try:
            built = translator.build(
                read_texts(folder), lambda done, of: line.show(lambda: text.format(done, of))
            )
        finally:
            line.clear()
        try:
            yield folder
        finally:
            # The prefix is of this run alone, so no other run would find its library useful.
            built.path.unlink(missing_ok=True)


@contextlib.contextmanager
def _openplc(plan: Plan) -> Iterator[Path]:
    """Give a folder with the PLC program, compiled for OpenPLC's runtime."""
    from rosplc.demo.openplc import compile_prepared, prepare, program_text
    from rosplc.demo.outside import write_configuration

    with tempfile.TemporaryDirectory(prefix="rosplc-demo-openplc-") as name:
        prepare(Path(name), write_configuration(Path(name), plan), program_text(plan))
        print("compiling the PLC program for OpenPLC", file=sys.stderr, flush=True)
        compile_prepared(Path(name))
        yield Path(name)


def _run(
    plan: Plan, seconds: float | None, *, kill: bool, live: bool, module: str, folder: Path | None
) -> Result:
    from rich.console import Console

    from rosplc.demo.supervisor import Demo
    from rosplc.demo.view import LiveView

    line = ProgressLine(quiet=live or not sys.stderr.isatty())
    with contextlib.ExitStack() as stack:
        view = stack.enter_context(LiveView(Console())) if live else None

        def draw(demo: Demo) -> None:
            if view is not None:
                view.draw(demo)
            line.show(lambda: f"{demo.elapsed:.0f} s: {demo.phase}")

        demo = stack.enter_context(Demo(plan, on_tick=draw, plc=module, folder=folder))
        stack.callback(line.clear)
        return demo.run(seconds, kill=kill)


@contextlib.contextmanager
def _ended_by_sigterm() -> Iterator[None]:
    def terminate(*_: object) -> None:
        # Unwinds through the demo's own clean-up, as Ctrl-C does.
        raise typer.Exit(EXIT_INTERRUPTED)

    before = signal.signal(signal.SIGTERM, terminate)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def _print(result: Result) -> None:
    rows = []
    for flow in result.flows:
        age = result.ages.get(flow.topic)
        old = "" if age is None else f"{age['median_ms']:.2f} ({age['p99_ms']:.2f})"
        counts = (flow.sent, flow.received, flow.lost, flow.torn, flow.repeated)
        rows.append((flow.topic, "→ PLC" if flow.to == "plc" else "→ ROS", *counts, old))
    table(rows, header=("topic", "way", "sent", "received", "lost", "torn", "repeated", "age ms (p99)"))
    cycle = result.cycle
    say(
        f"PLC task: {cycle['scans']} scans, {cycle['missed']} missed, "
        f"mean {cycle['cycle_mean_us'] / 1000:.2f} ms, longest {cycle['cycle_max_us'] / 1000:.2f} ms; "
        f"the robot moved {result.metres:.2f} m, following the PLC's commands"
    )
    if result.program is not None:
        say(
            f"Structured Text alone: mean {result.program['mean_us']:.0f} µs per scan, "
            f"longest {result.program['max_us']:.0f} µs"
        )
    if result.outage is not None:
        say(_in_words(result.outage))
    word = "INCOMPLETE" if not result.good else "OK" if result.outage is None else "RECOVERED"
    say(f"{word}: {result.summary()}")


def _in_words(outage: Outage) -> str:
    def after(moment: float | None) -> str:
        return "never" if moment is None else f"{moment - outage.restarted_at:.1f} s"

    return (
        f"The bridge was killed at {outage.killed_at:.1f} s and restarted at {outage.restarted_at:.1f} s. "
        f"Time until the PLC received messages again: {after(outage.to_plc_at)}; "
        f"until the robot received commands again: {after(outage.to_ros_at)}. The PLC kept running."
    )
