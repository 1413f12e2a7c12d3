"""Print the public contract of the rosplc that ``PYTHONPATH`` names, as JSON: item → value.

An item is something that users rely on: a public name or parameter, an option of a verb, a key of a
``--json`` document, a code, a key in a recording's metadata.

    PYTHONPATH=src python tests/contract/collect.py
"""

from __future__ import annotations

import contextlib
import inspect
import json
import os
import secrets
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from typer.testing import CliRunner

TOPICS = """
topics:
  /in: {type: geometry_msgs/msg/Twist, to: plc, stale_after: 200ms}
  /out: {type: sensor_msgs/msg/JointState, to: ros, limits: {name: 6, position: 6, velocity: 6, effort: 6}}
"""
WATCHDOG_S = 100.0
MESSAGE = {"name": ["a"], "position": [1.0], "velocity": [], "effort": []}


def api() -> Iterator[tuple[str, str]]:
    """Yield the names of the package, their parameters and what their objects have."""
    import rosplc

    for name in rosplc.__all__:
        item = getattr(rosplc, name)
        yield f"rosplc.{name}", "class" if inspect.isclass(item) else "value"
        if inspect.isclass(item):
            for attribute, value in inspect.getmembers(item):
                if attribute.startswith("_") and attribute != "__init__":
                    continue
                yield f"rosplc.{name}.{attribute}", "method" if callable(value) else "attribute"
                if inspect.isfunction(value):
                    yield from parameters(f"rosplc.{name}.{attribute}", value)
        elif callable(item):
            yield from parameters(f"rosplc.{name}", item)


def parameters(name: str, function: Any) -> Iterator[tuple[str, str]]:
    """Yield the parameters of a function: how each is passed, and its default."""
    for each in inspect.signature(function).parameters.values():
        default = "" if each.default is each.empty else f" = {each.default!r}"
        yield f"{name}({each.name})", f"{each.kind.description}{default}"


def commands() -> Iterator[tuple[str, str]]:
    """Yield the verbs, their arguments and options."""
    from typer.main import get_command

    from rosplc.cli.app import app

    group: Any = get_command(app)
    for verb, listed in group.commands.items():
        yield f"rosplc {verb}", "verb"
        command = listed.make_context(verb, [], resilient_parsing=True).command
        for each in command.params:
            kind = "flag" if getattr(each, "is_flag", False) else "many" if each.multiple else "one"
            if each.param_type_name == "argument":
                yield f"rosplc {verb} {each.name.upper()}", "required" if each.required else "optional"
            else:
                for spelling in (*each.opts, *each.secondary_opts):
                    yield f"rosplc {verb} {spelling}", kind


def codes() -> Iterator[tuple[str, str]]:
    """Yield the codes of errors and of the doctor's findings."""
    from rosplc.doctor.kinds import KINDS
    from rosplc.errors import CODES

    yield from ((code, "code") for code in (*CODES, *KINDS))


def paths(value: Any, at: str = "") -> Iterator[str]:
    """Yield the keys of a JSON document, elements of a list as one."""
    if isinstance(value, dict):
        for key, inner in value.items():
            # What is named by topics, types and fields is data, not a key.
            name = "*" if not key.isidentifier() or at.endswith((".message", ".fields")) else key
            yield f"{at}.{name}"
            yield from paths(inner, f"{at}.{name}")
    elif isinstance(value, list):
        for inner in value:
            yield from paths(inner, f"{at}[]")


def write_until(done: threading.Event, channel: Any) -> None:
    """Write a message now and then."""
    while not done.wait(0.05):
        channel.write(MESSAGE)


