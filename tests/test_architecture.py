"""The architecture page is what the linter's layers and the rooms' docstrings say."""

from __future__ import annotations

import runpy
import tokenize

from helpers.environment import ROOT


def test_the_table_of_parts_is_up_to_date() -> None:
    page = runpy.run_path(str(ROOT / "scripts" / "parts.py"))["page"]
    written = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    assert written == page(), "python scripts/parts.py writes the table anew"


def test_few_values_have_any_type() -> None:
    uses = dict[str, int]()
    for file in sorted((ROOT / "src" / "getagrip").rglob("*.py")):
        with tokenize.open(file) as stream:
            words = [token for token in tokenize.generate_tokens(stream.readline) if token.string == "Any"]
        uses[file.name] = sum(not word.line.lstrip().startswith(("from ", "import ")) for word in words)
    assert sum(uses.values()) <= 60, {name: count for name, count in uses.items() if count}


PACKAGE = ROOT / "src" / "getagrip"
TABLES = {
    "cli", "export", "bench/figures", "bench/sources", "fitting/energy", "fitting/evidence", "fitting/motion",
    "readers/cameras", "readers/datasets", "readers/trackers", "report/pages/parts", "studio/page",
}  # fmt: skip
"""Folders that are tables: an entry each, of any number and as small as it is."""


def test_the_house_can_be_held_in_mind() -> None:
    """Rooms of at most 12 entries, files of one subject: of 60 to 600 lines."""
    folders = [path for path in (PACKAGE, *PACKAGE.rglob("*")) if path.is_dir() and path.name != "__pycache__"]
    rooms = [folder for folder in folders if folder.parent == PACKAGE]
    assert len(rooms) <= 18
    entries = {
        folder.relative_to(PACKAGE).as_posix(): [path for path in folder.iterdir() if path.name != "__pycache__"]
        for folder in folders
        if folder != PACKAGE
    }
    assert {name: len(found) for name, found in entries.items() if len(found) > 12 and name not in TABLES} == {}
    lines = {
        path.relative_to(PACKAGE).as_posix(): len(path.read_text("utf-8").splitlines())
        for path in PACKAGE.rglob("*.py")
        if not path.name.startswith("__")
    }
    assert {name: count for name, count in lines.items() if count > 600} == {}
    small = {name: count for name, count in lines.items() if count < 60}
    assert {name: count for name, count in small.items() if name.rpartition("/")[0] not in TABLES} == {}
