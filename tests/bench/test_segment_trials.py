"""Sequences of the benchmark of segments: both directions, results that are kept, and what is refused."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from getagrip.bench.job import run_trial
from getagrip.bench.segments import SEGMENT_VARIANTS, TIME_DIRECTIONS, SequenceTrial, reverse_spans, reversed_in_time
from getagrip.bench.sources import Sample
from getagrip.clip import Segment, World, write_clip
from getagrip.fitting.options import Options
from getagrip.io import plugins
from helpers.environment import Run
from helpers.scenes import from_table

FRAMES = 12


@pytest.fixture
def trial(tmp_path: Path) -> SequenceTrial:
    """A sequence whose object lies still, though its truth claims a grasp."""
    clip, masks = from_table()
    clip = replace(
        clip.take(np.arange(FRAMES)),
        world=World(np.tile(np.eye(4), (FRAMES, 1, 1))),
        name="still",
        segments=(Segment("static", 0, 3), Segment("grasp", 4, 9, "right")),
    )
    folder = write_clip(clip, masks.take(np.zeros(FRAMES, dtype=int)), tmp_path / "clips" / "still")
    return SequenceTrial(Sample("still", folder), tmp_path / "results", False, "none", Options())


@pytest.mark.slow
def test_what_is_found_and_what_is_true_is_scored_in_both_directions(trial: SequenceTrial) -> None:
    scores = run_trial(trial)
    assert not scores.failure
    assert set(scores.by) == {(direction, way) for direction in TIME_DIRECTIONS for way in SEGMENT_VARIANTS}
    for of in scores.by.values():
        assert of.found == 0
        assert [match.tiou for match in of.matches] == [0.0]
    record = json.loads((trial.results / "still.json").read_text())
    assert record["forwards"]["true"] == [[4, 9]]
    assert record["in reverse"]["true"] == [[2, 7]]


@pytest.mark.slow
def test_what_the_same_code_has_found_is_kept(trial: SequenceTrial) -> None:
    run_trial(trial)
    path = trial.results / "still.json"
    record = json.loads(path.read_text())
    record["forwards"]["fits"] = [[4, 9]]
    path.write_text(json.dumps(record))
    kept = run_trial(trial)
    assert (kept.by["forwards", "fits"].matches[0].tiou, kept.again) == (1.0, "")
    assert run_trial(replace(trial, overwrite=True)).by["forwards", "fits"].found == 0


@pytest.mark.slow
def test_what_other_code_has_found_or_is_damaged_is_found_again_and_why_is_said(
    trial: SequenceTrial, monkeypatch: pytest.MonkeyPatch
) -> None:
    run_trial(trial)
    path = trial.results / "still.json"
    path.write_bytes(path.read_bytes()[:100])
    again = run_trial(trial)
    assert (again.failure, again.by["forwards", "fits"].found) == ("", 0)
    assert again.again.startswith("the earlier result is damaged (")
    assert run_trial(trial).again == ""
    same = plugins.fingerprint()

    def of_other_segmentation(*also: str) -> str:
        return "0123456789abcdef" if "segmentation" in also else same

    monkeypatch.setattr(plugins, "fingerprint", of_other_segmentation)
    assert run_trial(trial).again == "the earlier result is of other code or other libraries"


def test_a_sequence_that_cannot_be_read_is_a_failure(trial: SequenceTrial) -> None:
    (trial.sample.folder / "hand.npz").write_bytes(b"no hand")
    assert "hand.npz" in run_trial(trial).failure


def test_time_runs_back(trial: SequenceTrial) -> None:
    clip, masks = from_table()
    back, masks_back = reversed_in_time(clip, masks)
    assert back.frames == clip.frames
    np.testing.assert_array_equal(back.hand.T_cam_hand, clip.hand.T_cam_hand[::-1])
    np.testing.assert_array_equal(masks_back.object, masks.object[::-1])
    assert np.all(np.diff(back.time) > 0.0)
    twice, _ = reversed_in_time(back, masks_back)
    np.testing.assert_array_equal(twice.hand.T_cam_hand, clip.hand.T_cam_hand)
    spans = [(0, 3), (5, 11)]
    assert reverse_spans(reverse_spans(spans, FRAMES), FRAMES) == spans


@pytest.mark.parametrize(
    "options", [("--methods", "static"), ("--ablation", "inits"), ("--contact", "5"), ("--preset", "wild")]
)
def test_options_of_other_benchmarks_are_refused(tmp_path: Path, run: Run, options: tuple[str, ...]) -> None:
    status, _, err = run("bench", "dexycb-segments", "--root", tmp_path, "--out", tmp_path / "out", *options)
    assert status == 2
    assert options[0] in err