class Scene:
    """A bridge that runs, a writer and a reader: what the verbs look at.

    Args:
        folder: For files.
    """

    def __init__(self, folder: Path) -> None:
        self.folder, self.prefix = folder, f"contract{secrets.token_hex(4)}"
        self.config = folder / "rosplc.yaml"
        for name in [name for name in os.environ if name.startswith(("ROS", "CYCLONEDDS"))]:
            del os.environ[name]
        os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
        os.environ["ROS_DOMAIN_ID"] = str(secrets.randbelow(90) + 10)
        self.config.write_text(
            f"bridge: contract\nprefix: {self.prefix}\nros: {{distro: jazzy, backend: dds}}\n{TOPICS}"
        )

    def rosplc(self, *arguments: str, check: bool = True) -> Any:
        """Run a verb in this process, which has imported everything once."""
        from rosplc.cli.app import app

        done = CliRunner().invoke(app, arguments)
        if check and done.exit_code not in (0, 1):
            raise SystemExit(f"{arguments} ended with {done.exit_code}:\n{done.output}")
        return done

    @contextlib.contextmanager
    def running(self, *arguments: str) -> Iterator[subprocess.Popen[str]]:
        """Have a verb run meanwhile."""
        command = [sys.executable, "-m", "rosplc", *arguments]
        with (self.folder / f"{arguments[0]}.log").open("w") as log:
            process = subprocess.Popen(command, stdout=log, stderr=log, text=True, stdin=subprocess.DEVNULL)
            try:
                yield process
            finally:
                process.send_signal(signal.SIGINT)
                process.wait(WATCHDOG_S)

    def documents(self) -> Iterator[tuple[str, Any]]:
        """Yield verbs and what they print as JSON."""
        import rosplc

        config = str(self.config)

        def printed(name: str, *arguments: str) -> Iterator[tuple[str, Any]]:
            done = self.rosplc(*arguments)
            try:
                yield name, json.loads(done.stdout)
            except ValueError:
                raise SystemExit(f"{arguments} printed no JSON:\n{done.output}") from None

        yield from printed("check", "check", config, "--json")
        yield from printed("generate", "generate", config, "--out", "plc", "--json")
        yield from printed("types", "types", "--json")
        yield from printed("types TYPE", "types", "geometry_msgs/msg/Twist", "--json")
        with self.running("run", config, "--status", "0"):
            out = rosplc.attach("/out", prefix=self.prefix, write=True, timeout=WATCHDOG_S)
            into = rosplc.attach("/in", prefix=self.prefix, task="contract", timeout=WATCHDOG_S)
            with out, into:
                out.write(MESSAGE)
                prefix = ("--prefix", self.prefix)
                yield from printed("show", "show", *prefix, "--json")
                yield from printed("show TOPIC", "show", "/out", *prefix, "--json")
                yield from printed("show --header", "show", "/out", "--header", *prefix, "--json")
                yield from printed("status", "status", "--config", config, "--json")
                yield from printed("doctor", "doctor", config, "--json")
                writing = threading.Event()
                writer = threading.Thread(target=write_until, args=(writing, out))
                writer.start()
                try:
                    record = ("--output", "all.mcap", "--duration", "2s")
                    yield from printed("record", "record", "--config", config, *record, "--json")
                finally:
                    writing.set()
                    writer.join()
                yield from printed("replay", "replay", "all.mcap", "--to", "ros", "--speed", "max", "--json")
        yield from printed("replay --list", "replay", "all.mcap", "--list", "--json")

    def recorded(self) -> Iterator[tuple[str, str]]:
        """Yield the keys of a recording's metadata, which other tools read."""
        from mcap.reader import make_reader

        with (self.folder / "all.mcap").open("rb") as file:
            reader = make_reader(file)
            summary = reader.get_summary()
            assert summary is not None
            for channel in summary.channels.values():
                yield from ((f"recording channel metadata {key}", "key") for key in channel.metadata)
            for metadata in reader.iter_metadata():
                yield f"recording metadata {metadata.name}", "record"
                yield from (
                    (f"recording metadata {metadata.name} {key}", "key")
                    for key in metadata.metadata if not key.startswith("/")
                )  # fmt: skip

    def exits(self) -> Iterator[tuple[str, str]]:
        """Yield exit statuses of what goes wrong."""
        (self.folder / "wrong.yaml").write_text("topics: 1\n")
        for name, arguments in {
            "a wrong configuration": ("check", "wrong.yaml"),
            "an unknown option": ("check", "--nonsense"),
            "an unknown topic": ("show", "/no/such/topic", "--prefix", self.prefix),
            "an unknown type": ("types", "no_msgs/msg/Such"),
            "version": ("version",),
        }.items():
            yield f"exit status of {name}", str(self.rosplc(*arguments, check=False).exit_code)


def contract() -> dict[str, str]:
    """Return all of it."""
    found = dict([*api(), *commands(), *codes()])
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        scene = Scene(Path(folder))
        try:
            for name, document in scene.documents():
                found |= {f"--json of {name}: {path}": "key" for path in paths(document)}
            found |= dict([*scene.recorded(), *scene.exits()])
        finally:
            for file in Path("/dev/shm").glob(f"{scene.prefix}.*"):
                file.unlink()
    return found


if __name__ == "__main__":
    print(json.dumps(contract(), indent=1, sort_keys=True, ensure_ascii=False))
