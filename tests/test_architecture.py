"""The architecture page is what the linter's layers and the rooms' docstrings say."""

from __future__ import annotations

import runpy

from helpers.paths import ROOT


def test_the_table_of_parts_is_up_to_date() -> None:
    page = runpy.run_path(str(ROOT / "scripts" / "parts.py"))["page"]
    written = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    assert written == page(), "python scripts/parts.py writes the table anew"
