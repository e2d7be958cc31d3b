"""Tests of loose ends: what is left out of a draft's interval, and what never is."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from getagrip.clip import Clip, Masks
from getagrip.fitting.options import Options
from getagrip.fitting.pipeline import FrameSolutions, RepairedInput
from getagrip.fitting.stages.loose_ends import N_FIRM_FRAMES, firm_rows, meets_firm_frames, without_loose_ends
from getagrip.provenance import assumed, estimated
from getagrip.reconstruct import reconstruct
from getagrip.synthetic.scene import SceneOptions, synthesise


def lifted(clip: Clip) -> Clip:
    """The clip with a hand as if lifted from 2D joints."""
    n = len(clip)
    hand = replace(clip.hand, joints_2d=np.full((n, 21, 2), 50.0), joints_2d_confidence=np.zeros((n, 21)))
    return replace(clip, hand=hand, provenance={"hands": estimated("a network"), "hands_scale": assumed("mean")})


def shortened(clip: Clip, iou: list[float], options: Options | None = None) -> RepairedInput | None:
    """The input of ``clip`` without its loose ends, by the IOU of an answer in all of its frames."""
    answer = SimpleNamespace(track=SimpleNamespace(frames=clip.frames, iou=np.array(iou)))
    return without_loose_ends(RepairedInput(clip, clip, options or Options()), cast(FrameSolutions, answer))


CLIP = lifted(synthesise("box", 0, SceneOptions(frames=14))[0])
LOOSE = [0.8, np.nan, 0.7, 0.5, *[0.95] * 9, np.nan]


def test_frames_at_the_ends_whose_masks_no_stable_grasp_meets_are_left_out_and_said() -> None:
    short = shortened(CLIP, LOOSE)
    assert short is not None
    assert short.clip.frames == short.original.frames == CLIP.frames[4:13]
    assert f"the frames {CLIP.frames[4]} to {CLIP.frames[12]}" in short.notes[-1]
    assert "the 5 others" in short.notes[-1]


@pytest.mark.parametrize(
    ("clip", "options"),
    [
        (synthesise("box", 0, SceneOptions(frames=14))[0], Options()),
        (CLIP, Options(interval="as-given")),
        (CLIP, Options(method="single-frame")),
    ],
)
def test_other_hands_given_intervals_and_other_methods_keep_all_frames(clip: Clip, options: Options) -> None:
    assert shortened(clip, LOOSE, options) is None


@pytest.mark.parametrize(("now", "kept"), [(0.96, True), (0.95, True), (0.94, False), (np.nan, False)])
def test_a_fit_to_the_firm_frames_that_meets_them_less_is_not_kept(now: float, kept: bool) -> None:
    """Fewer frames may find the mirror image of a plate."""
    before = SimpleNamespace(track=SimpleNamespace(frames=CLIP.frames, iou=np.array(LOOSE)))
    firm = SimpleNamespace(track=SimpleNamespace(frames=CLIP.frames[4:13], iou=np.full(9, now)))
    assert meets_firm_frames(cast(FrameSolutions, firm), cast(FrameSolutions, before)) == kept


def test_frames_that_are_met_less_within_the_grasp_stay() -> None:
    assert shortened(CLIP, [*[0.95] * 5, 0.1, np.nan, *[0.95] * 7]) is None


def test_a_clip_of_which_little_would_remain_stays_whole() -> None:
    assert shortened(CLIP, [*[0.3] * 7, *[0.95] * 7]) is None
    assert shortened(CLIP, [np.nan] * 14) is None


@given(st.lists(st.one_of(st.just(np.nan), st.floats(0.0, 1.0)), min_size=1, max_size=60))
def test_the_rest_is_one_stretch_that_begins_and_ends_with_masks_that_are_met(iou: list[float]) -> None:
    each = np.array(iou)
    rows = firm_rows(each)
    assert 0 <= rows.start < rows.stop <= len(each)
    if rows.stop - rows.start < len(each):
        ends = each[rows][[*range(N_FIRM_FRAMES), *range(-N_FIRM_FRAMES, 0)]]
        assert (ends >= 0.9 * np.nanmedian(each)).all()
        assert rows.stop - rows.start >= 0.5 * len(each)


@pytest.mark.slow
def test_a_draft_is_fitted_without_its_reach() -> None:
    """Before the hand has arrived, the object lies beside it."""
    clip, masks = synthesise("box", 0, SceneOptions(frames=11))
    beside = masks.object.copy()
    beside[:3] = np.roll(beside[:3], clip.size[0] // 4, axis=2)
    clip, masks = lifted(clip), Masks(beside, masks.ignore, masks.hand)
    result = reconstruct(clip, masks, Options(inits=10))
    assert result.frames == clip.frames[3:]
    assert any("the 3 others" in note for note in result.notes)
