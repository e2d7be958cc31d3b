"""The tutorial's commands, in their order, as they are typed; only smaller."""

from __future__ import annotations

import runpy
import sys
from pathlib import Path

import pytest

from helpers.command_line import Run
from helpers.pages import commands
from helpers.paths import ROOT

TUTORIAL = ROOT / "docs" / "tutorial.md"
SMALLER = {
    "reconstruct": ("--inits", "8", "--frames", "6", "--sampled-only"),
    "bench": ("--inits", "6", "--clips", "1", "--workers", "1"),
    "report": ("--index-only",),
}
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
            status, _, err = run(*words, *SMALLER.get(words[0], ()))
            assert status == (1 if tuple(words[:2]) == INCOMPLETE else 0), err


@pytest.mark.slow
def test_the_demo_and_a_video_of_ones_own(tmp_path: Path, run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (words,) = [words for words in commands(TUTORIAL, "The demo") if words[:2] == ["getagrip", "demo"]]
    assert run(*words[1:])[0] == 0
    follow("A video of your own", run, monkeypatch)
    assert (tmp_path / "results" / "index.html").is_file()
    assert list((tmp_path / "scene").rglob("*.glb"))
    assert list((tmp_path / "table").rglob("*.csv"))


@pytest.mark.slow
def test_a_benchmark(tmp_path: Path, run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    follow("A benchmark", run, monkeypatch)
    assert (tmp_path / "out" / "bench" / "methods.md").is_file()
    assert (tmp_path / "out" / "bench" / "index.html").is_file()
