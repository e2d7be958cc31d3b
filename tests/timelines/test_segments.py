"""Terms of support and links: gradients against finite differences, zero where they should be; a grasp by itself."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy import ndarray

from getagrip.clip import Clip, Segment, with_masks
from getagrip.fitting.energy import PosesInCamera, Term, no_bound
from getagrip.fitting.energy.homan_terms import SmoothnessTerm, TermInFrame, vertex_moments
from getagrip.fitting.options import Options
from getagrip.fitting.pipeline import repair_input
from getagrip.fitting.problem import prepare_problem
from getagrip.geometry import se3
from getagrip.reconstruct import reconstruct
from getagrip.result import Reconstruction
from getagrip.timelines.observations import GraspClip, TimelineInputs
from getagrip.timelines.segments import (
    ExpectedPoses,
    LinkTerm,
    SupportTerm,
    fit_in_all_frames,
    hull_vertices,
    plane_in_camera,
    solve_grasp,
)
from helpers.clips import box
from helpers.scenes import timeline
from helpers.terms import N, differences, hypotheses_are_independent, is_trustworthy, moved, random_poses, total_hessian

VERTICES = box(0.1, 0.06, 0.04).vertices


def some(kind: str, rng: np.random.Generator) -> Term:
    if kind == "support":
        normal = se3.exp_so3(rng.normal(size=(N, 3)))[:, 0]
        return SupportTerm(hull_vertices(VERTICES), normal, rng.uniform(-0.05, 0.05, N), 1e5, far=0.3)
    K, m = 3, 2
    R = se3.exp_so3(rng.normal(size=(K, m, 3)))
    centre = np.array([0.0, 0.0, 0.5]) + rng.normal(0.0, 0.02, (K, m, 3))
    return LinkTerm(
        vertex_moments(VERTICES), ExpectedPoses(np.array([0, 2]), R, centre, rng.uniform(0.0, 5.0, K)), 1e3, 0.05
    )


@pytest.mark.parametrize("kind", ["support", "link"])
def test_derivatives(kind: str) -> None:
    """By each frame's turn and shift, and by the size."""
    rng = np.random.default_rng(1)
    term, poses = some(kind, rng), random_poses(rng)
    local = term(poses, no_bound(poses))
    expected = differences(lambda p: term(p, no_bound(p)).value, poses, np.full(7, 1e-6))
    np.testing.assert_allclose(local.g, expected, rtol=1e-3, atol=1e-4 * np.abs(local.g).max())
    is_trustworthy(local)
    hypotheses_are_independent(term, poses)


def turned(T: np.ndarray, poses: PosesInCamera) -> PosesInCamera:
    """Poses that the same rigid motion takes elsewhere."""
    return PosesInCamera(T[:3, :3] @ poses.R, se3.transform(T, poses.centre), poses.scale)


