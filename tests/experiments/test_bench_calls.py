"""Wrong calls of ``getagrip bench`` are refused, and its help names what there is."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from getagrip.cli import main
from getagrip.datasets.synthetic.noise import NOISE
from getagrip.datasets.synthetic.splits import PRESETS
from getagrip.experiments.settings import ABLATIONS
from getagrip.experiments.sources import SOURCES
from getagrip.experiments.timeline_trials import ALL, LEVELS
from helpers.command_line import Run


@pytest.mark.parametrize(
    ("args", "word"),
    [
        (("--init", "clusters"), "--init"),
        (("--workers", "0"), "--workers"),
        (("--clips", "0"), "--clips"),
        (("--split", "train"), "--split"),
        (("--root", "x"), "--root"),
        (("--preset", "wild"), "--preset"),
        (("--ablation", "none"), "expected one of physical"),
        (("--json", "/dev/null/x.json"), "--json"),
        (("--inits", "0"), "inits"),
        (("--with", "x=nowhere"), "--with"),
        (("--with", "static=."), "another one than those of the methods"),
        (("--with", "x=.", "--ablation", "scale"), "--with"),
    ],
)
def test_wrong_calls_are_refused(can_and_box: Path, tmp_path: Path, run: Run, args: tuple[str, ...], word: str) -> None:
    status, _, err = run("bench", can_and_box, "--out", tmp_path / "out", *args)
    assert status == 2
    assert word in err


def test_without_clips_nothing_is_written(tmp_path: Path, run: Run) -> None:
    out = tmp_path / "out"
    status, _, err = run("bench", tmp_path / "nowhere", "--out", out)
    assert (status, "nowhere, expected synthetic, dexycb" in err) == (2, True)
    (tmp_path / "empty").mkdir()
    status, _, err = run("bench", tmp_path / "empty", "--out", out)
    assert (status, "empty: got no clip.json" in err) == (1, True)
    assert main(["bench", "dexycb", "--out", str(out)]) == 2
    assert not out.exists()


@pytest.mark.parametrize(
    ("preset", "message"),
    [
        ("tame", "getagrip: --preset: got 'tame', expected one of clean"),
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
    _, out, _ = run("bench", "--help")
    assert all(
        name in out.replace(" ", "").replace("\n", "").replace("│", "") for name in (*ABLATIONS, *PRESETS, *SOURCES)
    )


def test_presets_are_described_for_each_dataset(run: Run) -> None:
    words = re.sub(r"[\s│]+", " ", run("bench", "--help")[1])
    said = words[words.index("--preset NAME") : words.index("--root DIR")]
    of_synthetic, of_sequences, of_timelines = re.split(r"dexycb-segments:|Timelines", said)
    assert all(preset in of_synthetic for preset in PRESETS)
    assert all(noise in of_sequences for noise in NOISE)
    assert all(level in of_timelines for level in (ALL, *LEVELS))
    assert "one of" not in said
