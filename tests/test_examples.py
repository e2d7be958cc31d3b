"""The examples run as they stand, and so does the Python in the README."""

from __future__ import annotations

import ast
import os
import re
import runpy
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import getagrip
from getagrip.clip import Clip, Masks
from getagrip.fitting.methods import METHODS
from getagrip.fitting.options import Options
from getagrip.result import Reconstruction
from getagrip.synthetic.scene_options import SceneOptions
from helpers.environment import DATA, ROOT, needs
from helpers.pages import python, targets

EXAMPLES = {path.name[:2]: path for path in sorted((ROOT / "examples").glob("*.py"))}


Call = Callable[..., str]

FEW = 16
QUICK = ("--clips", "1", "--workers", "2", "--inits", "6")
SMALL: dict[str, Any] = {"frames": 8, "size": (320, 240), "focal": 300.0}
ON_SMALL_CLIPS = """
import runpy
from dataclasses import replace
from getagrip.synthetic.scene_options import SYNTHETIC_PRESETS
SYNTHETIC_PRESETS["clean"] = replace(SYNTHETIC_PRESETS["clean"], **{small})
runpy.run_path({script!r}, run_name=__name__)
"""
"""A script whose benchmark, also in the processes that import it, has small clips."""


@pytest.fixture
def printed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Call:
    """Run a script in a folder of its own, in this process, on short clips; returns what it prints.

    Its searches begin at few initial poses.
    """
    full = getagrip.reconstruct

    def searched_briefly(clip: Clip, masks: Masks, options: Options | None = None, **more: Any) -> Reconstruction:
        return full(clip, masks, replace(options or Options(), inits=FEW), **more)

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(getagrip, "reconstruct", searched_briefly)
    monkeypatch.setattr(getagrip, "synthesise", partial(getagrip.synthesise, options=SceneOptions(**SMALL)))
    before = dict(METHODS)

    def call(script: Path, *args: object) -> str:
        monkeypatch.setattr(sys, "argv", [str(script), *map(str, args)])
        try:
            runpy.run_path(str(script), run_name="__main__")
        finally:
            METHODS.clear()
            METHODS.update(before)
        return capsys.readouterr().out

    return call


def in_a_process(script: Path, folder: Path, *args: object) -> str:
    """Run a script in a folder of its own, in a process of its own; returns what it prints."""
    environment = os.environ | {"PYTHONPATH": str(ROOT / "src")}
    command = [sys.executable, str(script), *map(str, args)]
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def number_after(label: str, text: str) -> float:
    """The first number after a label in a text."""
    found = re.search(re.escape(label) + r"\s*([-\d.]+)", text)
    assert found, text
    return float(found[1])


def test_they_are_numbered() -> None:
    assert sorted(EXAMPLES) == [f"{n:02d}" for n in range(1, 11)]


@pytest.mark.parametrize("script", EXAMPLES.values(), ids=lambda script: script.stem)
def test_each_says_how_it_is_called_and_has_a_line_with_a_picture(script: Path) -> None:
    assert f"\n    python examples/{script.name}" in (ast.get_docstring(ast.parse(script.read_text("utf-8"))) or "")
    listed = {target for target in targets(ROOT / "examples" / "README.md") if script.stem in target}
    assert listed == {script.name, f"../docs/images/examples/{script.stem}.webp"}


@pytest.mark.parametrize("script", EXAMPLES.values(), ids=lambda script: script.stem)
def test_pictures_are_small(script: Path) -> None:
    assert (ROOT / "docs" / "images" / "examples" / f"{script.stem}.webp").stat().st_size <= 40_000


@pytest.mark.slow
def test_a_synthetic_clip(tmp_path: Path, printed: Call) -> None:
    assert number_after("mask IOU", printed(EXAMPLES["01"], "out")) > 0.95
    assert (tmp_path / "out" / "report.png").stat().st_size > 10_000


@pytest.mark.slow
def test_own_arrays(tmp_path: Path, printed: Call) -> None:
    assert number_after("mask IOU", printed(EXAMPLES["02"], "out")) > 0.9
    assert (tmp_path / "out" / "poses.npz").is_file()


