"""Folders are listed by one rule, and texts are read by their marks."""

from __future__ import annotations

from pathlib import Path

import pytest

from getagrip.io import files


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
