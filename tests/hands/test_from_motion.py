"""The flat hand behind a moving surface: joints, vertices and contact regions of a hand whose answers are known."""

from __future__ import annotations

import numpy as np
import pytest

from getagrip.hands import generic, mano
from getagrip.hands.from_motion import flat_hand
from getagrip.hands.model import Side


@pytest.mark.slow
@pytest.mark.parametrize("side", ["left", "right"])
def test_a_hand_is_found_behind_its_motion(side: Side) -> None:
    """Skinned as usual, its fingers bent in 40 ways: a vertex between two bones follows neither, so not exactly."""
    model = generic.load(side)
    rng = np.random.default_rng(0)
    pose = rng.normal(scale=0.12, size=(40, 15, 3))
    pose[..., 2] += (1.0 if side == "right" else -1.0) * rng.uniform(0.0, 1.0, (40, 15))
    moving = model.with_shape().with_pose(pose.reshape(40, 45))
    found = flat_hand(moving.vertices, model.joints[0], pose.reshape(40, 45))
    assert found is not None
    template, joints, weights = found
    off = np.linalg.norm(joints - model.joints, axis=1)
    assert off[:13].max() < 1.5e-3
    assert off[13:].max() < 8e-3  # the thumb's, about whose saddle joint few vertices turn alone
    assert np.median(np.linalg.norm(template - model.template, axis=1)) < 1e-3
    assert np.mean(weights.argmax(axis=1) == model.weights.argmax(axis=1)) > 0.9
    expected = mano.regions(model.template, model.faces, model.joints, model.weights)
    for name, ids in mano.regions(template, model.faces, joints, weights).items():
        assert len(np.intersect1d(ids, expected[name])) > 0.7 * len(np.union1d(ids, expected[name])), name


def test_fingers_that_do_not_move_tell_nothing() -> None:
    model = generic.load("right")
    vertices, pose = np.tile(model.template, (9, 1, 1)), np.zeros((9, 45))
    assert flat_hand(vertices, model.joints[0], pose) is None
