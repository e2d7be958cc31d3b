"""The paper's push and pull: what the appendix says, in numpy; derivatives."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy import ndarray

from getagrip.fitting.energy import PosesInCamera, Term, no_bound
from getagrip.fitting.energy.contact import HandContacts
from getagrip.fitting.energy.paper_contact import PaperPullTerm, PaperPushTerm, TangentPlanes
from getagrip.geometry import se3
from getagrip.geometry.mesh import Mesh
from helpers.clips import small_clip
from helpers.terms import MESHES, differences, hypotheses_are_independent, is_trustworthy, random_poses

pytestmark = pytest.mark.compiles

FRAMES = 3


def planes(rng: np.random.Generator, spread: float = 0.03) -> TangentPlanes:
    """Planes at random about half a metre before the camera."""
    point = np.array([0.0, 0.0, 0.5])[:, None] + rng.normal(0.0, spread, (FRAMES, 3, 26))
    normal = rng.normal(size=point.shape)
    return TangentPlanes(point, normal / np.linalg.norm(normal, axis=1, keepdims=True))


def push_of(mesh: Mesh, hand: TangentPlanes) -> PaperPushTerm:
    vertices = np.ascontiguousarray((mesh.vertices - mesh.centre).T)
    return PaperPushTerm(vertices, hand, 10.0 * np.arange(1, FRAMES + 1))


def pull_of(mesh: Mesh, hand: TangentPlanes) -> PaperPullTerm:
    """The fingertips are the first of the planes' points: five of four vertices each."""
    contacts = HandContacts(np.ascontiguousarray(np.swapaxes(hand.point, 1, 2)), np.arange(0, 24, 4))
    vertices = np.ascontiguousarray((mesh.vertices - mesh.centre).T)
    return PaperPullTerm(vertices, np.ascontiguousarray(mesh.normals.T), contacts, np.full(FRAMES, 100.0))


def posed(mesh: Mesh, poses: PosesInCamera, b: int, n: int) -> tuple[ndarray, ndarray]:
    """Vertices and normals in the camera frame."""
    R = poses.R[b, n]
    return poses.scale[b] * (mesh.vertices - mesh.centre) @ R.T + poses.centre[b, n], mesh.normals @ R.T


@pytest.mark.parametrize("which", sorted(MESHES))
def test_push_is_what_the_appendix_says(which: str) -> None:
    rng = np.random.default_rng(0)
    mesh, hand, poses = MESHES[which], planes(rng), random_poses(rng, 2, FRAMES)
    term = push_of(mesh, hand)
    value = term(poses, no_bound(poses)).value
    for b in range(2):
        for n in range(FRAMES):
            v_o, _ = posed(mesh, poses, b, n)
            v_h, n_h = hand.point[n].T, hand.normal[n].T
            nearest = np.argmin(np.linalg.norm(v_o[:, None] - v_h, axis=-1), axis=1)
            d = np.sum((v_o - v_h[nearest]) * n_h[nearest], axis=1)
            assert value[b, n] == pytest.approx(term.weight[n] * np.sum(-np.minimum(d, 0.0)), rel=1e-3)
            assert value[b, n] > 0.0


@pytest.mark.parametrize("which", sorted(MESHES))
def test_pull_is_what_the_appendix_says(which: str) -> None:
    rng = np.random.default_rng(1)
    mesh, hand, poses = MESHES[which], planes(rng), random_poses(rng, 2, FRAMES)
    term = pull_of(mesh, hand)
    value = term(poses, no_bound(poses)).value
    for b in range(2):
        for n in range(FRAMES):
            v_o, n_o = posed(mesh, poses, b, n)
            expected = 0.0
            for region in np.split(term.hand.position[n, :20], 5):
                between = region[:, None] - v_o
                height = np.sum(between * n_o, axis=-1)
                expected += abs(height.ravel()[np.argmin(np.linalg.norm(between, axis=-1))]) / 5
            assert value[b, n] == pytest.approx(100.0 * expected, abs=1e-4)


