"""What is done to clips before they are reconstructed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from getagrip.datasets.synthetic.noise import NOISE
from getagrip.datasets.synthetic.scene import synthesise
from getagrip.datasets.synthetic.scene_options import SceneOptions
from getagrip.errors import InputError
from getagrip.experiments.changes import UNCHANGED, EstimatedHands, Noisy, ScaleFree, ScaleKnown, TrueHands
from getagrip.provenance import estimated, kind_of_hands
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
    change = EstimatedHands(NOISE["estimated"])
    expected = Noisy(NOISE["estimated"])(clip, masks, 0)[0].hand.T_cam_hand
    np.testing.assert_array_equal(change(clip, masks, 0)[0].hand.T_cam_hand, expected)
    assert kind_of_hands(EstimatedHands(NOISE["strong"])(clip, masks, 0)[0].provenance) == "estimated"
    own = replace(clip, provenance={**clip.provenance, "hands": estimated("by a network")})
    assert change(own, masks, 0) == (own, masks)
