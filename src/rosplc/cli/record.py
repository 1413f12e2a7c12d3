"""``rosplc record``: what channels carry, into files that ROS tools read.

rosplc record  —  every channel of the bridge, until Ctrl-C

rosplc record /cmd_vel '/robot1/*' -o shift.mcap --duration 10min  —  some channels, for ten minutes

rosplc record --bag -o shift --split-size 1GB  —  a folder for `ros2 bag`, a new file every gigabyte

rosplc record --keep 5min --trigger error --trigger '/plc/status.fault' --after 10s  —  keep the last five
minutes in memory, and write them when a trigger fires; Ctrl-C stops, and `kill -USR1` saves at once

rosplc record --repair broken.mcap  —  save the intact part of a truncated file

The recorder reads every message in order, without affecting other programs. Missed messages are counted,
reported, and noted in the file.
"""

from __future__ import annotations

import errno
import os
import signal
import stat
import sys
import termios
import time
from pathlib import Path
from typing import Annotated, Any

import typer

from rosplc.bridge.run import pause, stop_on_signals
from rosplc.cli.options import Directory, observed_config, size
from rosplc.cli.options import duration as duration_ns
from rosplc.cli.text import ProgressLine, print_json, say, table, warn
from rosplc.cli.verb import Between, verb
from rosplc.config.resolve import load_project
from rosplc.errors import RecordingError
from rosplc.harmless import in_bytes, plural
from rosplc.monitor import find_objects
from rosplc.monitor.classic import expected_of
from rosplc.recorder import COMPRESSIONS, Recorder, RecordingOptions, Result, Selection, Split, quick_process
from rosplc.recorder.store import base_of, dated, file_name, free_name, repair
from rosplc.shm import Namespace

_TURN_S = 0.1


@verb
def command(
    topics: list[str] | None = None,
    /,
    *,
    output: Path | None = None,
    bag: bool = False,
    prefix: str | None = None,
    config: Path | None = None,
    exclude: list[str] | None = None,
    duration: str | None = None,
    split_size: str | None = None,
    split_time: str | None = None,
    compression: str = "zstd",
    keep: str | None = None,
    memory: str = "200MB",
    trigger: list[str] | None = None,
    after: str | None = None,
    files: Annotated[int, Between(1)] = 100,
    repair: Path | None = None,
    quiet: bool = False,
    directory: Directory = "/dev/shm",
    as_json: bool = False,
) -> None:
    """Record channels to MCAP files, which Foxglove, PlotJuggler and `ros2 bag` can read.

    Options:
        topics: Topics, services and actions, or patterns such as '/robot1/*'; by default all.
        output PATH: The file, or with --bag the folder; by default rosplc_DATE.
        bag: Write a folder with a metadata.yaml, as `ros2 bag record` does.
        prefix NAME: The bridge's `prefix:`; by default the configuration's, else rosplc.
        config FILE: The configuration for prefix, QoS and `stale_after:`; without --prefix, by default
            `./rosplc.yaml`.
        exclude TOPIC: Topics, services or patterns to leave out.
        duration TIME: Stop after this time, such as 10min.
        split_size SIZE: Begin a new file when the size reaches this value, such as 1GB.
        split_time TIME: Begin a new file after this time, such as 10min.
        compression NAME: Compression of messages: zstd, lz4 or none.
        keep TIME: Keep messages in memory for this time, and write them only when a trigger fires.
        memory SIZE: With --keep: maximum memory to use; if it is full, the oldest messages are dropped.
        trigger WHAT: With --keep: stale, error, or a condition such as '/plc/status.fault' or
            '/tank.level > 0.9', which triggers when it becomes true; by default stale and error.
        after TIME: With --keep: continue recording for this time after a trigger.
        files N: With --keep: maximum number of saves.
        repair FILE: Instead of recording, save the intact part of this file as --output.
        quiet: Print no progress.
        as_json: Print the result as JSON.
    """
    if repair is not None:
        _repair(repair, output, as_json=as_json, quiet=quiet)
        return
    seconds = duration_ns(duration, "--duration") / 1e9
    chosen = next((one for one in COMPRESSIONS if one == compression), None)
    if chosen is None:
        what = f"{compression!r} is not one of {', '.join(COMPRESSIONS)}"
        raise typer.BadParameter(what, param_hint="--compression")
    if keep is None and (trigger or after is not None):
        raise typer.BadParameter("requires --keep", param_hint="--trigger" if trigger else "--after")
    selection = Selection(tuple(topics or ()), tuple(exclude or ()))
    namespace, expected, qos, distro = Namespace(prefix or "rosplc", directory), None, {}, ""
    if (config := observed_config(config, prefix)) is not None:
        project = load_project(config)
        if prefix is None:
            namespace = project.namespace
        expected, distro = expected_of(project), project.config.settings.ros.distro
        qos = {plan.topic: plan.qos for plan in project.topics}
        for plan in project.topics:
            if plan.classic is not None and plan.topic in selection:
                warn(f"{plan.topic} is a classic topic without a channel, so it is not recorded")
    base = Path("rosplc") if output is None else base_of(output)
    if output is None and keep is None:
        base = free_name(dated(base, time.time_ns()))
    options = RecordingOptions(
        namespace=namespace,
        base=base,
        selection=selection,
        split=Split(size(split_size, "--split-size"), duration_ns(split_time, "--split-time")),
        bag=bag,
        compression=chosen,
        qos=qos,
        distro=distro,
        keep_ns=duration_ns(keep, "--keep"),
        memory=size(memory, "--memory"),
        triggers=tuple(trigger) if trigger else ("stale", "error") if keep is not None else (),
        after_ns=duration_ns(after, "--after"),
        most_files=files,
        expected=expected,
    )
    _record(options, seconds, quiet=quiet, as_json=as_json)


