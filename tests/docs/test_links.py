"""No link of the documentation leads nowhere, and every page can be reached. No network is asked."""

from __future__ import annotations

import re
from pathlib import Path
from urllib.parse import unquote, urlsplit

import pytest

from helpers.environment import ROOT
from helpers.pages import PAGES, anchors, targets

DOCS = ROOT / "docs"


def broken(page: Path) -> list[str]:
    """A page's links to files or headings that are not there."""
    wrong = []
    for target in targets(page):
        parts = urlsplit(target)
        if parts.scheme:
            continue
        path = (page.parent / unquote(parts.path)).resolve() if parts.path else page
        if not path.exists() or (parts.fragment and parts.fragment not in anchors(path)):
            wrong.append(target)
    return wrong


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_link_leads_somewhere(page: Path) -> None:
    assert not broken(page)


def test_links_that_lead_nowhere_are_found(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text(
        "# A b, `c`\n\n# A b, `c`\n\n[1](#a-b-c) [2](#a-b-c-1) [3](#a) [4](no.md) ![5](no.png) [6](page.md#b)\n"
    )
    assert broken(page) == ["#a", "no.md", "no.png", "page.md#b"]


def test_the_navigation_has_every_page() -> None:
    blocks = re.findall(r"```{toctree}\n(.*?)```", (DOCS / "index.md").read_text(encoding="utf-8"), re.DOTALL)
    lines = [line for block in blocks for line in block.splitlines() if line and not line.startswith(":")]
    listed = [line.rpartition("<")[2].rstrip(">") for line in lines]  # a page, or Title <page>
    assert sorted(listed) == sorted(page.stem for page in DOCS.glob("*.md") if page.stem != "index")


def test_every_picture_is_shown() -> None:
    shown = {
        (page.parent / target).resolve()
        for page in PAGES
        for target in targets(page)
        if target.endswith((".png", ".webp"))
    }
    assert {path for path in (DOCS / "images").rglob("*") if path.is_file()} <= shown


def test_pages_that_messages_name_are_there() -> None:
    sources = (path.read_text(encoding="utf-8") for path in (ROOT / "src").rglob("*.py"))
    named = {name for text in sources for name in re.findall(r"\bdocs/[\w-]+\.md", text)}
    assert {name for name in named if not (ROOT / name).is_file()} == set()