@pytest.mark.parametrize("name", ["push", "pull"])
@pytest.mark.parametrize("which", sorted(MESHES))
def test_gradients(name: str, which: str) -> None:
    rng = np.random.default_rng(2)
    mesh, hand, poses = MESHES[which], planes(rng), random_poses(rng, 2, FRAMES)
    term: Term = push_of(mesh, hand) if name == "push" else pull_of(mesh, hand)
    # Steps too small for another pair to become the nearest.
    expected = differences(lambda p: term(p, no_bound(p)).value, poses, np.full(7, 1e-8))
    g = term(poses, no_bound(poses)).g
    np.testing.assert_allclose(g, expected, rtol=1e-4, atol=1e-4 * np.abs(expected).max())


@pytest.mark.parametrize("depth", [0.0001, 0.001, 0.0019, 0.01])
def test_push_keeps_its_slope_near_the_surface(depth: float) -> None:
    """One vertex behind one plane: the energy is linear in its depth."""
    point, normal = np.tile([[0.0], [0.0], [0.5]], (FRAMES, 1, 1)), np.tile([[0.0], [0.0], [1.0]], (FRAMES, 1, 1))
    term = PaperPushTerm(np.zeros((3, 1)), TangentPlanes(point, normal), np.full(FRAMES, 10.0))
    centre = np.tile([0.0, 0.0, 0.5 - depth], (1, FRAMES, 1))
    poses = PosesInCamera(np.tile(np.eye(3), (1, FRAMES, 1, 1)), centre, np.ones(1))
    local = term(poses, no_bound(poses))
    expected = differences(lambda p: term(p, no_bound(p)).value, poses, np.full(7, 1e-5))
    np.testing.assert_allclose(local.value, 10.0 * depth)
    np.testing.assert_allclose(local.g, expected, atol=1e-6)
    np.testing.assert_allclose(local.g[..., 2], -10.0)


@settings(max_examples=10)
@given(st.sampled_from(sorted(MESHES)), st.integers(0, 10**6))
def test_hessians_can_be_trusted(which: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    hand, poses = planes(rng), random_poses(rng, 2, FRAMES)
    for term in (push_of(MESHES[which], hand), pull_of(MESHES[which], hand)):
        is_trustworthy(term(poses, no_bound(poses)))
        hypotheses_are_independent(term, poses)


def test_pull_draws_the_object_back_that_leaves() -> None:
    mesh, hand = MESHES["box"], planes(np.random.default_rng(3))
    away = np.array([0.1, 0.2, 0.4])
    centre = np.array([0.0, 0.0, 0.5]) + np.stack([away, np.zeros(3), np.zeros(3)], axis=1)[:, None]
    poses = PosesInCamera(np.tile(np.eye(3), (3, FRAMES, 1, 1)), np.tile(centre, (1, FRAMES, 1)), np.ones(3))
    local = pull_of(mesh, hand)(poses, no_bound(poses))
    assert (np.diff(local.value, axis=0) > 0.0).all()
    assert (local.g[..., 0] > 0.0).all()


@given(st.sampled_from(sorted(MESHES)), st.integers(0, 10**6), st.floats(0.01, 100.0))
@settings(max_examples=20)
def test_neither_term_is_ever_below_zero(which: str, seed: int, size: float) -> None:
    """Without this bound an object of free scale grows round the fingertips, and the energy falls without end."""
    rng = np.random.default_rng(seed)
    hand, poses = planes(rng), random_poses(rng, 2, FRAMES)
    poses = PosesInCamera(poses.R, poses.centre, size * poses.scale)
    for term in (push_of(MESHES[which], hand), pull_of(MESHES[which], hand)):
        assert (term(poses, no_bound(poses)).value >= 0.0).all()


def test_planes_touch_the_hand_wherever_the_camera_is() -> None:
    clip, _ = small_clip()
    hand = TangentPlanes.of(clip.hand)
    ids = np.concatenate([clip.hand.regions[name] for name in sorted(clip.hand.regions)])
    in_camera = se3.transform(clip.hand.T_cam_hand, clip.hand.vertices[:, ids])
    assert {tuple(p) for p in np.swapaxes(hand.point, 1, 2)[0].round(9)} == {tuple(p) for p in in_camera[0].round(9)}
    np.testing.assert_allclose(np.linalg.norm(hand.normal, axis=1), 1.0)
    middle = se3.transform(clip.hand.T_cam_hand, clip.hand.vertices).mean(axis=1)
    assert (np.sum((hand.point - middle[..., None]) * hand.normal, axis=1) > 0.0).all()  # out of a convex hand
