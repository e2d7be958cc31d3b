"""The Python in the pages: names that it imports exist, and what is marked ``python run`` runs."""

from __future__ import annotations

import ast
import importlib.util
from dataclasses import replace
from pathlib import Path

import pytest

import getagrip
from getagrip.clip import input_sha256, write_clip
from helpers.environment import ROOT
from helpers.pages import PAGES, python
from helpers.results import true_result
from helpers.scenes import SHORT, scene

STORY = ("formats", "grasps", "metrics")
"""Pages whose Python is about one clip and its result, one page after the other."""


@pytest.mark.slow  # since much is loaded
@pytest.mark.parametrize("page", [page for page in PAGES if python(page)], ids=lambda page: page.stem)
def test_what_is_imported_is_there(page: Path) -> None:
    for code in python(page):
        for node in ast.walk(ast.parse(code)):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("getagrip"):
                module = importlib.import_module(str(node.module))
                for name in (name.name for name in node.names):
                    assert hasattr(module, name) or importlib.util.find_spec(f"{node.module}.{name}"), name


@pytest.mark.slow
def test_the_python_of_the_pages(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A clip is written, its result read, its stable grasps found and its metrics taken."""
    monkeypatch.chdir(tmp_path)
    clip, masks = scene("can", 0, SHORT)
    clip = replace(clip, name="pour-01")
    made = write_clip(clip, masks, tmp_path / "made")
    result = getagrip.write_result(true_result(clip, None), tmp_path / "out" / "pour-01", input_sha256(made))
    names = {"clip": clip, "masks": masks, "images": None, "folders": [result]}
    for page in STORY:
        for code in python(ROOT / "docs" / f"{page}.md", "run"):
            exec(compile(code, page, "exec"), names)
    assert names["result"].frames == clip.frames
    assert len(names["matrix"]) == len(clip)
    assert names["evaluations"][0].metrics["add_mm"] < 1e-6


def test_all_that_is_marked_is_run() -> None:
    marked = {page.stem for page in PAGES if python(page, "run")}
    assert marked == {*STORY, "README"}  # tests/test_examples.py runs the README's
