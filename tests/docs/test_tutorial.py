"""The tutorial's commands, in their order, as they are typed; only smaller."""

from __future__ import annotations

import runpy
import sys
from dataclasses import replace
from importlib import import_module
from pathlib import Path

import pytest

from getagrip.cli import demo
from getagrip.clip import read_clip
from getagrip.report.pictures.panels import AXIS_COLOUR
from getagrip.result import read_result
from getagrip.synthetic import scene_options
from getagrip.synthetic.scene import clip_name
from getagrip.synthetic.scene_options import SYNTHETIC_PRESETS
from helpers.environment import ROOT, Run
from helpers.pages import commands, pixels_of, read_picture

TUTORIAL = ROOT / "docs" / "tutorial.md"
SMALLER = {
    "reconstruct": ("--inits", "8", "--frames", "6", "--sampled-only"),
    "bench": ("--inits", "6", "--clips", "1", "--workers", "1"),
    "report": ("--index-only",),
}
FRAMES = 10
WORDS = {"30": str(FRAMES), "600": "300"}
"""Frames and focal length of the demo's clip."""
SMALL = {"frames": FRAMES, "size": (320, 240), "focal": 300.0}
SERVED = {"view", "annotate"}  # they serve a page until they are interrupted
INCOMPLETE = ("clip", "new")  # masks and hands come later


def follow(section: str, run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    """Type the commands of a section."""
    for program, *words in commands(TUTORIAL, section):
        if program == "python":
            monkeypatch.setattr(sys, "argv", [str(ROOT / words[0]), *words[1:]])
            runpy.run_path(str(ROOT / words[0]), run_name="__main__")
        elif words[0] not in SERVED and words[0].islower():
            assert program == "getagrip"
            status, _, err = run(*(WORDS.get(word, word) for word in words), *SMALLER.get(words[0], ()))
            assert status == (3 if tuple(words[:2]) == INCOMPLETE else 0), err


@pytest.mark.slow
@pytest.mark.long
def test_the_demo_and_a_video_of_ones_own(tmp_path: Path, run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(scene_options, "DEMO_SCENE_OPTIONS", replace(scene_options.DEMO_SCENE_OPTIONS, **SMALL))
    (words,) = [words for words in commands(TUTORIAL, "The demo") if words[:2] == ["getagrip", "demo"]]
    assert run(*words[1:])[0] == 0
    again = read_result(
        tmp_path / "out" / "demo" / clip_name(demo.DEMO_CATEGORY, demo.DEMO_SEED, scene_options.DEMO_SCENE_OPTIONS)
    )[0]
    with monkeypatch.context() as patch:  # it can be run again; the same would be found and drawn
        patch.setattr(import_module("getagrip.reconstruct"), "reconstruct", lambda *_, **__: again)
        patch.setattr("getagrip.report.pictures.result_picture.write_report", lambda *given: given[3])
        patch.setattr("getagrip.report.pages.write_page", lambda *given: given[3])
        assert run(*words[1:])[0] == 0
    the_mug_is_found(tmp_path / "out" / "demo")
    follow("Hands and masks of your own", run, monkeypatch)
    assert (tmp_path / "results" / "index.html").is_file()
    assert list((tmp_path / "scene").rglob("*.glb"))
    assert list((tmp_path / "table").rglob("*.csv"))


def the_mug_is_found(out: Path) -> None:
    """By the demo, and shown on its page."""
    name = clip_name(demo.DEMO_CATEGORY, demo.DEMO_SEED, scene_options.DEMO_SCENE_OPTIONS)
    clip = read_clip(out / "clips" / name)
    result, record = read_result(out / name)
    assert result.clip == clip.name
    assert record["metrics"]["add_success"] == 1.0
    assert pixels_of(read_picture(out / "report.png"), AXIS_COLOUR) > 500
    assert f'"clip":"{name}"' in (out / "report.html").read_text("utf-8")


@pytest.mark.slow
def test_a_benchmark(tmp_path: Path, run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(SYNTHETIC_PRESETS, "clean", replace(SYNTHETIC_PRESETS["clean"], **SMALL))
    follow("A benchmark", run, monkeypatch)
    assert (tmp_path / "out" / "bench" / "methods.md").is_file()
    assert (tmp_path / "out" / "bench" / "index.html").is_file()
