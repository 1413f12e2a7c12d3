"""Writing the files: nothing that somebody edited is lost, nothing stale stays, no path leads elsewhere."""

from __future__ import annotations

import json
import os
import tempfile
from pathlib import Path

import pytest

from rosplc.errors import GenerationError
from rosplc.plc.build import build_type_library
from rosplc.plc.delivery import MANIFEST, project_files, write_files
from rosplc.plc.project import object_text
from tests.unit.plc.projects import STORE, layout, project, read, write

FILES = {"st/Types/a.st": b"a\n", "st/b.st": b"b\n", "x.xml": b"<x/>\n"}


def tree(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def refused(folder, files=FILES, **options):
    with pytest.raises(GenerationError) as caught:
        write_files(folder, files, **options)
    return caught.value


def test_a_first_writing_makes_folders_and_files(tmp_path):
    """Every file with its bytes, and the manifest."""
    delivery = write_files(tmp_path / "deep" / "plc", FILES)
    assert delivery.written == tuple(sorted(FILES))
    found = tree(tmp_path / "deep" / "plc")
    assert found.pop(MANIFEST)
    assert found == FILES


def test_a_second_writing_touches_nothing(tmp_path):
    """Files that are as they should be keep their time stamps, the manifest too."""
    write_files(tmp_path, FILES)
    before = {path: (tmp_path / path).stat().st_mtime_ns for path in tree(tmp_path)}
    delivery = write_files(tmp_path, FILES)
    assert (delivery.written, delivery.removed) == ((), ())
    assert delivery.unchanged == tuple(sorted(FILES))
    assert {path: (tmp_path / path).stat().st_mtime_ns for path in tree(tmp_path)} == before


def test_an_edited_file_is_kept_and_the_writing_refused(tmp_path):
    """PLC001 names it, and no other file was written either."""
    write_files(tmp_path, FILES)
    (tmp_path / "st/b.st").write_text("mine\n")
    # Changed or no longer generated: to overwrite or remove it would lose the work in it.
    for files in ({**FILES, "st/b.st": b"new\n", "x.xml": b"<y/>\n"}, {"x.xml": b"<y/>\n"}):
        error = refused(tmp_path, files)
        assert error.code == "PLC001" and "st/b.st" in str(error)
        assert (tmp_path / "st/b.st").read_text() == "mine\n"
        assert (tmp_path / "x.xml").read_bytes() == b"<x/>\n"
    (tmp_path / MANIFEST).unlink()  # of these files, none was generated
    assert refused(tmp_path, {"st/b.st": b"new\n"}).code == "PLC001"
    files = {f"{n}.st": b"x" for n in range(9)}
    for path in files:
        (tmp_path / path).write_text("mine")
    assert "and 4 more" in str(refused(tmp_path, files))


def test_forcing_overwrites_and_removes(tmp_path):
    """``--force`` is the user's decision."""
    write_files(tmp_path, FILES)
    for path in ("st/b.st", "x.xml"):
        (tmp_path / path).write_text("mine\n")
    delivery = write_files(tmp_path, {"x.xml": b"<y/>\n"}, force=True)
    assert delivery.removed == ("st/Types/a.st", "st/b.st")
    assert (tmp_path / "x.xml").read_bytes() == b"<y/>\n"


def test_stale_files_and_empty_folders_are_removed(tmp_path):
    """What is no longer generated goes, with its folder; what is not ours stays."""
    write_files(tmp_path, FILES)
    (tmp_path / "st/notes.txt").write_text("mine\n")
    delivery = write_files(tmp_path, {"x.xml": b"<x/>\n"})
    assert delivery.removed == ("st/Types/a.st", "st/b.st")
    assert set(tree(tmp_path)) == {"x.xml", "st/notes.txt", MANIFEST}
    assert not (tmp_path / "st/Types").exists()


def test_a_file_that_was_edited_to_what_is_generated_now_is_fine(tmp_path):
    """A colleague's generation, fetched with git, is no edit."""
    write_files(tmp_path, FILES)
    (tmp_path / "x.xml").write_bytes(b"<y/>\n")
    assert write_files(tmp_path, {**FILES, "x.xml": b"<y/>\n"}).written == ()


@pytest.mark.parametrize(
    "text",
    [
        b"", b"{", b"[]", b"null", b'{"files": []}', b'{"files": null}', b'{"files": 3}', b'{"comment": 1}',
        b"[" * 100_000, b"\xff\xfe{}",
    ],
)  # fmt: skip
def test_a_damaged_manifest_is_refused_and_forcing_helps(tmp_path, text):
    """Without it edited files cannot be told from generated ones."""
    write_files(tmp_path, FILES)
    (tmp_path / MANIFEST).write_bytes(text)
    assert refused(tmp_path).code == "PLC001"
    write_files(tmp_path, FILES, force=True)
    assert write_files(tmp_path, FILES).written == ()


def test_a_manifest_with_other_values_counts_as_edits(tmp_path):
    """A hash that is no hash matches no file."""
    write_files(tmp_path, FILES)
    (tmp_path / MANIFEST).write_text(json.dumps({"files": dict.fromkeys(FILES, 7)}))
    assert refused(tmp_path, {"x.xml": b"<y/>\n"}).code == "PLC001"


@pytest.mark.parametrize("force", [False, True])
def test_paths_in_a_manifest_do_not_lead_elsewhere(tmp_path, force):
    """A manifest from a stranger cannot have files outside the folder removed."""
    outside = tmp_path / "precious.txt"
    outside.write_text("keep\n")
    folder = tmp_path / "plc"
    write_files(folder, FILES)
    (folder / "link").symlink_to(tmp_path)
    manifest = json.loads((folder / MANIFEST).read_text())
    digest = "0" * 64
    tricks = ["../precious.txt", str(outside), "st/../../precious.txt", "link/precious.txt", "", ".", "a\0b"]
    manifest["files"] |= dict.fromkeys(tricks, digest)
    (folder / MANIFEST).write_text(json.dumps(manifest))
    delivery = write_files(folder, FILES, force=force)
    assert delivery.removed == ()
    assert outside.read_text() == "keep\n"


def test_a_folder_that_cannot_be_written_is_an_error(tmp_path):
    """PLC002 with the system's reason: a file where a folder should be, or a folder for a file."""
    (tmp_path / "file").write_text("")
    assert refused(tmp_path / "file" / "plc").code == "PLC002"
    assert refused(tmp_path / "file").code == "PLC002"
    (tmp_path / "plc" / "x.xml").mkdir(parents=True)
    assert refused(tmp_path / "plc").code == "PLC002"


def test_a_folder_without_permission_is_an_error():
    """Permissions are the usual reason."""
    user = os.geteuid()
    with tempfile.TemporaryDirectory() as folder:
        os.chmod(folder, 0o555)
        try:
            os.seteuid(user or 65534)  # root could write everywhere
            assert refused(Path(folder) / "plc").code == "PLC002"
        finally:
            os.seteuid(user)


def test_every_object_has_a_file_of_its_own():
    """Also on file systems that do not tell case apart; the other deliveries are beside it."""
    made = project(read("/a"), write("/b"))
    files = project_files(made, [layout("std_msgs/msg/Bool")], "rosplc")
    texts = {path: content for path, content in files.items() if path.endswith(".st")}
    assert len(texts) == len(made.duts) + len(made.gvls) + len(made.pous)
    assert len({path.upper() for path in files}) == len(files)
    item = next(pou for pou in made.pous if pou.name == "SharedMemory_Read")
    assert texts["st/SharedMemory_Read.st"].decode() == object_text(item)
    assert {"rosplc.xml", "rosplc_import.py", "rosplc.h"} <= set(files)


def test_names_up_to_the_limits_of_ros_have_files(tmp_path):
    """An identifier may be longer than a file name can be."""
    folder = tmp_path / "types" / ("p" * 120) / "msg"
    folder.mkdir(parents=True)
    names = ["T" + "y" * 118 + end for end in "ab"]
    for name in names:
        (folder / f"{name}.msg").write_text("uint8 x\n")
    store = STORE.with_paths([tmp_path / "types"])
    made = build_type_library(store, [layout(f"{'p' * 120}/msg/{name}", store=store) for name in names])
    files = project_files(made, [], "rosplc")
    assert all(len(Path(path).name) <= 255 for path in files)
    assert len(write_files(tmp_path / "plc", files).written) == len(files)
    assert sum(path.startswith("st/") for path in files) == len(made.duts) + len(made.gvls) + len(made.pous)


@pytest.mark.parametrize("name", ["rosplc.xml", "st"])
def test_links_are_not_followed(tmp_path, name):
    """A link in the output folder, dangling too, is refused, and replaced with force."""
    folder, outside = tmp_path / "plc", tmp_path / "outside"
    folder.mkdir()
    (folder / name).symlink_to(outside)
    files = {"rosplc.xml": b"<x/>", "st/a.st": b"a"}
    with pytest.raises(GenerationError) as caught:
        write_files(folder, files)
    assert caught.value.code == "PLC001" and not outside.exists()
    write_files(folder, files, force=True)
    assert not outside.exists() and (folder / "st/a.st").read_bytes() == b"a"
