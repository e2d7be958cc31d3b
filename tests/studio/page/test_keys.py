"""No key of the page means two things: not even in its two views, between which people change without looking."""

from __future__ import annotations

import re

from helpers.environment import ROOT

PAGE = ROOT / "src" / "getagrip" / "studio" / "page"
ALIKE = {"Home", "End", "Escape", "Delete", "Backspace", "u"}
"""The first and last frame; choose nothing; delete what is chosen; undo: the same in both."""


def keys(name: str, table: str = "KEYS") -> set[str]:
    """Those of a table in a file of the page."""
    text = (PAGE / name).read_text("utf-8")
    (body,) = re.findall(rf"const {table} = \{{\n(.*?)\n\}};", text, re.DOTALL)
    return {*re.findall(r'^  "(.+?)":', body, re.MULTILINE)}


def states() -> set[str]:
    return {*re.findall(r'key: "(.)"', (PAGE / "states.js").read_text("utf-8"))}


def test_no_key_means_one_thing_in_a_view_and_another_in_the_other() -> None:
    marking, labelling, everywhere = keys("grasps.js") | states(), keys("labelling.js"), keys("page.js", "COMMON")
    assert len(states()) == 4
    assert {"s", "e"} < marking
    assert {"j", "o"} < labelling
    assert marking & labelling == ALIKE
    assert labelling & everywhere == {"l"}  # changes the view, in both
    assert not marking & everywhere
    assert not keys("grasps.js") & states()


def test_the_page_names_every_key_of_its_tables() -> None:
    html = (PAGE / "index.html").read_text("utf-8")
    for key in (keys("labelling.js") | keys("grasps.js") | states()) - {"Home", "End", "Escape", "Delete", "Backspace"}:
        assert f"<kbd>{key}</kbd>" in html, key
