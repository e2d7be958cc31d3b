"""A handle within the fingers saves energy; beside them it neither saves nor pulls."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from getagrip.clip import with_masks
from getagrip.fitting.energy import PosesInCamera, no_bound
from getagrip.fitting.energy.handle_grip import HandleTerm, finger_middles
from getagrip.fitting.objective import handle_energy
from getagrip.fitting.options import Options
from getagrip.fitting.problem import prepare_problem
from getagrip.geometry import se3
from helpers.scenes import SHORT, scene
from helpers.terms import B, N, moved, random_poses

LINE = np.stack([np.full(7, 0.06), np.zeros(7), np.linspace(-0.03, 0.03, 7)], axis=-1)


def about(poses: PosesInCamera, away: float, rng: np.random.Generator) -> HandleTerm:
    """Fingers beside the first pose's handle, at some distance."""
    at = poses.scale[0] * LINE[[1, 3, 4, 6]] @ np.swapaxes(poses.R[0], -1, -2) + poses.centre[0][:, None]
    off = rng.normal(size=(N, 4, 3))
    off *= away / np.linalg.norm(off, axis=-1, keepdims=True)
    return HandleTerm(LINE, at + off, np.full(N, 1e3))


def test_derivatives() -> None:
    rng = np.random.default_rng(3)
    poses, h = random_poses(rng), 1e-6
    term = replace(about(poses, 0.018, rng), reach=0.5)
    found = term(poses, no_bound(poses))
    assert found.value.shape == (B, N)
    for k in range(7):
        step = h * np.eye(7)[k]
        up, down = (term(moved(poses, s * step), no_bound(poses)).value.sum(axis=1) for s in (1.0, -1.0))
        expected = (up - down) / (2.0 * h)
        np.testing.assert_allclose(found.g[..., k].sum(axis=1), expected, atol=1e-4 * np.abs(found.g).max())
    assert (np.linalg.eigvalsh(found.H) >= -1e-9 * np.abs(found.H).max()).all()


@pytest.mark.parametrize("away", [0.001, 0.009])
def test_within_the_slack_all_is_saved(away: float) -> None:
    rng = np.random.default_rng(4)
    poses = random_poses(rng)
    term = about(poses, away, rng)
    found = term(poses, no_bound(poses))
    np.testing.assert_allclose(found.value[0], -term.weight * term.reach)
    assert not found.g[0].any()


def test_a_hand_that_holds_the_body_changes_nothing() -> None:
    rng = np.random.default_rng(5)
    poses = random_poses(rng)
    term = about(poses, 0.0, rng)
    term = replace(term, fingers=term.fingers + np.array([0.2, 0.0, 0.0]))
    found = term(poses, no_bound(poses))
    for part in (found.value, found.g, found.H):
        assert not part.any()


def test_two_fingers_are_enough() -> None:
    rng = np.random.default_rng(6)
    poses = random_poses(rng)
    term = about(poses, 0.0, rng)
    fingers = term.fingers.copy()
    fingers[:, 2:] += 0.3
    some = replace(term, fingers=fingers)
    np.testing.assert_array_equal(some(poses, no_bound(poses)).value[0], term(poses, no_bound(poses)).value[0])


def test_a_kettle_by_the_handle_saves_energy_and_turned_about_does_not() -> None:
    clip, masks = scene("kettle", 0, SHORT)
    assert clip.truth is not None
    problem = prepare_problem(with_masks(clip, masks), Options())
    (term,) = handle_energy(problem)(256, np.arange(len(problem.clip)))
    T = clip.truth.T_cam_obj
    centre = se3.transform(T, clip.mesh.centre[None])[:, 0]
    turned = T[:, :3, :3] @ se3.exp_so3(np.array([0.0, 0.0, np.pi]))
    poses = PosesInCamera(np.stack([T[:, :3, :3], turned]), np.tile(centre, (2, 1, 1)), np.ones(2))
    value = term(poses, no_bound(poses)).value.sum(axis=1)
    assert value[0] < 0.0
    assert value[1] == 0.0


def test_objects_without_a_handle_and_hands_without_joints_have_no_term() -> None:
    clip, masks = scene("can", 0, SHORT)
    problem = prepare_problem(with_masks(clip, masks), Options())
    assert not handle_energy(problem)(256, np.arange(len(problem.clip)))
    clip, masks = scene("mug", 0, SHORT)
    problem = prepare_problem(with_masks(clip, masks), Options())
    assert finger_middles(replace(problem.clip.hand, joints=None)) is None
    assert not handle_energy(replace(problem, options=Options(pull=0.0)))(256, np.arange(len(problem.clip)))
