"""Changes of clips before they are reconstructed: sizes, hands, faults of masks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from getagrip.bench.inputs.perturbations import (
    MASK_FAULTS,
    UNCHANGED,
    EstimatedHands,
    Noisy,
    OtherSize,
    ScaleFree,
    ScaleKnown,
    TrueHands,
    WrongMasks,
    displace_mask,
    extend_mask_by_disc,
    halve_mask,
)
from getagrip.errors import InputError
from getagrip.geometry import se3
from getagrip.geometry.rasterize import render_coverage
from getagrip.metrics.contact import signed_distance
from getagrip.provenance import estimated, kind_of_hands
from getagrip.synthetic.noise import NOISE_PRESETS
from getagrip.synthetic.scene import synthesise
from getagrip.synthetic.scene_options import SceneOptions
from helpers.scenes import SHORT, scene


@pytest.mark.slow
def test_scale_made_free_and_known_again() -> None:
    clip, masks = scene("can", 0, SHORT)
    free, _ = ScaleFree()(clip, masks, 0)
    assert free.scale == "free"
    assert free.truth is not None
    assert 0.8 <= free.truth.scale <= 1.25
    known, _ = ScaleKnown()(free, masks, 0)
    np.testing.assert_allclose(known.mesh.vertices, clip.mesh.vertices, atol=1e-12)
    assert UNCHANGED(clip, masks, 0) == (clip, masks)


@pytest.mark.slow
def test_true_hands_replace_given_ones() -> None:
    noisy, masks = synthesise("can", 0, SceneOptions(frames=3, size=(64, 48), focal=60.0, hand_bias_mm=10.0))
    clip, _ = TrueHands()(noisy, masks, 0)
    assert noisy.truth is not None
    np.testing.assert_array_equal(clip.hand.T_cam_hand, noisy.truth.T_cam_hand)
    assert np.linalg.norm(clip.hand.T_cam_hand[:, :3, 3] - noisy.hand.T_cam_hand[:, :3, 3], axis=1).min() > 0.009
    with pytest.raises(InputError, match="no ground truth"):
        TrueHands()(replace(noisy, truth=None), masks, 0)


@pytest.mark.slow
def test_estimated_hands_stay_and_true_ones_get_errors() -> None:
    clip, masks = scene("can", 0, SHORT)
    change = EstimatedHands(NOISE_PRESETS["estimated"])
    expected = Noisy(NOISE_PRESETS["estimated"])(clip, masks, 0)[0].hand.T_cam_hand
    np.testing.assert_array_equal(change(clip, masks, 0)[0].hand.T_cam_hand, expected)
    assert kind_of_hands(EstimatedHands(NOISE_PRESETS["strong"])(clip, masks, 0)[0].provenance) == "estimated"
    own = replace(clip, provenance={**clip.provenance, "hands": estimated("by a network")})
    assert change(own, masks, 0) == (own, masks)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_an_object_of_another_size_stays_in_the_hand(seed: int) -> None:
    clip, masks = scene("can", 0, SHORT)
    changed, seen = OtherSize()(clip, masks, seed)
    assert clip.truth is not None
    assert changed.truth is not None
    factor = changed.mesh.diameter / clip.mesh.diameter
    assert 1.0 / 1.6 <= factor <= 1.6
    assert abs(factor - 1.0) > 0.01
    np.testing.assert_array_equal(changed.hand.T_cam_hand, clip.hand.T_cam_hand)
    hands = se3.transform(clip.truth.T_cam_hand, clip.truth.hand_vertices)
    nearest = []
    for one in (clip, changed):
        assert one.truth is not None
        points = se3.transform(se3.inverse(one.truth.T_cam_obj), hands)[0]
        nearest.append(np.abs(signed_distance(points, one.mesh.vertices, one.mesh.faces)).min())
    assert nearest[1] < max(nearest[0], 0.01)
    posed = se3.transform(changed.truth.T_cam_obj[0], changed.mesh.vertices)
    drawn = render_coverage(posed, changed.mesh.faces, changed.K[0], changed.size)
    assert not (seen.object[0] & ~drawn).any()
    assert (drawn & ~seen.object[0] & ~seen.ignore[0]).sum() == 0
    assert seen.object.sum() > masks.object.sum() if factor > 1.0 else seen.object.sum() < masks.object.sum()
    with pytest.raises(InputError, match="no ground truth"):
        OtherSize()(replace(clip, truth=None), masks, seed)


def test_what_each_fault_does() -> None:
    mask, towards = np.zeros((60, 80), dtype=bool), np.array([1.0, 0.0])
    mask[20:40, 30:50] = True
    assert not (displace_mask(mask, towards) & mask).any()
    assert np.count_nonzero(displace_mask(mask, towards)) == np.count_nonzero(mask)
    left = halve_mask(mask, towards)
    np.testing.assert_array_equal(left, mask & (np.arange(80) < 40))
    assert (extend_mask_by_disc(mask, towards) & mask).sum() == mask.sum()
    assert extend_mask_by_disc(mask, towards)[:, 50:].any()
    assert not extend_mask_by_disc(mask, towards)[:, :30].any()


def test_a_share_of_the_frames_has_wrong_masks_never_in_ignored_pixels() -> None:
    clip, masks = scene("can", 0, SHORT)
    for fault in MASK_FAULTS:
        same, changed = WrongMasks(fault, 0.5)(clip, masks, 0)
        assert same is clip
        differ = (changed.object != masks.object).any(axis=(1, 2))
        assert differ.sum() == 2
        assert not (changed.object & masks.ignore & ~masks.object).any()
    again = WrongMasks(fault, 0.5)(clip, masks, 0)[1]
    np.testing.assert_array_equal(changed.object, again.object)
