"""Wrong calls of ``getagrip bench`` are refused, and its help names what there is."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path

import pytest

from getagrip.bench.ablations import ABLATIONS
from getagrip.bench.grasps import GraspTrial
from getagrip.bench.options import ABLATION_NAMES
from getagrip.bench.sequences.timelines import ALL_NOISE_LEVELS, TIMELINE_NOISE_LEVELS
from getagrip.cli import main
from getagrip.cli.bench import BENCHES
from getagrip.synthetic.noise import NOISE_PRESETS
from getagrip.synthetic.scene_options import SYNTHETIC_PRESETS
from helpers.environment import Run


@pytest.mark.parametrize(
    ("args", "word"),
    [
        (("--init", "clusters"), "--init"),
        (("--workers", "0"), "--workers"),
        (("--clips", "0"), "--clips"),
        (("--split", "train"), "--split"),
        (("--root", "x"), "--root"),
        (("--preset", "wild"), "--preset"),
        (("--ablation", "none"), "choose from physical"),
        (("--json", "/dev/null/x.json"), "--json"),
        (("--inits", "0"), "inits"),
        (("--with", "x=nowhere"), "--with"),
        (("--with", "static=."), "another name than those of the methods"),
        (("--with", "x=.", "--ablation", "scale"), "--with"),
        (("--refine",), "missing --with"),
    ],
)
def test_wrong_calls_are_refused(can_and_box: Path, tmp_path: Path, run: Run, args: tuple[str, ...], word: str) -> None:
    status, _, err = run("bench", can_and_box, "--out", tmp_path / "out", *args)
    assert status == 2
    assert word in err


def test_without_clips_nothing_is_written(tmp_path: Path, run: Run) -> None:
    out = tmp_path / "out"
    status, _, err = run("bench", tmp_path / "nowhere", "--out", out)
    assert (status, "nowhere'; choose from synthetic, dexycb" in err) == (2, True)
    (tmp_path / "empty").mkdir()
    status, _, err = run("bench", tmp_path / "empty", "--out", out)
    assert (status, "no clip.json" in err) == (1, True)
    assert main(["bench", "dexycb", "--out", str(out)]) == 2
    assert not out.exists()


@pytest.mark.parametrize(
    ("preset", "message"),
    [
        ("tame", "getagrip: unknown --preset 'tame'; choose from clean"),
        ("hamer", "getagrip: --preset: 'hamer' is now called 'moderate'"),
        ("frankmocap", "getagrip: --preset: 'frankmocap' is now called 'strong'"),
    ],
)
def test_an_unknown_preset_is_refused_before_a_folder_is_claimed(
    preset: str, message: str, tmp_path: Path, run: Run
) -> None:
    status, _, err = run("bench", "synthetic", "--out", tmp_path / "out", "--preset", preset)
    assert status == 2
    assert message in err
    assert not (tmp_path / "out" / "clips").exists()


def test_the_commands_ablations_are_those_that_exist(run: Run) -> None:
    assert tuple(ABLATIONS) == ABLATION_NAMES
    assert all(name in words(run("bench", "dexycb", "--help")[1]) for name in ABLATIONS)
    assert all(source.dataset in words(run("bench", "--help")[1]) for _, source in BENCHES)


@pytest.mark.parametrize(
    ("source", "presets"),
    [
        ("synthetic", SYNTHETIC_PRESETS),
        ("dexycb-segments", NOISE_PRESETS),
        ("hot3d-timelines", (ALL_NOISE_LEVELS, *TIMELINE_NOISE_LEVELS)),
    ],
)
def test_presets_are_described_for_each_dataset(source: str, presets: Iterable[str], run: Run) -> None:
    said = words(run("bench", source, "--help")[1])
    said = said[said.index("--presetNAME") :]
    assert all(preset in said for preset in presets)


def words(text: str) -> str:
    """Help without its frame, whose lines break words."""
    return re.sub(r"[\s│]+", "", text)


@pytest.mark.parametrize(
    "call",
    [
        ("bench", "DIR", "--out", "out", "--clips", "1"),
        ("bench", "clips", "DIR", "--out", "out", "--clips", "1"),
        ("bench", "--out", "out", "clips", "DIR", "--clips", "1"),
        ("bench", "clips", "--out", "out", "--clips", "1"),
        ("bench", "--out", "out", "DIR", "--clips", "1"),
        ("bench", "--clips", "1", "--out", "synthetic", "DIR"),
    ],
)
def test_a_folder_of_clips_needs_no_other_word(
    call: tuple[str, ...], can_and_box: Path, tmp_path: Path, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "clips").symlink_to(can_and_box)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(GraspTrial, "scores", lambda trial: trial.failed(f"seen {trial.name}"))
    status, _, err = run(*(str(can_and_box) if word == "DIR" else word for word in call), "--workers", "1")
    assert (status, err.splitlines()[-1]) == (1, "failed: box-right-0000: seen box-right-0000")
