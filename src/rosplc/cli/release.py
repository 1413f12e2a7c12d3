"""``rosplc release``: free the writer's claim that a dead PLC has left in a channel.

rosplc release /plc/status  —  after its PLC crashed, let another program write to the topic

rosplc release /plc/status --prefix line3 --yes  —  another bridge's channel, without confirmation

The claim is freed only if its holder shows no sign of life for three heartbeat periods.
A PLC that was only paused loses its claim: its block reports error 115 when it runs again.
"""

from __future__ import annotations

import sys
import time
from contextlib import nullcontext

import typer

from rosplc.cli.options import Directory, bridge_namespace
from rosplc.cli.text import say
from rosplc.cli.verb import verb
from rosplc.errors import ChannelError
from rosplc.shm import Attached, Direction, OwnedChannel, Writer, attach
from rosplc.shm.attach import silence_ns

_LOOK_S = 0.02


@verb
def command(
    topic: str, /, *, prefix: str | None = None, yes: bool = False, directory: Directory = "/dev/shm"
) -> None:
    """Free the claim of a dead writer, so that another program can write to the channel.

    Options:
        topic: The topic's ROS name.
        prefix NAME: The bridge's `prefix:`; by default that of `./rosplc.yaml`, else rosplc.
        yes: Do not ask.
    """
    namespace = bridge_namespace(prefix, directory)
    with attach(namespace, topic, write=True) as attached:
        if not attached.snapshot().writer.epoch:
            say(f"{topic} is free: no program has claimed it")
            return
        _wait_for_silence(attached, topic)
        if not yes:
            if not sys.stdin.isatty():
                raise typer.BadParameter("without a terminal, confirm with --yes", param_hint="--yes")
            typer.confirm(f"The writer of {topic} shows no sign of life. Free its claim?", abort=True)
        to_plc = attached.identity.direction is Direction.TO_PLC
        # Only a bridge writes there: its lock shows whether one is running.
        with OwnedChannel.take_over(namespace, attached) if to_plc else nullcontext():
            Writer(attached.region, attached.snapshot().writer.epoch, 1000).release()
    say(f"the claim on {topic} was freed")


def _wait_for_silence(attached: Attached, topic: str) -> None:
    """Watch the writer for as long as the format gives it; SHM114 if it lives."""
    first = attached.snapshot().writer
    end = time.monotonic_ns() + silence_ns(first.beat_ms)
    while time.monotonic_ns() < end:
        now = attached.snapshot().writer
        if (now.epoch, now.beat, now.head) != (first.epoch, first.beat, first.head):
            who = f"process {now.pid}" if now.pid else "a PLC program"
            raise ChannelError(
                "SHM114", f"{who} is still writing", where=topic, remedy="Stop that program first."
            )
        time.sleep(_LOOK_S)
