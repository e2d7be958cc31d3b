"""The notebook's cells run in order, and what the last line of each gives is short, with a table, picture or page."""

from __future__ import annotations

import ast
import json
import pickle
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import getagrip
from getagrip.errors import UsageError
from getagrip.io.array_data import MAX_REPR_LINES
from getagrip.io.terminal import progress_callback
from helpers.clips import small_clip
from helpers.environment import ROOT
from helpers.results import true_result

NOTEBOOK = ROOT / "examples" / "getagrip.ipynb"
SHORT = """
from functools import partial
import getagrip
full = getagrip.reconstruct
getagrip.reconstruct = lambda clip, masks, **more: full(clip, masks, getagrip.Options(inits=4), **more)
small = getagrip.SceneOptions(frames=6, size=(640, 480), focal=600.0)
getagrip.synthesise = partial(getagrip.synthesise, options=small)
"""
"""Makes what the notebook does take seconds."""


def cells() -> list[ast.Module]:
    notebook = json.loads(NOTEBOOK.read_text(encoding="utf-8"))
    assert all(not cell.get("outputs") for cell in notebook["cells"])
    return [ast.parse(cell["source"]) for cell in notebook["cells"] if cell["cell_type"] == "code"]


@pytest.mark.slow
@pytest.mark.long
def test_the_cells_run_and_show_short_values(tmp_path: Path) -> None:
    code = SHORT
    for n, cell in enumerate(cells()):
        if isinstance(cell.body[-1], ast.Expr):
            cell.body[-1] = ast.parse(f"shown_{n} = {ast.unparse(cell.body[-1])}").body[0]
        code += ast.unparse(cell) + "\n"
    names = re.findall(r"^(shown_\d+) = ", code, re.MULTILINE)
    assert len(names) >= 8
    code += f"""
for each in ({", ".join(names)}):
    html, png = (getattr(each, name, lambda: "")() or "" for name in ("_repr_html_", "_repr_png_"))
    print(type(each).__name__, len(repr(each).splitlines()), len(html), len(png))
"""
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    shown = {name: [int(n) for n in rest] for name, *rest in map(str.split, done.stdout.splitlines())}
    assert {"Clip", "Masks", "Reconstruction", "Figure", "HtmlPage", "Evaluation"} <= shown.keys()
    assert [name for name, (lines, _, _) in shown.items() if lines > MAX_REPR_LINES] == []
    assert all(shown[name][1] > 500 for name in ("Clip", "Masks", "Reconstruction", "HtmlPage", "Evaluation"))
    assert shown["Figure"][2] > 10_000
    assert (tmp_path / "mug-in-hand" / "about.json").is_file()


def test_the_table_keeps_its_width_beside_a_wide_picture() -> None:
    html = true_result(small_clip()[0], None).made_of(*small_clip())._repr_html_()
    assert "flex-wrap:wrap" in html
    assert "flex:1 1 24em" in html
    assert "flex:none" not in html


def test_it_takes_the_default_search_and_the_wheel_s_test_asserts_its_error() -> None:
    """A shorter one may miss the pose, and has no probability."""
    assert "inits" not in NOTEBOOK.read_text(encoding="utf-8")
    assert 'evaluation.metrics["add_mm"] < ' in (ROOT / "scripts" / "try_wheel.py").read_text(encoding="utf-8")


def test_no_value_is_a_wall() -> None:
    clip, masks = small_clip()
    long = replace(clip, provenance={f"topic {n}": "<b>text</b> " * 40 for n in range(60)})
    for data in (clip, long, masks, clip.hand, clip.mesh, true_result(clip, None)):
        assert len(repr(data).splitlines()) <= MAX_REPR_LINES, type(data)
        assert repr(data).startswith(f"{type(data).__name__}(")
        html = data._repr_html_()
        assert "<table>" in html
        assert "<b>text" not in html
        assert html.isascii()


def test_a_result_is_shown_with_what_it_was_made_of() -> None:
    clip, masks = small_clip()
    result = true_result(clip, None)
    with pytest.raises(UsageError, match="missing clip"):
        result.plot()
    assert result.made_of(clip, masks).inputs == (clip, masks)
    assert result.plot()._repr_png_().startswith(b"\x89PNG")  # type: ignore[attr-defined]
    assert "iframe" in result.show(height=300)._repr_html_()
    copy = pickle.loads(pickle.dumps(result))
    assert copy == result
    assert copy.inputs is None


WRONG: dict[str, Any] = {
    "choose from masks$": lambda: getagrip.reconstruct(*small_clip()[:1], mask=0),  # type: ignore[call-arg]
    r"'inits'; choose from options=Options\(inits=\.\.\.\)": lambda: getagrip.reconstruct(small_clip()[0], inits=3),  # type: ignore[call-arg]
    r"choose from options=SceneOptions\(frames=\.\.\.\)": lambda: getagrip.synthesise("mug", frames=3),  # type: ignore[call-arg]
    "unknown argument of Options 'initss'; choose from inits": lambda: getagrip.Options(initss=1),  # type: ignore[call-arg]
    "unknown argument of Masks 'objects'; choose from object": lambda: getagrip.Masks(objects=np.zeros(1)),  # type: ignore[call-arg]
    "unknown argument of read_mesh 'unit'; choose from path": lambda: getagrip.read_mesh(unit="mm"),  # type: ignore[call-arg]
}


@pytest.mark.parametrize("message", WRONG)
def test_a_wrong_argument_names_the_right_one(message: str) -> None:
    with pytest.raises(UsageError, match=message):
        WRONG[message]()


def test_progress_is_a_bar_a_function_or_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    with progress_callback(None, "a") as nothing, progress_callback(False, "a") as neither:
        assert nothing is neither is None
    said: list[tuple[str, float]] = []
    with progress_callback(lambda *stage: said.append(stage), "a") as call:
        assert call is not None
        call("search", 0.5)
    assert said == [("search", 0.5)]
    with progress_callback(True, "a") as bar:
        assert bar is not None
        bar("search", 0.5)
    assert capsys.readouterr().out == ""


def test_progress_in_a_notebook_without_widgets_is_a_line(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("getagrip.io.terminal._in_notebook", lambda: True)
    monkeypatch.setattr("getagrip.io.terminal.find_spec", lambda _: None)
    with progress_callback(True, "mug") as line:
        assert line is not None
        line("search", 0.5)
    assert "\r 50% mug: search" in capsys.readouterr().out