@pytest.mark.slow
def test_a_rehearsal_for_a_video_of_ones_own(tmp_path: Path, printed: Call) -> None:
    clip, masks = getagrip.synthesise("mug", 0)
    images = np.zeros((len(clip), *SMALL["size"][::-1], 3), dtype=np.uint8)
    getagrip.write_clip(clip, masks, tmp_path / "clip", images)
    assert number_after("focal length", printed(EXAMPLES["03"], "clip", "rehearsal")) == SMALL["focal"]
    with np.load(tmp_path / "rehearsal" / "joints.npz") as stored:
        assert stored["joints"].shape == (len(clip), 21, 3)
    assert len(list((tmp_path / "rehearsal" / "masks").glob("*.png"))) == len(clip)
    assert {path.name for path in (tmp_path / "rehearsal").iterdir()} >= {"video.mp4", "object.obj"}


@pytest.mark.slow
def test_the_files_of_an_estimator(tmp_path: Path, printed: Call) -> None:
    said = printed(EXAMPLES["04"], "out")
    assert "the generic hand fitted to the estimator's joints" in said
    assert number_after("mask IOU", said) > 0.9
    clip = getagrip.read_clip(tmp_path / "out" / "clip")
    assert getagrip.read_masks(clip).hand is not None


@pytest.mark.slow
def test_a_folder_of_clips_instead_of_a_dataset(tmp_path: Path, printed: Call) -> None:
    clip, masks = getagrip.synthesise("can", 0)
    getagrip.write_clip(clip, masks, tmp_path / "clips" / clip.name)
    said = printed(EXAMPLES["05"], "clips")
    assert f"{clip.name}: a can in a right hand, {len(clip)} frames" in said
    assert number_after("mask IOU", said) > 0.9


@pytest.mark.slow
def test_a_dataset_that_is_absent_is_skipped(tmp_path: Path) -> None:
    assert in_a_process(EXAMPLES["05"], tmp_path, "nowhere").startswith("skipped: name the folder")


@pytest.mark.slow
@needs(DATA / "dexycb")
def test_a_real_dataset(printed: Call) -> None:
    assert number_after("mask IOU", printed(EXAMPLES["05"], DATA / "dexycb", DATA / "ycb")) > 0.9


@pytest.mark.slow
@pytest.mark.long
def test_a_method_of_ones_own_in_the_benchmark(tmp_path: Path) -> None:
    script = tmp_path / "small.py"
    script.write_text(ON_SMALL_CLIPS.format(small=SMALL, script=str(EXAMPLES["07"])), encoding="utf-8")
    # The benchmark's processes import it.
    assert "coarse-static" in in_a_process(script, tmp_path, "out", *QUICK)
    assert "coarse-static" in (tmp_path / "out" / "methods.md").read_text()


@pytest.mark.slow
def test_an_energy_term_of_ones_own(printed: Call) -> None:
    out = printed(EXAMPLES["06"])
    usual, measured = (number_after(f"{label}: axis", out) for label in ("soft hinge", "soft hinge with a sensor"))
    assert measured < usual


@pytest.mark.slow
def test_a_batch_with_a_damaged_clip(tmp_path: Path, printed: Call) -> None:
    said = printed(EXAMPLES["08"], "out", "--inits", FEW, "--workers", 1)
    assert "2 done, 0 already done, 1 failed" in said
    assert "1 done, 2 already done, 0 failed" in said
    assert "exit status 1, then 0" in said
    assert said.count(" done: IOU ") == 3
    assert (tmp_path / "out" / "results" / "summary.csv").is_file()


@pytest.mark.slow
def test_a_dataset_for_a_robot(tmp_path: Path, printed: Call) -> None:
    assert number_after("frames; the object moves", printed(EXAMPLES["09"], "out")) > 0.0
    formats = {path.name for path in (tmp_path / "out").iterdir()}
    libraries = {"lerobot": "pyarrow", "mcap": "mcap"}
    assert formats == {"csv", "npz"} | {name for name, library in libraries.items() if find_spec(library)}


@pytest.mark.slow
def test_poses_of_another_system_are_refined(tmp_path: Path, printed: Call) -> None:
    said = printed(EXAMPLES["10"], "out")
    theirs, refined = (number_after("ADD sym.", line) for line in said.splitlines())
    assert refined < theirs / 2
    assert (tmp_path / "out" / "refined.npz").is_file()


@pytest.mark.slow
def test_the_python_in_the_readme(tmp_path: Path, printed: Call) -> None:
    (code,) = python(ROOT / "README.md", "run")
    script = tmp_path / "readme.py"
    script.write_text(code, encoding="utf-8")
    printed(script)
    assert (tmp_path / "report.png").is_file()
