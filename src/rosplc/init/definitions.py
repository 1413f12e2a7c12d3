"""Where the definition of a type comes from: the distribution, the user, ROS's own folders, or the wire.

Whatever does not come with the distribution and is not named by the user is kept as text, to be saved
beside the configuration: a bridge must not depend on what was on the network when it was set up.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path

from rosplc.errors import MessageTypeError, RosplcError
from rosplc.model import TypeStore
from rosplc.model.folders import read, split_definition
from rosplc.model.parse import full_name, parse_definition

MOST_TYPES = 500  # one type's definition has a handful


class Definitions:
    """The types that are known, more of them with time, beginning with a distribution's.

    ``folders`` are the user's own with ``.msg`` files; ``AMENT_PREFIX_PATH`` and ``ROS_PACKAGE_PATH`` of the
    environment say where an installed ROS keeps its definitions. ``texts`` has the definitions that are to be
    saved by full name, ``origins`` where each of them comes from, in words. Raises MessageTypeError TYP… as
    for ``types.paths`` of a configuration.
    """

    def __init__(
        self, distro: str, folders: Sequence[Path] = (), environment: Mapping[str, str] | None = None
    ) -> None:
        self.store = TypeStore.bundled(distro).with_paths(folders)
        self.texts: dict[str, str] = {}
        self.origins: dict[str, str] = {}
        self._environment = os.environ if environment is None else environment

    def learn(self, type_name: str, text: str, origin: str) -> None:
        """Take a type from a definition text, which is not trusted; raises TYP001 … TYP007."""
        new = self.store.with_definition(type_name, text)
        for name, part in split_definition(type_name, text).items():
            if name not in self.store:
                self.texts[name] = part
                self.origins[name] = origin
        self.store = new

    def find_installed(self, type_name: str) -> bool:
        """Look for a type, and those it needs, in an installed ROS; return whether it is known now.

        Raises MessageTypeError TYP… if what stands there is wrong.
        """
        if type_name in self.store:
            return True
        parts: dict[str, str] = {}
        first: Path | None = None
        todo = [full_name(type_name)]
        while todo:
            name = todo.pop(0)
            if name in parts or name in self.store or name.startswith("builtin_interfaces/"):
                continue
            file = self._file(name)
            if file is None or len(parts) == MOST_TYPES:
                return False
            first = first or file
            parts[name] = f"{read(file)}\n"
            todo += _needed(name, parts[name], self.store.ros_version)
        self.learn(type_name, join_texts(parts), str(first))
        return True

    def unknown(self, type_name: str, more: str = "") -> MessageTypeError:
        """Return the error of a type that was found nowhere: TYP001."""
        return MessageTypeError(
            "TYP001",
            f"{type_name} is unknown in {self.store.distro}{more}",
            remedy="Name the folder of its package with --types, or source the setup.bash of a "
            "workspace that has it.",
        )

    def _file(self, type_name: str) -> Path | None:
        package, _, base = type_name.split("/")
        for folder in self._roots():
            file = folder / package / "msg" / f"{base}.msg"
            if file.is_file():
                return file
        return None

    def _roots(self) -> list[Path]:
        if self.store.ros_version == 1:
            return [Path(part) for part in self._environment.get("ROS_PACKAGE_PATH", "").split(":") if part]
        prefixes = self._environment.get("AMENT_PREFIX_PATH", "").split(":")
        return [Path(part) / "share" for part in prefixes if part]


def join_texts(texts: Mapping[str, str]) -> str:
    """Return one text for definitions by full name, as ROS tools concatenate them."""
    (_, own), *others = texts.items()
    return own + "".join(f"{'=' * 80}\nMSG: {name.replace('/msg/', '/')}\n{text}" for name, text in others)


def _needed(name: str, text: str, ros_version: int) -> list[str]:
    try:
        (parsed,) = parse_definition(name, text, ros_version=ros_version)
    except (RosplcError, ValueError):
        return []  # whoever learns the text says what is wrong with it
    return list(parsed.message.needs)
