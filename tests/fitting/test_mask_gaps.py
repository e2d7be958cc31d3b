"""Laws of gaps between the masks: which pixels are in one, and what they no longer say."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy import ndarray

from getagrip.bench.inputs.perturbations import Gapped
from getagrip.clip import Clip, Masks, with_masks
from getagrip.fitting import problem
from getagrip.fitting.energy import PosesInCamera
from getagrip.fitting.energy.mask import MASK_CROP_SIZE_PX, MASK_LEVELS_PX, MAX_GAP_PX, find_gap_pixels, observe_masks
from getagrip.fitting.hand import hand_silhouette
from getagrip.fitting.objective import mask_energy
from getagrip.fitting.options import Options
from getagrip.fitting.problem import prepare_problem
from getagrip.geometry import se3
from getagrip.geometry.kernels.silhouette import unpack
from helpers.scenes import SHORT, scene


def strips(gap: int, size: int = 96, top: int = 20, bottom: int = 70) -> tuple[ndarray, ndarray]:
    """An object left of a gap and what hides it right of it; (N = 1, size, size) each."""
    observed, hidden = np.zeros((2, 1, size, size), bool)
    observed[0, top:bottom, 20:40] = True
    hidden[0, top:bottom, 40 + gap : 80] = True
    return observed, hidden


@pytest.mark.parametrize("gap", [1, 2, 5, MAX_GAP_PX])
def test_a_gap_is_what_lies_between(gap: int) -> None:
    observed, hidden = strips(gap)
    found = find_gap_pixels(observed, hidden)
    expected = np.zeros_like(found)
    expected[0, 20:70, 40 : 40 + gap] = True
    np.testing.assert_array_equal(found & expected, expected)
    beyond = np.argwhere(found & ~expected)  # rounded corners at the ends
    assert len(beyond) <= gap * gap
    for changed in (lambda m: m[:, ::-1], lambda m: m[:, :, ::-1], lambda m: np.swapaxes(m, 1, 2)):
        np.testing.assert_array_equal(
            find_gap_pixels(*(np.ascontiguousarray(changed(m)) for m in (observed, hidden))), changed(found)
        )
    np.testing.assert_array_equal(find_gap_pixels(hidden, observed), found)


def test_what_is_wider_or_touches_is_no_gap() -> None:
    assert not find_gap_pixels(*strips(0)).any()
    assert not find_gap_pixels(*strips(MAX_GAP_PX + 1)).any()
    observed, hidden = strips(3)
    assert not find_gap_pixels(observed, np.zeros_like(hidden)).any()
    assert not find_gap_pixels(np.zeros_like(observed), hidden).any()


def test_exact_masks_have_corners_and_no_gaps() -> None:
    """Where an outline goes behind the hand at right angles, nothing lies across; where it is acute, little does."""
    observed, hidden = np.zeros((2, 1, 96, 96), bool)
    i, j = np.indices((96, 96))
    hidden[0] = i >= 60
    for slope in (0.0, 0.5, 2.0):
        observed[0] = (i < 60) & (i > 10) & (j > 30 + slope * (60 - i) * 0.5) & (j < 80)
        assert not find_gap_pixels(observed, hidden).any()


def test_pixels_in_gaps_do_not_count_at_any_level() -> None:
    clip, masks = scene("can", 0, SHORT)
    exact, gapped = (observe_masks(m, clip.K) for m in (masks, Gapped(2.0)(clip, masks, 0)[1]))
    assert (exact.has_gaps, gapped.has_gaps) == (False, True)
    assert gapped.take(np.array([0])).has_gaps
    for level in MASK_LEVELS_PX:
        np.testing.assert_array_equal(gapped.observed[level], exact.observed[level])
        seen, valid = (unpack(bits[level], level) for bits in (gapped.observed, gapped.valid))
        assert (valid | ~seen).all()


def test_other_frames_of_a_clip_have_gaps_where_the_fitted_ones_have() -> None:
    clip, masks = scene("can", 0, SHORT)
    gapped = Gapped(2.0)(clip, masks, 0)[1]
    for fitted, others in ((masks, gapped), (gapped, masks)):
        first = prepare_problem(with_masks(clip, fitted), Options())
        assert first.at(with_masks(clip, others)).observation.has_gaps == first.observation.has_gaps
    np.testing.assert_array_equal(
        first.at(with_masks(clip, gapped)).observation.valid[MASK_CROP_SIZE_PX],
        first.observation.valid[MASK_CROP_SIZE_PX],
    )


@pytest.mark.slow
def test_exact_hands_stay_where_their_masks_are_too_small_all_round(monkeypatch: pytest.MonkeyPatch) -> None:
    clip, masks = scene("can", 0, SHORT)
    gapped = Gapped(3.0)(clip, masks, 0)[1]
    grown = turned(prepare_problem(with_masks(clip, gapped), Options()).clip)
    monkeypatch.setattr(hand_silhouette, "MASK_GROWTH_RANGE_PX", (np.inf, 0.0))
    as_given = turned(prepare_problem(with_masks(clip, gapped), Options()).clip)
    assert grown < 1.0
    assert grown < 0.3 * as_given


def turned(clip: Clip) -> float:
    """By how much the hand was turned [degrees], mean over frames."""
    assert clip.truth is not None
    return float(
        np.degrees(se3.angle_between(clip.hand.T_cam_hand[:, :3, :3], clip.truth.T_cam_hand[:, :3, :3])).mean()
    )


@pytest.mark.slow
def test_gaps_speak_against_the_truth_unless_they_are_found(monkeypatch: pytest.MonkeyPatch) -> None:
    clip, masks = scene("can", 0, SHORT)
    gapped = Gapped(2.0)(clip, masks, 0)[1]
    exact, found = energy_at_truth(clip, masks), energy_at_truth(clip, gapped)
    notes = [prepare_problem(with_masks(clip, some), Options()).notes for some in (masks, gapped)]
    assert [any("gaps" in note for note in of_some) for of_some in notes] == [False, True]
    assert not prepare_problem(with_masks(clip, gapped), Options(method="paper")).observation.has_gaps
    monkeypatch.setattr(problem, "GAP_SHARE", 1.0)
    believed = energy_at_truth(clip, gapped)
    assert believed > 3.0 * exact
    assert found - exact < 0.4 * (believed - exact)


def energy_at_truth(clip: Clip, masks: Masks) -> float:
    """E_mask at the true poses, all frames together."""
    prepared = prepare_problem(with_masks(clip, masks), replace(Options(), hands="as-given"))
    assert prepared.clip.truth is not None
    T = prepared.clip.truth.T_cam_obj
    centre = se3.transform(T, np.tile(clip.mesh.centre, (len(T), 1, 1)))[:, 0]
    poses = PosesInCamera(T[None, :, :3, :3], centre[None], np.ones(1))
    (term,) = mask_energy(prepared)(MASK_CROP_SIZE_PX, np.arange(len(T)))
    return float(term(poses, np.full(1, np.inf)).value.sum())