@pytest.mark.parametrize("kind", ["support", "link"])
def test_the_frame_of_the_camera_does_not_matter(kind: str) -> None:
    rng = np.random.default_rng(5)
    term, poses = some(kind, rng), random_poses(rng)
    T = se3.rigid(se3.exp_so3(rng.normal(size=3)), rng.normal(0.0, 0.3, 3))
    if isinstance(term, SupportTerm):
        normal = term.normal @ T[:3, :3].T
        other = replace(term, normal=normal, height=term.height + normal @ T[:3, 3])
    else:
        assert isinstance(term, LinkTerm)
        e = term.expected
        other = replace(term, expected=replace(e, R=T[:3, :3] @ e.R, centre=se3.transform(T, e.centre)))
    one, two = term(poses, no_bound(poses)), other(turned(T, poses), no_bound(poses))
    np.testing.assert_allclose(two.value, one.value, rtol=1e-9)
    for part in (slice(0, 3), slice(3, 6)):
        np.testing.assert_allclose(two.g[..., part] @ T[:3, :3], one.g[..., part], rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(two.g[..., 6], one.g[..., 6], rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("kind", ["support", "link"])
def test_the_unit_of_length_does_not_matter(kind: str) -> None:
    """What is given in lengths grows with the unit; an energy per square metre shrinks by its square."""
    rng, k = np.random.default_rng(6), 1000.0
    term, poses = some(kind, rng), random_poses(rng)
    if isinstance(term, SupportTerm):
        other: Term = SupportTerm(
            k * term.vertices, term.normal, k * term.height, term.weight / k**2, far=k * term.far
        )  # fmt: skip
    else:
        assert isinstance(term, LinkTerm)
        expected = replace(term.expected, centre=k * term.expected.centre)
        other = replace(term, moments=vertex_moments(k * VERTICES), expected=expected, slip=k * term.slip)
    larger = PosesInCamera(poses.R, k * poses.centre, poses.scale)
    value = other(larger, no_bound(larger)).value
    np.testing.assert_allclose(value, term(poses, no_bound(poses)).value, rtol=1e-9)


def test_the_frame_of_the_world_does_not_matter() -> None:
    rng = np.random.default_rng(7)
    T_world_cam = se3.rigid(se3.exp_so3(rng.normal(size=(N, 3))), rng.normal(size=(N, 3)))
    T_new_world = se3.rigid(se3.exp_so3(rng.normal(size=3)), rng.normal(size=3))
    poses, inner = random_poses(rng), SmoothnessTerm(vertex_moments(VERTICES), 1e4)
    one, other = (TermInFrame(inner, T)(poses, no_bound(poses)) for T in (T_world_cam, T_new_world @ T_world_cam))
    assert one.cross is not None
    assert other.cross is not None
    for a, b in ((one.value, other.value), (one.g, other.g), (one.H, other.H), (one.cross, other.cross)):
        np.testing.assert_allclose(a, b, rtol=1e-6, atol=1e-6 * np.abs(a).max())


def test_the_plane_before_the_camera_is_the_plane_of_the_world() -> None:
    """Any point is as high above the one as above the other."""
    rng = np.random.default_rng(8)
    T_world_cam = se3.rigid(se3.exp_so3(rng.normal(size=(N, 3))), rng.normal(size=(N, 3)))
    up, support, X = se3.exp_so3(rng.normal(size=3))[0], 0.7, rng.normal(size=(20, 3))
    normal, height = plane_in_camera(T_world_cam, up, support)
    before = se3.transform(se3.inverse(T_world_cam), X[None])
    np.testing.assert_allclose(
        np.sum(before * normal[:, None], axis=-1) - height[:, None], (X @ up - support)[None].repeat(N, 0)
    )


def test_a_term_in_the_world_sees_no_moving_camera() -> None:
    """Derivatives, frames tied to each other included; what stands still in the world is smooth."""
    rng = np.random.default_rng(4)
    T_world_cam = se3.rigid(se3.exp_so3(rng.normal(0.0, 0.1, (N, 3))), rng.normal(0.0, 0.01, (N, 3)))
    term = TermInFrame(SmoothnessTerm(vertex_moments(VERTICES), 1e4), T_world_cam)
    poses = random_poses(rng)
    local = term(poses, no_bound(poses))
    steps = np.zeros((N, 7))
    for n in range(N):
        for k in range(6):
            steps[:] = 0.0
            steps[n, k] = 1e-6
            ahead, behind = (moved(poses, sign * steps) for sign in (1.0, -1.0))
            rise = (term(ahead, no_bound(ahead)).value - term(behind, no_bound(behind)).value).sum(axis=1) / 2e-6
            np.testing.assert_allclose(local.g[:, n, k], rise, rtol=1e-4, atol=1e-5 * np.abs(local.g).max())
    H = total_hessian(local)
    np.testing.assert_allclose(H, np.swapaxes(H, -1, -2), atol=1e-6 * np.abs(H).max())
    still = se3.inverse(T_world_cam) @ np.eye(4)
    one = PosesInCamera(still[None, :, :3, :3].copy(), still[None, :, :3, 3].copy(), np.ones(1))
    assert term(one, no_bound(one)).value.sum() == pytest.approx(0.0, abs=1e-9)


def test_what_touches_the_plane_costs_nothing() -> None:
    R = se3.exp_so3(np.array([[[0.2, 0.0, 0.3]]]))
    lowest = (VERTICES @ R[0, 0].T)[:, 1].max()  # down is y
    poses = PosesInCamera(R, np.array([[[0.1, 0.3 - lowest, 0.5]]]), np.ones(1))
    term = SupportTerm(VERTICES, np.array([[0.0, -1.0, 0.0]]), np.array([-0.3]), 1e5)
    assert term(poses, no_bound(poses)).value == pytest.approx(0.0, abs=1e-9)


def test_a_link_costs_no_more_than_its_weight_and_nothing_at_a_hypothesis() -> None:
    rng = np.random.default_rng(2)
    poses = random_poses(rng, 1, 3)
    expected = ExpectedPoses(np.arange(3), poses.R.copy(), poses.centre.copy(), np.zeros(1))
    term = LinkTerm(vertex_moments(VERTICES), expected, 100.0, 0.01)
    one = PosesInCamera(poses.R, poses.centre, np.ones(1))
    assert term(one, no_bound(one)).value.sum() == pytest.approx(0.0, abs=1e-9)
    away = PosesInCamera(poses.R, poses.centre + 5.0, np.ones(1))
    assert 99.0 < term(away, no_bound(away)).value.sum() < 100.0


FEW = Options(inits=20)


def before_camera(result: Reconstruction, clip: Clip) -> ndarray:
    """Vertices (T, V, 3) as they were found."""
    T_cam_hand = clip.hand.T_cam_hand if result.T_cam_hand is None else result.T_cam_hand
    return se3.transform(T_cam_hand @ result.T_hand_obj, clip.mesh.vertices)


def apart(a: ndarray, b: ndarray) -> float:
    """Mean distance of vertices in the worst frame, in the mug's diameter."""
    return float(np.linalg.norm(a - b, axis=-1).mean(axis=-1).max()) / timeline()[0].mesh.diameter


@pytest.mark.slow
def test_a_grasp_of_a_timeline_is_solved_as_a_grasp_by_itself() -> None:
    """To the bit, where mesh and masks are taken as they are; then neighbours and the correction of depth are added."""
    clip, masks = timeline()
    segment = Segment("grasp", 0, 7, clip.side)
    rows = clip.segments[2].rows
    alone, seen = replace(clip, segments=()).take(rows), masks.take(rows)
    footage = TimelineInputs.of(repair_input(with_masks(replace(alone, segments=(segment,)), seen), FEW))
    grasp = GraspClip.of(footage.clip, segment)
    assert grasp is not None
    found = fit_in_all_frames(solve_grasp(grasp, prepare_problem(grasp.clip, FEW), []), 0, [])
    expected = reconstruct(alone, seen, replace(FEW, mesh="as-given", masks="as-given"))
    np.testing.assert_array_equal(found.track.T_hand_obj[0], expected.T_hand_obj)
    assert found.axis is not None
    np.testing.assert_array_equal(found.axis.angle, expected.axis.angle)
    np.testing.assert_array_equal(found.solutions.energy[0], expected.energy["total"])
    whole = reconstruct(replace(alone, segments=(segment,)), seen, FEW)
    assert apart(before_camera(whole, alone), before_camera(expected, alone)) < 0.05
    assert whole.segments[0].signs.keys() == expected.signs.keys()
