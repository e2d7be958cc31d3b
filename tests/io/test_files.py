"""Files: nothing is written through a link; lists of files."""

from __future__ import annotations

import errno
import os
import sqlite3
from pathlib import Path

import pytest

from getagrip.batch.ledger import LEDGER_FILE, Ledger
from getagrip.errors import InputError, UsageError
from getagrip.io import files
from getagrip.studio.store.mark_store import Store

CANARY = b"another file of the user's"


@pytest.fixture
def canary(tmp_path: Path) -> Path:
    path = tmp_path / "canary"
    path.write_bytes(CANARY)
    return path


@pytest.mark.parametrize("dangling", [False, True])
def test_a_link_is_replaced_and_not_followed(tmp_path: Path, canary: Path, dangling: bool) -> None:
    target = tmp_path / "report.png"
    target.symlink_to(tmp_path / "nowhere" if dangling else canary)
    files.write_bytes(target, b"new")
    assert target.read_bytes() == b"new"
    assert not target.is_symlink()
    assert canary.read_bytes() == CANARY
    assert not (tmp_path / "nowhere").exists()


def test_no_link_can_wait_where_a_file_is_written(tmp_path: Path, canary: Path) -> None:
    for pid in range(os.getpid() - 5, os.getpid() + 6):
        (tmp_path / f".page.html.{pid}").symlink_to(canary)
    files.write_text(tmp_path / "page.html", "new")
    assert canary.read_bytes() == CANARY


def test_folders_that_are_links_are_refused(tmp_path: Path) -> None:
    (tmp_path / "elsewhere").mkdir()
    for name in ("elsewhere", "nowhere"):
        link = tmp_path / f"to-{name}"
        link.symlink_to(tmp_path / name)
        with pytest.raises(UsageError, match="got a link"), files.new_folder(link):
            pass
        with pytest.raises(UsageError, match="got a link"):
            files.folder_inside(tmp_path, link.name)
    assert not any((tmp_path / "elsewhere").iterdir())


def test_looking_whether_a_file_can_be_written_follows_no_link(tmp_path: Path) -> None:
    link = tmp_path / "numbers.json"
    link.symlink_to(tmp_path / "nowhere")
    files.check_file("--json", link)
    assert link.is_symlink()
    assert not (tmp_path / "nowhere").exists()


def test_sweeping_moves_nothing_out_of_a_folder_that_is_linked(tmp_path: Path, canary: Path) -> None:
    (elsewhere := tmp_path / "elsewhere").mkdir()
    canary.rename(elsewhere / "own")
    left = tmp_path / "sent" / f"{files.TEMPORARY_FOLDER_PREFIX}x"
    left.mkdir(parents=True)
    (left / "old").symlink_to(elsewhere)
    files.remove_stale_folders(tmp_path / "sent")
    assert (elsewhere / "own").read_bytes() == CANARY


def test_a_full_disk_leaves_the_old_file_and_is_named(tmp_path: Path) -> None:
    target = tmp_path / "report.png"
    target.write_bytes(b"old")

    def fill() -> None:
        with files.new_file(target) as part:
            part.write_bytes(b"half")
            raise OSError(errno.ENOSPC, "No space left on device")

    with pytest.raises(OSError, match=r"report\.png"):
        fill()
    assert target.read_bytes() == b"old"
    assert [path.name for path in tmp_path.iterdir()] == ["report.png"]


def opened(kind: str, folder: Path) -> None:
    """Open the ledger or the marks of a folder."""
    if kind == "ledger":
        with Ledger(folder):
            return
    Store(folder / "marks.sqlite").close()


@pytest.mark.parametrize("end", ["", *files.SQLITE_LOG_SUFFIXES])
@pytest.mark.parametrize("kind", ["ledger", "marks"])
def test_databases_that_are_links_are_refused(tmp_path: Path, canary: Path, kind: str, end: str) -> None:
    name = {"ledger": LEDGER_FILE, "marks": "marks.sqlite"}[kind] + end
    for place in (canary, tmp_path / "nowhere"):
        (tmp_path / name).symlink_to(place)
        with pytest.raises(InputError, match="a link"):
            opened(kind, tmp_path)
        (tmp_path / name).unlink()
    assert canary.read_bytes() == CANARY
    assert not (tmp_path / "nowhere").exists()


@pytest.mark.parametrize("application", [0, 7])
@pytest.mark.parametrize("kind", ["ledger", "marks"])
def test_another_programs_database_is_not_changed(tmp_path: Path, kind: str, application: int) -> None:
    file = tmp_path / {"ledger": LEDGER_FILE, "marks": "marks.sqlite"}[kind]
    with sqlite3.connect(file) as db:
        db.execute("CREATE TABLE own (a)")
        db.execute(f"PRAGMA application_id = {application}")
    db.close()
    before = file.read_bytes()
    with pytest.raises(InputError, match="another program"):
        opened(kind, tmp_path)
    assert file.read_bytes() == before


def test_files_that_begin_with_a_dot_are_no_content(tmp_path: Path) -> None:
    for name in ("b.png", "a.PNG", "._a.png", ".DS_Store", "c.txt"):
        (tmp_path / name).write_bytes(b"")
    for name in ("d", ".e"):
        (tmp_path / name).mkdir()
    assert [path.name for path in files.list_files(tmp_path, (".png",))] == ["a.PNG", "b.png"]
    assert [path.name for path in files.list_files(tmp_path)] == ["a.PNG", "b.png", "c.txt"]
    assert [path.name for path in files.folders_in(tmp_path)] == ["d"]


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-16-be", "utf-32"])
def test_texts_are_read_by_their_marks(tmp_path: Path, encoding: str) -> None:
    mark = {"utf-16-le": b"\xff\xfe", "utf-16-be": b"\xfe\xff"}.get(encoding, b"")
    (tmp_path / "a.txt").write_bytes(mark + "v 1 2 3\nΩ\n".encode(encoding))
    assert files.read_text(tmp_path / "a.txt") == "v 1 2 3\nΩ\n"
