"""The page of all tables, in a real browser, from disk."""

from __future__ import annotations

import runpy
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from benchmarks import store
from helpers.annotation import IN_BROWSER
from helpers.environment import ROOT

pytestmark = IN_BROWSER


@pytest.fixture
def page(browser: Any, tmp_path: Path) -> Iterator[Any]:
    """Showing one table; what goes wrong on it fails the test."""
    path = tmp_path / "explore.html"
    explorer = runpy.run_path(str(ROOT / "scripts" / "explorer.py"))
    assert explorer["MARKER"] in (ROOT / "docs" / "explore.md").read_text(encoding="utf-8")
    html = "\n".join(explorer["explorer"]().splitlines()[1:-1])
    path.write_text(f"<!doctype html><meta charset='utf-8'><body>{html}</body>", encoding="utf-8")
    tab, faults = browser.new_page(), list[str]()
    tab.on("pageerror", lambda error: faults.append(str(error)))
    tab.goto(f"{path.as_uri()}#dexycb-mask-noise")
    tab.wait_for_selector("body[data-ready=explorer]")
    yield tab
    tab.close()
    assert not faults


def labels(page: Any) -> list[str]:
    """The rows that are listed."""
    return [cell.inner_text() for cell in page.query_selector_all("#rows td:first-child")]


def test_rows_are_sorted_found_and_drawn(page: Any) -> None:
    table = store.read("dexycb-mask-noise")
    assert labels(page) == [row["label"] for row in table.rows]
    assert page.locator("#plot rect").count() == len(table.rows)
    assert table.made["commit"] in page.inner_text("#about")

    page.get_by_role("button", name="ADD sym., %", exact=True).click()
    best = max(table.rows, key=lambda row: row["add_sym"][0])
    assert labels(page)[0] == best["label"]
    page.fill("#words", "one-dof 4 px")
    assert labels(page) == ["one-dof, 4 px"]


def test_differences_and_all_tables_are_shown(page: Any) -> None:
    page.check("#differences")
    assert labels(page)[0] == "one-dof, 0.5 px − one-dof, none"
    page.select_option("#table", index=0)
    page.wait_for_function("document.querySelectorAll('#rows tr').length > 100")
    assert "soft-hinge · dexycb-methods" in labels(page)
