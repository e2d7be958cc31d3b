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
