"""Terms in a further view: the same numbers as in that camera, and derivatives in the first one's frame."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy import ndarray

from getagrip.bench.inputs.added_views import AddedViews
from getagrip.bench.inputs.perturbations import UNCHANGED
from getagrip.clip import with_masks
from getagrip.clip.views import clip_in_view, views_of
from getagrip.fitting.energy import ObjectWithHand, PosesInCamera, Quadratic, no_bound
from getagrip.fitting.energy.in_view import InView, ViewedEnergy, poses_in_view
from getagrip.fitting.motion import Fixed
from getagrip.fitting.objective import mask_energy
from getagrip.fitting.options import Options
from getagrip.fitting.problem import Problem, prepare_problem
from getagrip.fitting.solver.solve import poses_in_camera
from getagrip.geometry import se3
from helpers.scenes import SHORT, scene

AT = np.array([0, 2])
T_VIEW_CAM = se3.rigid(
    se3.exp_so3(np.array([[0.1, 1.3, -0.2], [0.4, -0.7, 0.3]])), np.array([[0.3, 0.1, 0.2], [0.1, 0.0, 0.4]])
)
P = 7


class PullToPoints:
    """A smooth term on points of a body in two frames: squared distances from a point, and from frame to frame."""

    name = "pull"
    arms = np.random.default_rng(1).standard_normal((5, 3)) * 0.05
    to = np.array([0.1, -0.1, 0.6])

    def __call__(self, poses: PosesInCamera, bound: ndarray) -> Quadratic:
        arm = poses.scale[:, None, None, None] * self.arms @ np.swapaxes(poses.R, -1, -2)
        X = arm + poses.centre[:, :, None]
        B, N = X.shape[:2]
        J = np.zeros((*X.shape, P))
        J[..., :3], J[..., 3:6], J[..., 6] = np.eye(3), -se3.hat(arm), arm
        flat = J.reshape(B, N, -1, P)
        one = Quadratic.of_squares((X - self.to).reshape(B, N, -1), flat, 1.0)
        apart = (X[:, 0] - X[:, 1]).reshape(B, -1)
        value = 0.5 * np.sum(apart**2, axis=1)[:, None] * np.ones((1, 2))
        Jt = np.swapaxes(flat, 2, 3)
        g = np.stack(
            [2.0 * (Jt[:, n] @ (sign * apart)[..., None])[..., 0] for n, sign in ((0, 1.0), (1, -1.0))], axis=1
        )
        H = np.stack([2.0 * np.swapaxes(flat[:, n], 1, 2) @ flat[:, n] for n in (0, 1)], axis=1)
        cross = np.zeros((B, N, P, N, P))
        cross[:, 0, :, 1] = -2.0 * np.swapaxes(flat[:, 0], 1, 2) @ flat[:, 1]
        cross[:, 1, :, 0] = -2.0 * np.swapaxes(flat[:, 1], 1, 2) @ flat[:, 0]
        return one + Quadratic(value, g, H, cross)


def some_poses(rng: np.random.Generator, N: int = 3) -> PosesInCamera:
    R = se3.exp_so3(rng.standard_normal((2, N, 3)))
    return PosesInCamera(R, np.array([0.0, 0.0, 0.5]) + 0.1 * rng.standard_normal((2, N, 3)), np.array([1.0, 1.2]))


def moved(poses: PosesInCamera, step: ndarray) -> PosesInCamera:
    scale = poses.scale * np.exp(step[0, 6])
    return PosesInCamera(se3.exp_so3(step[:, 3:6]) @ poses.R, poses.centre + step[:, :3], scale)


def test_derivatives_of_a_viewed_term_are_in_the_first_cameras_frame() -> None:
    poses, term, h = some_poses(np.random.default_rng(0)), InView(PullToPoints(), "side", AT, T_VIEW_CAM), 1e-6
    found = term(poses, no_bound(poses))
    assert not found.value[:, 1].any(), "the view lacks this frame"
    for n in range(3):
        for k in range(6):
            step = np.zeros((3, P))
            step[n, k] = h
            ahead, behind = (term(moved(poses, sign * step), no_bound(poses)) for sign in (1.0, -1.0))
            slope = (ahead.value.sum(axis=1) - behind.value.sum(axis=1)) / (2.0 * h)
            np.testing.assert_allclose(found.g[:, n, k], slope, rtol=1e-5, atol=1e-7)
    grown = np.zeros((3, P))
    grown[:, 6] = h
    ahead, behind = (term(moved(poses, sign * grown), no_bound(poses)) for sign in (1.0, -1.0))
    slope = (ahead.value.sum(axis=1) - behind.value.sum(axis=1)) / (2.0 * h)
    np.testing.assert_allclose(found.g[..., 6].sum(axis=1), slope, rtol=1e-5)
    assert found.cross is not None
    np.testing.assert_allclose(found.cross, np.moveaxis(found.cross, (1, 2), (3, 4)), atol=1e-12)
    one, other = np.random.default_rng(3).standard_normal((2, 3))
    step = np.zeros((3, P))
    step[0, :3], step[2, :3] = one, other
    curvature = np.einsum("np,bnp->b", step, np.einsum("bnpq,nq->bnp", found.H, step))
    curvature += np.einsum("np,bnpmq,mq->b", step, found.cross, step)
    ahead, behind = (term(moved(poses, sign * 1e-3 * step), no_bound(poses)) for sign in (1.0, -1.0))
    second = (ahead.value.sum(axis=1) + behind.value.sum(axis=1) - 2.0 * found.value.sum(axis=1)) / 1e-6
    np.testing.assert_allclose(curvature, second, rtol=1e-5)


def test_poses_in_a_view_move_the_hand_too() -> None:
    rng = np.random.default_rng(5)
    body = some_poses(rng)
    both = ObjectWithHand(*vars(body).values(), replace(body), body)  # type: ignore[arg-type]
    seen = poses_in_view(both, AT, T_VIEW_CAM)
    for part in (seen, seen.hand, seen.in_hand):
        np.testing.assert_allclose(part.centre, se3.transform(T_VIEW_CAM, body.centre[:, AT, None])[:, :, 0])


@pytest.fixture(scope="module")
def problem() -> Problem:
    clip, masks = AddedViews(3, UNCHANGED)(*scene("mug", 1, SHORT), 0)
    return prepare_problem(with_masks(clip, masks), Options(hands="as-given", frames=4))


def test_a_views_mask_term_is_that_of_the_clip_seen_from_it(problem: Problem) -> None:
    """Another clip, whose own camera is the view's, has the same number."""
    view = views_of(problem.clip)[0]
    alone = prepare_problem(
        with_masks(clip_in_view(problem.clip, view), view.masks), Options(hands="as-given", frames=4)
    )
    index = np.arange(4)
    start = Fixed(np.eye(3)[None], np.array([[0.02, 0.01, 0.0]]), np.zeros(1), 4, False)
    terms = {
        term.name: term
        for modality in problem.evidence
        if modality.object is not None
        for term in modality.object(64, index)
    }
    assert [*terms] == ["mask", "mask:view2", "mask:view3"]
    poses = poses_in_camera(start, problem.clip.hand.T_cam_hand)
    (own,) = mask_energy(alone)(64, index)
    there = poses_in_camera(start, alone.clip.hand.T_cam_hand)
    found, wanted = terms["mask:view2"](poses, no_bound(poses)), own(there, no_bound(there))
    np.testing.assert_allclose(found.value, wanted.value)
    np.testing.assert_allclose(np.linalg.norm(found.g[..., :3], axis=-1), np.linalg.norm(wanted.g[..., :3], axis=-1))


def test_a_view_that_shows_some_frames_counts_in_these(problem: Problem) -> None:
    energy = ViewedEnergy(lambda level, index: [PullToPoints()], "side", np.array([1, 3]), T_VIEW_CAM)
    (term,) = energy(64, np.array([0, 1, 3]))
    assert term.at.tolist() == [1, 2]
    assert energy(64, np.array([0, 2])) == []
