"""``rosplc clean``: remove objects in shared memory that no bridge holds.

rosplc clean  —  remove unused objects of the bridge of rosplc.yaml, or of the default prefix

rosplc clean --prefix line3 --dry-run  —  show what would be removed

rosplc clean --topic /old_topic  —  only this topic

Objects of a running bridge and files of other programs are not removed. An attached PLC detects the removal
and attaches again when a bridge creates a new object; the last values are lost.
"""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path

import typer

from rosplc.cli.options import ConfigFile, Directory, bridge_namespace
from rosplc.cli.text import print_json, say
from rosplc.cli.verb import EXIT_FAILURE, verb
from rosplc.errors import ChannelError
from rosplc.harmless import plural
from rosplc.shm import Namespace, Part, open_object
from rosplc.shm.files import NameLock, Rights, open_plain_file
from rosplc.shm.names import file_name
from rosplc.shm.owned import retire_file


@verb
def command(
    config: ConfigFile = None,
    *,
    prefix: str | None = None,
    topic: list[str] | None = None,
    dry_run: bool = False,
    directory: Directory = "/dev/shm",
    as_json: bool = False,
) -> None:
    """Remove a prefix's unused objects: channels, locks and temporary files that no bridge uses.

    Options:
        prefix NAME: The bridge's `prefix:`, instead of a configuration.
        topic TOPIC: Only this topic, service or action; may be repeated.
        dry_run: Show what would be removed.
    """
    namespace = bridge_namespace(prefix, directory, config)
    removed, kept = _clean(namespace, topic or [], dry_run=dry_run)
    if as_json:
        print_json({"removed": removed, "kept": kept, "done": not dry_run})
    else:
        for name in removed:
            say(f"{'would remove' if dry_run else 'removed'} {name}")
        for name, why in kept.items():
            say(f"kept {name}: {why}")
        say(f"Prefix {namespace.prefix}: {plural(len(removed), 'unused file')}, {len(kept)} kept")
    if any(code in why for why in kept.values() for code in ("SHM102", "SHM119")):
        raise typer.Exit(EXIT_FAILURE)


def _clean(namespace: Namespace, topics: list[str], *, dry_run: bool) -> tuple[list[str], dict[str, str]]:
    """Remove the files of names that no bridge holds; return these, and name → why it is kept."""
    folder = Path(namespace.directory)
    wanted = {namespace.object_name(topic, part) for topic in topics for part in Part}
    files: dict[tuple[str, str], list[Path]] = {}
    try:
        listing = sorted(folder.iterdir())
    except OSError as error:
        raise ChannelError("SHM123", f"cannot list files: {error.strerror}", where=str(folder)) from error
    for path in listing:
        found = file_name(path.name)
        if found is None or found.prefix != namespace.prefix:
            continue
        if not wanted or found.item in wanted or (namespace.name_of(found.item) or ("",))[0] in topics:
            files.setdefault((found.item, found.lock), []).append(path)
    removed: list[str] = []
    kept: dict[str, str] = {}
    for (name, lock), paths in files.items():
        try:
            removed += _remove(folder / name, folder / lock, paths, dry_run=dry_run)
        except ChannelError as error:
            kept[name] = f"{error.what} [{error.code}]"
    return removed, kept


def _remove(item: Path, lock_file: Path, paths: list[Path], *, dry_run: bool) -> list[str]:
    """Remove the files of one name under its lock, the lock's file last.

    Raises ChannelError SHM116 while a bridge holds it; SHM104, SHM119, SHM121 for what is somebody else's.
    """
    existed = lock_file.exists()
    lock = NameLock(lock_file, Rights(lock_file.stat().st_mode if existed else 0o600))
    try:
        names = []
        for path in sorted(paths, key=lambda path: path == lock_file):
            if path == item and not lock.held_an_object:
                open_object(str(path)).close()  # anything else at this name is not ours to remove
            if not dry_run:
                if path == item:
                    _retire(path)
                path.unlink(missing_ok=True)
            names.append(str(path))
        if not dry_run or not existed:
            lock_file.unlink(missing_ok=True)
    except OSError as error:
        raise ChannelError("SHM102", f"cannot remove: {error.strerror}", where=str(lock_file)) from error
    finally:
        lock.release()
    return names


def _retire(path: Path) -> None:
    """Tell every process that has the object mapped to leave it."""
    with suppress(ChannelError):
        fd = open_plain_file(path, os.O_RDWR)
        try:
            retire_file(fd)
        finally:
            os.close(fd)
