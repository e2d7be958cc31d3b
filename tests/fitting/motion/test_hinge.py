"""Hinges from data: the hinge nearest to a relaxed fit, a soft hinge around it, and both at other frames."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy import ndarray

from getagrip.fitting.motion import Fixed, Free, Hinge, Soft
from getagrip.geometry import se3


def hinge(frames: int = 8, arm: float = 0.03, seed: int = 0) -> Hinge:
    rng = np.random.default_rng(seed)
    direction = rng.normal(size=(2, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    R, centre = se3.exp_so3(rng.normal(size=(2, 3))), rng.normal(0.0, 0.05, (2, 3))
    orthogonal = np.cross(direction, rng.normal(size=(2, 3)))
    point = centre + arm * orthogonal / np.linalg.norm(orthogonal, axis=1, keepdims=True)
    angle = 0.3 * np.sin(np.linspace(0.0, 4.0, frames)) * np.ones((2, 1))
    return Hinge(R, centre, np.zeros(2), point, direction, angle)


def relaxed(motion: Hinge) -> Soft[Fixed]:
    """The same poses as a fixed one and a deviation per frame."""
    held, frames = motion.poses(), motion.angle.shape[1]
    core = Fixed(motion.R, motion.centre, motion.log_scale, frames)
    w = se3.log_so3(held.R @ np.swapaxes(motion.R[:, None], -1, -2))
    return Soft(core, np.concatenate([held.centre - motion.centre[:, None], w], axis=-1), (1.0, 1.0))


def nearest(motion: Soft[Fixed], free_location: bool, anchor: ndarray) -> Hinge:
    return Hinge.nearest(motion.core, motion.deviation, free_location, anchor)


def around(motion: Soft[Fixed]) -> Soft[Hinge]:
    """The same poses, as the nearest hinge and the deviations from it."""
    return Soft.around(nearest(motion, True, np.zeros(3)), motion.poses(), (1.0, 1.0))


@pytest.mark.parametrize("arm", [0.0, 0.03, 0.06])
def test_the_axis_of_a_hinge_is_found_in_its_deviations(arm: float) -> None:
    true = hinge(arm=arm)
    found = nearest(relaxed(true), free_location=True, anchor=np.zeros(3))
    np.testing.assert_allclose(np.abs(np.sum(found.direction * true.direction, axis=1)), 1.0, atol=1e-6)
    rotated = se3.angle_between(found.poses().R, true.poses().R)
    np.testing.assert_allclose(rotated, 0.0, atol=1e-6)
    # The arm is held short by a ridge, and the circle's chord stands for its arc.
    np.testing.assert_allclose(found.poses().centre, true.poses().centre, atol=0.1 * arm + 1e-9)


def test_the_axis_is_that_of_the_changes_whatever_all_frames_share() -> None:
    rng = np.random.default_rng(3)
    direction, shared = rng.normal(size=(2, 2, 3)) / 9.0
    w = shared[:, None] + np.linspace(-1.0, 1.0, 8)[:, None] * direction[:, None]
    motion = replace(relaxed(hinge()), deviation=np.concatenate([np.zeros_like(w), w], axis=-1))
    found = nearest(motion, free_location=True, anchor=np.zeros(3))
    np.testing.assert_allclose(np.linalg.norm(np.cross(found.direction, direction), axis=1), 0.0, atol=1e-12)


def test_an_axis_at_its_place_goes_through_the_anchor() -> None:
    anchor = np.array([0.1, 0.2, 0.3])
    found = nearest(relaxed(hinge()), free_location=False, anchor=anchor)
    np.testing.assert_array_equal(found.point, [anchor, anchor])
    assert not found.free_location


def test_a_soft_hinge_takes_up_relaxed_poses_as_they_are() -> None:
    rng = np.random.default_rng(5)
    near = relaxed(hinge())
    shaken = replace(near, deviation=near.deviation + 0.02 * rng.normal(size=near.deviation.shape))
    soft = around(shaken)
    np.testing.assert_allclose(soft.poses().R, shaken.poses().R, atol=1e-9)
    np.testing.assert_allclose(soft.poses().centre, shaken.poses().centre, atol=1e-9)
    exact = around(near)
    assert np.abs(exact.deviation[..., 3:]).max() < 1e-6  # on a hinge nothing is left for them


def test_a_still_object_gives_a_still_hinge() -> None:
    still = replace(hinge(), angle=np.zeros((2, 8)))
    found = nearest(relaxed(still), free_location=True, anchor=np.zeros(3))
    np.testing.assert_allclose(found.angle, 0.0, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(found.direction, axis=1), 1.0)
    np.testing.assert_allclose(found.poses().centre, still.poses().centre, atol=1e-9)


def test_motions_at_more_frames_keep_those_they_had() -> None:
    old, new = np.array([0, 3, 6, 9]), np.arange(10)
    true = hinge(frames=4)
    held = true.poses()
    soft = relaxed(true)
    free = Free(held.R, held.centre, true.log_scale)
    for motion in (soft.core, true, free, soft, Soft(true, soft.deviation, (1.0, 1.0))):
        more = motion.resampled(old, new).poses()
        assert more.R.shape == (2, 10, 3, 3)
        np.testing.assert_allclose(more.R[:, old], motion.poses().R, atol=1e-12)
        np.testing.assert_allclose(more.centre[:, old], motion.poses().centre, atol=1e-12)
    between = true.resampled(old, new).angle
    np.testing.assert_allclose(between[:, 1], (2.0 * true.angle[:, 0] + true.angle[:, 1]) / 3.0)


def test_free_poses_turn_steadily_between_frames() -> None:
    old, new = np.array([0, 4, 8]), np.arange(9)
    R = se3.exp_so3(np.array([0.1, 0.2, -0.05])[None, None] * new[None, :, None])
    centre = np.array([0.01, 0.0, 0.002]) * new[None, :, None]
    more = Free(R[:, old], centre[:, old], np.zeros(1)).resampled(old, new)
    np.testing.assert_allclose(more.R, R, atol=1e-12)
    np.testing.assert_allclose(more.centre, centre, atol=1e-12)


def test_free_poses_follow_the_two_nearest_frames_and_go_on_so_beyond_the_ends() -> None:
    rng = np.random.default_rng(4)
    old, new = np.array([2, 4, 8]), np.arange(11)
    motion = Free(se3.exp_so3(rng.normal(0.0, 0.3, (1, 3, 3))), rng.normal(size=(1, 3, 3)), np.zeros(1))
    more = motion.resampled(old, new)
    for two, near in ((slice(0, 2), new < 4), (slice(1, 3), new >= 4)):
        alone = replace(motion, R=motion.R[:, two], centre=motion.centre[:, two]).resampled(old[two], new[near])
        np.testing.assert_array_equal(more.R[:, near], alone.R)
        np.testing.assert_array_equal(more.centre[:, near], alone.centre)