def _record(options: RecordingOptions, seconds: float, *, quiet: bool, as_json: bool) -> None:
    recorder = Recorder(options)

    def tell(number: int) -> None:
        if number in (signal.SIGHUP, signal.SIGUSR1):
            recorder.trigger(signal.Signals(number).name)
        if number == signal.SIGHUP:
            _leave_closed_terminal()

    line = ProgressLine(quiet=quiet)
    with quick_process(), stop_on_signals(tell) as stop:
        recorder.start()
        _begin(recorder, options, quiet=quiet)
        end = time.monotonic() + seconds if seconds else None
        try:
            try:
                while not pause(stop, _TURN_S) and (end is None or time.monotonic() < end):
                    recorder.look_after()
                    line.show(lambda: _progress(recorder))
            finally:
                line.clear()
                recorder.stop()
        finally:
            if recorder.result is not None:
                _report(recorder, recorder.result, as_json=as_json)
    if recorder.result is not None and not recorder.result.received and not options.keep_ns:
        raise RecordingError("REC004", "no message was received", where=options.namespace.prefix)


def _leave_closed_terminal() -> None:
    """Send output nowhere if its terminal was closed: an error of writing must not cost a file its end."""
    for stream in (sys.stdout, sys.stderr):
        descriptor = stream.fileno()
        try:
            stat.S_ISCHR(os.fstat(descriptor).st_mode) and termios.tcgetattr(descriptor)
        except termios.error as error:
            if error.args[0] == errno.EIO:
                os.dup2(os.open(os.devnull, os.O_WRONLY), descriptor)


def _repair(file: Path, output: Path | None, *, as_json: bool, quiet: bool) -> None:
    base = base_of(output or file.with_name(f"{base_of(file).name}_repaired"))
    line = ProgressLine(quiet=quiet)
    done = repair(file, file_name(base), lambda messages: line.show(lambda: f"{messages} messages saved"))
    line.clear()
    if as_json:
        facts = {"path": str(done.path), "messages": done.messages, "topics": done.topics}
        print_json(facts | {"problem": done.problem, "damaged": done.damaged})
        return
    say(f"{file}: {done.problem or 'the file is intact'}")
    if done.damaged:
        say(f"{plural(done.damaged, 'damaged part')} left out")
    say(f"{done.path}: {plural(done.messages, 'message')} of {plural(len(done.topics), 'topic')} saved")


