"""Write the bundled services and actions, ``src/rosplc/model/interfaces.txt``, from packages of ROS releases.

    python tools/extract_interfaces.py FOLDER
    python tools/extract_interfaces.py --compare humble CHECKOUT...

FOLDER holds the packages that ``tools/interfaces.yaml`` lists, as ``pip download --no-deps
ros-std-srvs==5.5.1`` and ``apt-get download ros-std-srvs`` fetch them, or a repository's archive of a tag
(``.tar.gz``). Comments are left out; the head of the
file lists each package with its SHA-256. The second form changes nothing: it compares what is bundled for a
distribution with the packages below other folders, such as clones of the distribution's repositories, whose
commits it prints.
"""

from __future__ import annotations

import hashlib
import io
import re
import subprocess
import sys
import tarfile
import tempfile
import zipfile
from collections import defaultdict
from pathlib import Path

import yaml

from rosplc.model import TypeStore
from rosplc.model.folders import split_definition
from rosplc.model.interfaces import PARTS, kind_of

PLAN = Path(__file__).with_name("interfaces.yaml")
TARGET = Path(__file__).parents[1] / "src/rosplc/model/interfaces.txt"
ORDER = ("humble", "jazzy", "kilted", "lyrical", "noetic")
HEAD = """\
# The services and actions of ROS distributions, and messages that rosbags lacks, without comments. Written by
# tools/extract_interfaces.py. After each name: the distributions. Messages, and what belongs to the tutorials
# (example_interfaces, turtlesim, turtlesim_msgs, *_tutorials), are written by hand, the others were read from
# these packages:
"""


def unpack(archive: Path, folder: Path) -> None:
    """Write an archive's ``.srv`` and ``.action`` files as ``package/kind/Name.kind`` below a folder."""
    if archive.suffix == ".whl":
        with zipfile.ZipFile(archive) as wheel:
            contents = {name: wheel.read(name) for name in wheel.namelist() if is_interface(name)}
    else:
        data = archive.read_bytes()
        if archive.suffix == ".deb":
            data = subprocess.run(
                ["dpkg-deb", "--fsys-tarfile", archive], capture_output=True, check=True
            ).stdout
        with tarfile.open(fileobj=io.BytesIO(data)) as tar:
            members = [each for each in tar.getmembers() if each.isfile() and is_interface(each.name)]
            contents = {each.name: tar.extractfile(each).read() for each in members}  # type: ignore[union-attr]
    if not contents:
        sys.exit(f"{archive} has no service and no action")
    for name, content in contents.items():
        file = folder.joinpath(*Path(name).parts[-3:])
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(content)


def is_interface(name: str) -> bool:
    """Return whether a file of an archive is a service or an action."""
    return bool(re.search(r"/\w+/(srv/\w+\.srv|action/\w+\.action)\Z", f"/{name}"))


def texts(distro: str, folders: list[Path]) -> dict[str, str]:
    """Return the text of every service and action below some folders that the distribution has types for."""
    own = TypeStore.bundled(distro)
    store = TypeStore(distro, {name: own[name] for name in own.names()}).with_paths(folders)
    for problem in store.problems():
        print(problem, file=sys.stderr)
    return {name: text_of(store, name) for name in (*store.services(), *store.actions())}


def text_of(store: TypeStore, name: str) -> str:
    """Return a definition without comments, constants first."""
    parts = [f"{name}_{part}" for part in PARTS[kind_of(name)]]
    return "---\n".join(split_definition(part, store.definition_text(part))[part].lstrip() for part in parts)


def extract(folder: Path) -> str:
    """Return the content of the file."""
    plan = yaml.safe_load(PLAN.read_text())
    distros: dict[tuple[str, str], set[str]] = defaultdict(set)
    head = HEAD
    for beginning, source in plan["archives"].items():
        archives = list(folder.glob(f"{beginning}[-_+.]*"))
        if len(archives) != 1:
            sys.exit(f"{folder} has {len(archives)} files {beginning}…")
        digest = hashlib.sha256(archives[0].read_bytes()).hexdigest()
        head += f"#   {archives[0].name}: {source['licence']}, SHA-256 {digest}\n"
        with tempfile.TemporaryDirectory() as place:
            unpack(archives[0], Path(place))
            found = texts(source["distros"][0], [Path(place)])
        for name, text in found.items():
            for distro in source["distros"]:
                if name not in plan["without"].get(distro, ()):
                    ros2 = text if distro == "noetic" else of_ros2(text)
                    distros[name, ros2].add(distro)
    for own in plan["own"]:
        for name, text in own["definitions"].items():
            distros[name, text].update(own["distros"])
    return head + "".join(
        f"\n==== {name} {' '.join(each for each in ORDER if each in known)}\n{text}"
        for (name, text), known in sorted(distros.items())
    )


def of_ros2(text: str) -> str:
    """Return a definition of ROS 1 with the names that ROS 2 has for its times."""
    return re.sub(
        r"^(time|duration)\b", lambda m: f"builtin_interfaces/{m[1].title()}", text, flags=re.MULTILINE
    )


def compare(distro: str, folders: list[Path]) -> int:
    """Print what differs between the bundle and other definitions of a distribution; return how many do."""
    for folder in folders:
        print(f"{folder}: {commit_of(folder)}")
    store = TypeStore.bundled(distro)
    known = {*store.services(), *store.actions()}
    packages = {package_of(name) for name in known}
    theirs = {name: text for name, text in texts(distro, folders).items() if package_of(name) in packages}
    packages = {package_of(name) for name in theirs}
    differing = 0
    for name in sorted({*theirs, *(each for each in known if package_of(each) in packages)}):
        ours = text_of(store, name) if name in known else None
        if theirs.get(name) != ours:
            differing += 1
            print(f"{name}: {'there only' if ours is None else 'differs' if name in theirs else 'here only'}")
    print(f"{distro}: {len(theirs)} compared, {differing} differ")
    return differing


def commit_of(folder: Path) -> str:
    """Return the tag or branch and the commit of a clone, and whether files in it were changed."""

    def git(*arguments: str) -> str:
        command = ["git", "-C", str(folder), *arguments]
        return subprocess.run(command, capture_output=True, text=True, check=False).stdout.strip()

    if not git("ls-files", "."):
        return "no clone: its commit is not known"
    return git("describe", "--all", "--always", "--long", "--dirty", "--abbrev=40")


def package_of(name: str) -> str:
    """Return the package of a type's full name."""
    return name.partition("/")[0]


def main(arguments: list[str]) -> int:
    """Run the program."""
    if len(arguments) > 2 and arguments[0] == "--compare":
        return min(compare(arguments[1], [Path(each) for each in arguments[2:]]), 1)
    if len(arguments) != 1:
        sys.exit(__doc__)
    TARGET.write_text(extract(Path(arguments[0])))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
