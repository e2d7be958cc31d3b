"""Segments: scores of intervals, both directions of a sequence, records that are kept."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from getagrip.bench.job import run_trial
from getagrip.bench.sequences.segments import (
    SEGMENT_VARIANTS,
    TIME_DIRECTIONS,
    SequenceTrial,
    Span,
    match_segments,
    reverse_spans,
    reversed_in_time,
    span_iou,
    summarise_segments,
)
from getagrip.bench.sources import Sample
from getagrip.clip import Segment, World, write_clip
from getagrip.fitting.options import Options
from getagrip.io import plugins
from helpers.environment import Run
from helpers.scenes import from_table

SPANS = st.tuples(st.integers(0, 40), st.integers(0, 40)).map(lambda ends: (min(ends), max(ends)))


@given(SPANS, SPANS)
def test_overlap_is_that_of_sets_of_frames(a: Span, b: Span) -> None:
    in_a, in_b = set(range(a[0], a[1] + 1)), set(range(b[0], b[1] + 1))
    assert span_iou(a, b) == pytest.approx(len(in_a & in_b) / len(in_a | in_b))


@given(st.lists(SPANS, max_size=4), st.lists(SPANS, max_size=4))
def test_scores_stay_within_bounds_and_nothing_is_matched_twice(true: list[Span], found: list[Span]) -> None:
    one = match_segments(true, found)
    assert len(one.matches) == len(true)
    assert sum(match.start is not None for match in one.matches) <= min(len(true), len(found))
    all_ = summarise_segments([one])
    if true or found:
        assert 0.0 <= all_.f1[1] <= all_.f1[0] <= 1.0
    assert all_.false == (int(bool(found) and not true), int(not true))


def test_what_is_found_exactly_is_perfect() -> None:
    true = [(3, 20), (30, 40)]
    exact = summarise_segments([match_segments(true, true), match_segments([], [])])
    assert (exact.tiou, exact.f1, exact.start, exact.end, exact.missed) == (1.0, (1.0, 1.0), 0.0, 0.0, 0)
    assert exact.false == (0, 1)


def test_errors_are_of_what_overlaps_and_misses_count_as_none() -> None:
    late = summarise_segments([match_segments([(10, 29), (50, 60)], [(14, 31)]), match_segments([], [(1, 5)])])
    assert late.tiou == pytest.approx((16 / 22 + 0.0) / 2)
    assert (late.start, late.end, late.missed) == (4.0, 2.0, 1)
    assert late.f1 == pytest.approx((2 * 1 / 4, 2 * 1 / 4))
    assert late.false == (1, 1)


def test_of_two_finds_in_one_grasp_the_larger_counts_and_the_other_is_false() -> None:
    one = match_segments([(0, 29)], [(0, 9), (12, 29)])
    assert one.matches[0].tiou == pytest.approx(18 / 30)
    assert summarise_segments([one]).f1[0] == pytest.approx(2 / 3)


def test_nothing_has_no_mean() -> None:
    assert math.isnan(summarise_segments([]).tiou)
    assert math.isnan(summarise_segments([]).f1[0])


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
