"""Laws of the search's steps: which frames, which axis, which hypotheses go on."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from getagrip.datasets.synthetic.categories import CATEGORIES
from getagrip.fitting.energy import Local
from getagrip.fitting.motion import Fixed, Free, Hinge, Soft
from getagrip.fitting.search import (
    FAR,
    NEAR,
    Stage,
    Turns,
    distinct,
    explored,
    hinge_from,
    resampled,
    soft_hinge,
    spread,
    turned,
)
from getagrip.fitting.solve import Poses, minimise
from getagrip.fitting.surface import Shape
from getagrip.geometry import se3
from getagrip.geometry.mesh import Mesh
from helpers.clips import box

CORNERS = np.array([[i & 1, i >> 1 & 1, i >> 2] for i in range(8)]) * [0.1, 0.06, 0.04] - [0.05, 0.03, 0.02]
SHAPE = Shape.of(box(0.1, 0.06, 0.04))


@given(st.integers(1, 400), st.integers(2, 60))
def test_frames_are_spread_over_the_clip(frames: int, wanted: int) -> None:
    index = spread(frames, wanted)
    assert index[0] == 0
    assert index[-1] == frames - 1
    assert len(index) == min(frames, wanted)
    gaps = np.diff(index)
    assert len(gaps) == 0 or (gaps.min() >= 1 and gaps.max() - gaps.min() <= 1)


def hinge(frames: int = 8, arm: float = 0.03, seed: int = 0) -> Hinge:
    rng = np.random.default_rng(seed)
    direction = rng.normal(size=(2, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    R, centre = se3.exp_so3(rng.normal(size=(2, 3))), rng.normal(0.0, 0.05, (2, 3))
    across = np.cross(direction, rng.normal(size=(2, 3)))
    point = centre + arm * across / np.linalg.norm(across, axis=1, keepdims=True)
    angle = 0.3 * np.sin(np.linspace(0.0, 4.0, frames)) * np.ones((2, 1))
    return Hinge(R, centre, np.zeros(2), point, direction, angle)


def loosened(motion: Hinge) -> Soft[Fixed]:
    """The same poses as a fixed one and a deviation per frame."""
    held, frames = motion.poses(), motion.angle.shape[1]
    core = Fixed(motion.R, motion.centre, motion.log_scale, frames)
    w = se3.log_so3(held.R @ np.swapaxes(motion.R[:, None], -1, -2))
    return Soft(core, np.concatenate([held.centre - motion.centre[:, None], w], axis=-1), (1.0, 1.0))


@pytest.mark.parametrize("arm", [0.0, 0.03, 0.06])
def test_the_axis_of_a_hinge_is_found_in_its_deviations(arm: float) -> None:
    true = hinge(arm=arm)
    found = hinge_from(loosened(true), free_location=True, anchor=np.zeros(3))
    np.testing.assert_allclose(np.abs(np.sum(found.direction * true.direction, axis=1)), 1.0, atol=1e-6)
    turned = se3.angle_between(found.poses().R, true.poses().R)
    np.testing.assert_allclose(turned, 0.0, atol=1e-6)
    # The arm is held short by a ridge, and the circle's chord stands for its arc.
    np.testing.assert_allclose(found.poses().centre, true.poses().centre, atol=0.1 * arm + 1e-9)


def test_an_axis_at_its_place_goes_through_the_anchor() -> None:
    anchor = np.array([0.1, 0.2, 0.3])
    found = hinge_from(loosened(hinge()), free_location=False, anchor=anchor)
    np.testing.assert_array_equal(found.point, [anchor, anchor])
    assert not found.free_location


def test_a_soft_hinge_takes_up_loose_poses_as_they_are() -> None:
    rng = np.random.default_rng(5)
    near = loosened(hinge())
    shaken = replace(near, deviation=near.deviation + 0.02 * rng.normal(size=near.deviation.shape))
    soft = soft_hinge(shaken, free_location=True, anchor=np.zeros(3))
    np.testing.assert_allclose(soft.poses().R, shaken.poses().R, atol=1e-9)
    np.testing.assert_allclose(soft.poses().centre, shaken.poses().centre, atol=1e-9)
    exact = soft_hinge(near, free_location=True, anchor=np.zeros(3))
    assert np.abs(exact.deviation[..., 3:]).max() < 1e-6  # on a hinge nothing is left for them


def test_a_still_object_gives_a_still_hinge() -> None:
    still = replace(hinge(), angle=np.zeros((2, 8)))
    found = hinge_from(loosened(still), free_location=True, anchor=np.zeros(3))
    np.testing.assert_allclose(found.angle, 0.0, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(found.direction, axis=1), 1.0)
    np.testing.assert_allclose(found.poses().centre, still.poses().centre, atol=1e-9)


def test_motions_at_more_frames_keep_those_they_had() -> None:
    old, new = np.array([0, 3, 6, 9]), np.arange(10)
    true = hinge(frames=4)
    held = true.poses()
    loose = loosened(true)
    free = Free(held.R, held.centre, true.log_scale)
    for motion in (loose.core, true, free, loose, Soft(true, loose.deviation, (1.0, 1.0))):
        more = resampled(motion, old, new).poses()
        assert more.R.shape == (2, 10, 3, 3)
        np.testing.assert_allclose(more.R[:, old], motion.poses().R, atol=1e-12)
        np.testing.assert_allclose(more.centre[:, old], motion.poses().centre, atol=1e-12)
    between = resampled(true, old, new).angle
    np.testing.assert_allclose(between[:, 1], (2.0 * true.angle[:, 0] + true.angle[:, 1]) / 3.0)


def test_free_poses_turn_steadily_between_frames() -> None:
    old, new = np.array([0, 4, 8]), np.arange(9)
    R = se3.exp_so3(np.array([0.1, 0.2, -0.05])[None, None] * new[None, :, None])
    centre = np.array([0.01, 0.0, 0.002]) * new[None, :, None]
    more = resampled(Free(R[:, old], centre[:, old], np.zeros(1)), old, new)
    np.testing.assert_allclose(more.R, R, atol=1e-12)
    np.testing.assert_allclose(more.centre, centre, atol=1e-12)


def test_near_copies_of_a_better_hypothesis_are_dropped() -> None:
    eye = np.tile(np.eye(3), (5, 1, 1))
    centre = np.array([[0.0, 0, 0], [1e-4, 0, 0], [0.05, 0, 0], [0.1, 0, 0], [0.2, 0, 0]])
    motion = Fixed(eye, centre, np.zeros(5), 3)
    energy = np.array([2.0, 1.0, 5.0, 3.0, np.inf])
    np.testing.assert_array_equal(distinct(motion.poses(), energy, SHAPE, keep=9), [1, 3, 2])
    np.testing.assert_array_equal(distinct(motion.poses(), energy, SHAPE, keep=2), [1, 3])
    assert len(distinct(motion.poses(), np.full(5, np.inf), SHAPE, keep=2)) == 0


@pytest.mark.parametrize("by", [FAR, NEAR])
def test_turns_are_by_as_much_as_asked(by: Turns) -> None:
    R = turned(SHAPE.axes, by, 30, np.random.default_rng(3))
    angle = np.degrees(se3.angle_between(R, np.eye(3)))
    for k, (least, most) in enumerate((by.random, by.principal)):
        of = angle[30 * k : 30 * k + 30]
        assert ((of >= least - 1e-4) & (of <= most + 1e-4)).all()
    axis = se3.log_so3(R[30:]) / np.radians(angle[30:, None])
    assert np.allclose(np.abs(axis @ SHAPE.axes.T).max(axis=1), 1.0, atol=1e-6)


def test_a_half_turn_about_a_principal_axis_puts_the_box_on_itself() -> None:
    R = turned(SHAPE.axes, FAR, 30, np.random.default_rng(3))[30:]
    assert len(np.unique(R.round(6) + 0.0, axis=0)) == 3
    for turn in R:
        gaps = np.linalg.norm((CORNERS @ turn.T)[:, None] - CORNERS[None], axis=-1)
        np.testing.assert_allclose(gaps.min(axis=1), 0.0, atol=1e-9)


def test_a_bottle_that_has_spun_is_the_same_and_one_that_was_tilted_is_not() -> None:
    can = trimesh.creation.cylinder(0.03, 0.12, sections=64)
    shape = Shape.of(Mesh(np.array(can.vertices), np.array(can.faces)))
    R = se3.exp_so3(np.array([[0.0, 0, 0], [0.0, 0.0, 1.1], [np.pi, 0.0, 0.0], [0.4, 0.0, 0.0]]))
    still = Fixed(R, np.zeros((4, 3)), np.zeros(4), 3)
    np.testing.assert_array_equal(distinct(still.poses(), np.arange(4.0), shape, keep=9), [0, 3])


def test_a_large_pan_that_has_turned_its_handle_elsewhere_is_another() -> None:
    pan = CATEGORIES["pan"].make()
    shape = Shape.of(pan)
    R = se3.exp_so3(np.radians([[0.0, 0.0, a] for a in (0.0, 30.0, 60.0, 90.0, 180.0)]))
    vessel = np.array([pan.vertices[:, 0].min() + pan.vertices[:, 1].max(), 0.0, 0.0]) - pan.centre
    still = Fixed(R, vessel - R @ vessel, np.zeros(5), 3)
    assert len(distinct(still.poses(), np.arange(5.0), shape, keep=9)) == 5


class Upright:
    """An energy with two minima along each axis, of which one is lower: an object that should stand upright."""

    name = "upright"

    def __call__(self, poses: Poses, bound: np.ndarray) -> Local:
        B, N = poses.centre.shape[:2]
        up = poses.R @ np.array([0.0, 0.0, 1.0])
        z, tilt = up[..., 2], np.stack([up[..., 1], -up[..., 0]], axis=-1)
        g, H = np.zeros((B, N, 7)), np.tile(np.eye(7), (B, N, 1, 1))
        g[..., 3:5] = np.sign(z)[..., None] * tilt
        return Local((1.0 - np.abs(z)) + 0.1 * (z < 0.0), g, H)


def test_turned_hypotheses_reach_the_lower_of_two_minima() -> None:
    shape = Shape.of(box(0.1, 0.06, 0.04))
    starts = Fixed(
        se3.exp_so3(np.array([[np.pi - 0.3, 0.0, 0.0], [np.pi, 0.2, 0.0]])), np.zeros((2, 3)), np.zeros(2), 4
    )
    T = np.tile(np.eye(4), (4, 1, 1))
    stage = Stage("coarse", level=64, frames=4, iterations=5, keep=2)
    first = minimise(starts, [Upright()], T, iterations=10)
    assert first.energy.min() > 0.3
    for rounds in (0, 4):
        found = explored(first, [Upright()], T, shape, replace(stage, rounds=rounds))
        np.testing.assert_array_equal(found.energy[:2], first.energy)  # nothing is lost
        assert len(found.energy) == 2 if rounds == 0 else found.energy.min() < 0.01
