"""Tables of names from strangers: no cell is a formula, and reading gives the names back."""

from __future__ import annotations

import csv
import io
import re
from pathlib import Path

import pytest

import getagrip
from getagrip.io.files import csv_rows
from getagrip.io.terminal import CsvTable, escape_cell, unescape_cell

FORMULAS = ("=cmd|'calc'!A0", "+1", "-1", "@SUM(1)", "\t=1", "\r=1", "\n=1", "'=1", "''+1", "=", '=a,"b"')
PLAIN = ("", "mug", "'mug'", "a=1", "5", "'", "left hand")


@pytest.mark.parametrize("text", [*FORMULAS, *PLAIN])
def test_texts_are_never_formulas_and_are_read_back(text: str) -> None:
    stream = io.StringIO(newline="")
    CsvTable(stream).write_rows([["name", "number"], [text, -1.5]])
    (_, (cell, number)) = csv.reader(io.StringIO(stream.getvalue(), newline=""))
    assert cell[:1] not in {*"=+-@\t\r\n"} or not cell
    assert (cell == text) == (text in PLAIN)
    assert number == "-1.5"
    _, [(_, row)] = csv_rows(Path("x.csv"), stream.getvalue().encode(), "a table")
    assert row == {"name": text, "number": "-1.5"}
    assert unescape_cell(escape_cell(text)) == text


def test_other_writers_have_numbers_only() -> None:
    """Poses and BOP's results are formatted by their writers, which know what is a number."""
    files = Path(getagrip.__file__).parent.rglob("*.py")
    writers = {path.name for path in files if re.search(r"csv\.(Dict)?[wW]riter", path.read_text("utf-8"))}
    assert writers == {"terminal.py", "scene.py", "object_poses.py"}