def _begin(recorder: Recorder, options: RecordingOptions, *, quiet: bool) -> None:
    for name, error in recorder.inlet.failures.items():
        warn(f"{name} is not recorded: {error.what} [{error.code}]")
    topics = list(recorder.inlet.counts)
    for pattern in options.selection.without_match(topics):
        warn(f"no channel matches {pattern} yet; a matching channel will be recorded when it appears")
    for trigger, topic in recorder.idle_triggers().items():
        why = f"{topic} is not recorded, so the trigger cannot fire"
        if topic in options.selection:
            why = f"there is no channel {topic} yet; the trigger cannot fire until it exists"
        warn(f"trigger {trigger!r}: {why}")
    if not topics:
        warn(f"there is no channel with the prefix {options.namespace.prefix} yet; new ones will be recorded")
        found = find_objects(str(options.namespace.directory), seconds=0.0)
        if others := sorted({state.prefix for state in found}):
            warn(f"channels exist with other prefixes ({', '.join(others)}): choose one with --prefix")
    if not quiet:
        what, kept = plural(len(topics), "topic"), f"keeping the last {options.keep_ns / 1e9:g} s of"
        kept += f" {what}; triggers: {', '.join(options.triggers)}"
        warn(kept if options.keep_ns else f"recording {what}; stop with Ctrl-C")


def _progress(recorder: Recorder) -> str:
    now = recorder.progress()
    held = f", {now.span_ns / 1e9:.0f} s in memory" if recorder.options.keep_ns else ""
    files = f", {plural(now.files, 'file')}" if now.files else ""
    what = f"{plural(now.received, 'message')} of {plural(now.topics, 'topic')}"
    return f"{now.seconds:.0f} s: {what}, {now.lost} lost, {in_bytes(now.size)}{held}{files}"


def _report(recorder: Recorder, result: Result, *, as_json: bool) -> None:
    if as_json:
        print_json(_document(result, recorder))
        return
    lost = f"{result.lost} lost" if result.lost else "none lost"
    what = f"{plural(result.received, 'message')} of {plural(len(result.topics), 'topic')}"
    say(f"{what} in {result.seconds:.1f} s, {lost}")
    rows = [
        (name, one.type_name, one.received, one.lost + one.refused) for name, one in result.topics.items()
    ]
    table(rows, header=("topic", "type", "messages", "lost"), indent=2)
    for file in result.files:
        say(f"{file.path}: {plural(sum(file.counts.values()), 'message')}, {in_bytes(file.size)}")
    if recorder.options.keep_ns:
        for reason in result.saves:
            say(f"saved by trigger {reason}")
        if not result.saves:
            say("no trigger fired, so nothing was saved")
        if result.unsaved:
            warn(f"not saved, because --files was reached: {plural(result.unsaved, 'trigger')}")
        if result.cut_short:
            warn("--memory is too small for the time of --keep: raise --memory, or exclude topics")
    if result.lost:
        warn("messages were lost (gaps in sequence numbers): raise the topics' `slots`, or exclude topics")


def _document(result: Result, recorder: Recorder) -> dict[str, Any]:
    return {
        "seconds": result.seconds,
        "received": result.received,
        "lost": result.lost,
        "topics": {
            name: {"type": one.type_name, "received": one.received, "lost": one.lost, "refused": one.refused}
            for name, one in result.topics.items()
        },
        "files": [file.to_dict() for file in result.files],
        "saves": list(result.saves),
        "unsaved": result.unsaved,
        "cut_short": result.cut_short,
        "not_recorded": {name: error.to_dict() for name, error in recorder.inlet.failures.items()},
    }
