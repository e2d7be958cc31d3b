"""Grasps touch and do not cut in; the least distance of moving points is that of all of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from getagrip.clip import Clip
from getagrip.geometry import se3
from getagrip.geometry.mesh import Mesh
from getagrip.synthetic.categories import SYNTHETIC_CATEGORIES
from getagrip.synthetic.grasp import MinSignedDistance, SignedDistance
from getagrip.synthetic.objects import mug
from getagrip.synthetic.scene import make_scene
from helpers.scenes import SHORT, scene


@pytest.mark.parametrize("step", [0.0, 0.002, 0.05])
def test_the_least_is_that_of_all_points(step: float) -> None:
    distance, rng = SignedDistance(mug()), np.random.default_rng(0)
    X = 0.06 * rng.normal(size=(3, 40, 3)) + [0.0, 0.08, 0.0]
    least = MinSignedDistance(distance, 3, X)
    for k in range(8):
        which = np.flatnonzero(rng.uniform(size=3) < 0.8)
        turn = se3.exp_so3(5.0 * step * rng.normal(size=(3, 3)))
        X = X @ turn + step * np.array([0.0, -1.0, 0.0]) + 0.1 * step * rng.normal(size=X.shape)
        np.testing.assert_array_equal(least(X[which], which), distance(X[which]).min(axis=-1), err_msg=str(k))
    at_once = MinSignedDistance(distance, 3, X[0])(X, np.arange(3))
    np.testing.assert_array_equal(at_once, distance(X).min(axis=-1))


FEW = SHORT


def in_hand(clip: Clip) -> np.ndarray:
    return se3.inverse(clip.truth.T_cam_hand) @ clip.truth.T_cam_obj


def hand_gaps(clip: Clip) -> np.ndarray:
    """Signed distances (T, V) of the true hand's vertices to the object [m]."""
    distance = SignedDistance(Mesh(clip.truth.scale * clip.mesh.vertices, clip.mesh.faces))
    return distance(se3.transform(se3.inverse(in_hand(clip)), clip.truth.hand_vertices))


@pytest.mark.parametrize("category", sorted(SYNTHETIC_CATEGORIES))
@pytest.mark.slow
def test_grasps_touch_and_do_not_cut_in(category: str) -> None:
    clip, masks = scene(category, 0, FEW)
    gaps = hand_gaps(clip)
    assert ((gaps < 0.002).sum(axis=1) >= 3).all(), "the object floats"
    assert gaps.min() > -0.008, "the hand cuts deep into the object"
    assert masks.object.any(axis=(1, 2)).all()
    assert masks.ignore.any(axis=(1, 2)).all()
    assert not (masks.object & masks.ignore).any()


@pytest.mark.slow
def test_grips_vary_where_they_are_asked_to() -> None:
    poses = [in_hand(make_scene("bottle", seed, replace(FEW, grip_deg=15.0)).clip)[0] for seed in range(2)]
    usual = [in_hand(scene("bottle", seed, FEW)[0])[0] for seed in range(2)]
    spread = [np.ptp([T[:3, 2] for T in Ts], axis=0).max() for Ts in (poses, usual)]
    assert spread[0] > 2.0 * spread[1]
