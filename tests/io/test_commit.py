"""The stamp of a table: the date, and the commit where there is one."""

from __future__ import annotations

import re
import subprocess
from datetime import date
from pathlib import Path

from getagrip.io.plugins import commit, date_and_commit


def git(folder: Path, *words: str) -> None:
    name = ("-c", "user.name=a", "-c", "user.email=a@b.c")
    subprocess.run(["git", *name, *words], cwd=folder, check=True, capture_output=True)


def test_a_stamp_begins_with_the_date() -> None:
    assert date_and_commit().startswith(date.today().isoformat())


def test_a_commit_is_named_and_changes_of_its_files_are_marked(tmp_path: Path) -> None:
    assert commit(tmp_path) is None
    git(tmp_path, "init", "-q")
    inside = tmp_path / "package"
    inside.mkdir()
    (inside / "a.py").write_text("1")
    assert commit(inside) is None  # not of this repository, as in an environment within it
    git(tmp_path, "add", ".")
    git(tmp_path, "commit", "-q", "-m", "first")
    clean = commit(inside)
    assert clean is not None
    assert re.fullmatch("[0-9a-f]{7,}", clean)
    (tmp_path / "elsewhere").write_text("1")
    assert commit(inside) == clean
    (inside / "a.py").write_text("2")
    assert commit(inside) == f"{clean} with uncommitted changes"
