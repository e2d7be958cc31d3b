"""Contact vertices, push and pull: the specification, derivatives, and what neither term may depend on."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy import ndarray

from getagrip.fitting.energy import PosesInCamera, no_bound
from getagrip.fitting.energy.contact import (
    HandContacts,
    PullTerm,
    PushTerm,
    build_contact_grid,
    farthest_point_sampling,
)
from getagrip.geometry import se3
from getagrip.geometry.mesh import Mesh
from helpers import kernels as reference
from helpers.clips import small_clip
from helpers.terms import MESHES, differences, hypotheses_are_independent, is_trustworthy, random_poses


def test_contact_vertices_are_the_regions_fingertips_first() -> None:
    hand = small_clip()[0].hand
    contact = HandContacts.of(hand)
    assert contact.position.shape == (3, 12, 3)
    np.testing.assert_array_equal(contact.region, [0, 2, 4, 6, 8, 10])
    thumb = se3.transform(hand.T_cam_hand, hand.vertices[:, hand.regions["thumb"]])
    np.testing.assert_allclose(contact.position[:, :2], thumb)
    assert HandContacts.of(hand, per_region=1).position.shape == (3, 6, 3)
    np.testing.assert_array_equal(contact.take(np.array([2])).position, contact.position[[2]])


def test_spread_points_cover_a_line() -> None:
    line = np.column_stack([np.linspace(0.0, 1.0, 101), np.zeros((101, 2))])
    np.testing.assert_array_equal(farthest_point_sampling(line, 3), [0, 50, 100])
    np.testing.assert_array_equal(farthest_point_sampling(line[:2], 3), [0, 1])


def contacts(rng: np.random.Generator, frames: int, spread: float = 0.03) -> HandContacts:
    """Five fingertips of four vertices each, and a palm of six, about half a metre before the camera."""
    position = np.array([0.0, 0.0, 0.5]) + rng.normal(0.0, spread, (frames, 26, 3))
    return HandContacts(position, np.arange(0, 24, 4))


def physical_terms(mesh: Mesh, hand: HandContacts, delta: float = 0.002) -> tuple[PushTerm, PullTerm]:
    frames = len(hand.position)
    body, weight = build_contact_grid(mesh, mesh.centre), 1000.0 * np.arange(1, frames + 1)
    # Half a millimetre, for the mug's wall is thin.
    return PushTerm(body, hand, weight, tolerance=5e-4, delta=delta), PullTerm(body, hand, weight, 0.01, delta=delta)


def heights(mesh: Mesh, hand: HandContacts, poses: PosesInCamera, b: int, n: int) -> ndarray:
    """Signed distances of the contact vertices to the posed object, by the specification [m]."""
    local = (hand.position[n] - poses.centre[b, n]) @ poses.R[b, n] / poses.scale[b]
    corners = mesh.vertices[mesh.faces] - mesh.centre
    return poses.scale[b] * reference.signed_distance(local, corners, mesh.planes[:, :3])[0]


@pytest.mark.parametrize("which", sorted(MESHES))
@pytest.mark.slow
def test_push_and_pull_are_what_the_specification_says(which: str) -> None:
    rng = np.random.default_rng(5)
    mesh, hand, poses = MESHES[which], contacts(rng, 3), random_poses(rng, 2, 3)
    hand.position[:, ::2] += 0.5 * (poses.centre[0, :, None] - hand.position[:, ::2])  # some inside
    push, pull = physical_terms(mesh, hand)
    pushed, pulled = (term(poses, no_bound(poses)).value for term in (push, pull))
    for b in range(2):
        for n in range(3):
            d = heights(mesh, hand, poses, b, n)
            # A distance grid knows the nearest face but for a few points, most of them halfway between two.
            expected = reference.push(d, push.weight[n], push.tolerance)
            assert pushed[b, n] == pytest.approx(expected, abs=1e-4 * push.weight[n])
            expected = reference.pull(d, hand.region, pull.weight[n], pull.max_distance)
            assert pulled[b, n] == pytest.approx(expected, abs=1e-4 * pull.weight[n])


@pytest.mark.parametrize("name", ["push", "pull"])
@pytest.mark.parametrize("which", sorted(MESHES))
def test_gradients_of_push_and_pull(name: str, which: str) -> None:
    rng = np.random.default_rng(11)
    hand = contacts(rng, 3)
    mesh = MESHES[which]
    term = physical_terms(mesh, hand, delta=1e-9)[name == "pull"]
    poses = random_poses(rng, 4, 3)
    for n in range(3):  # some vertices just below the surface of the first hypothesis
        face = rng.integers(len(mesh.faces), size=8)
        depth = rng.uniform(6e-4, 2e-3, (8, 1))
        inside = mesh.vertices[mesh.faces[face]].mean(axis=1) - depth * mesh.planes[face, :3] - mesh.centre
        hand.position[n, ::3][:8] = poses.scale[0] * inside @ poses.R[0, n].T + poses.centre[0, n]
    local = term(poses, no_bound(poses))
    assert (local.value[0] > 0).all()
    expected = differences(lambda p: term(p, no_bound(p)).value, poses, np.full(7, 1e-7))
    np.testing.assert_allclose(local.g, expected, rtol=1e-4, atol=1e-4 * np.abs(expected).max())


@settings(max_examples=15)
@given(st.sampled_from(sorted(MESHES)), st.integers(0, 10**6))
@pytest.mark.slow
def test_hessians_of_push_and_pull(which: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    hand, poses = contacts(rng, 2), random_poses(rng, 2, 2)
    for term in physical_terms(MESHES[which], hand):
        is_trustworthy(term(poses, no_bound(poses)))


def test_nothing_pushes_outside() -> None:
    rng = np.random.default_rng(1)
    mesh = MESHES["box"]
    direction = rng.normal(size=(2, 26, 3))
    far = np.array([0.0, 0.0, 0.5]) + 0.065 * direction / np.linalg.norm(direction, axis=-1, keepdims=True)
    hand = HandContacts(far, np.arange(0, 24, 4))
    poses = PosesInCamera(np.tile(np.eye(3), (1, 2, 1, 1)), np.tile([0.0, 0.0, 0.5], (1, 2, 1)), np.ones(1))
    local = physical_terms(mesh, hand)[0](poses, no_bound(poses))
    for array in (local.value, local.g, local.H):
        assert not array.any()


def test_a_little_depth_does_not_push() -> None:
    mesh, give = MESHES["box"], 0.004
    face, out = mesh.vertices[mesh.faces[0]].mean(axis=0) - mesh.centre, mesh.planes[0, :3]
    poses = PosesInCamera(np.eye(3)[None, None], np.array([[[0.0, 0.0, 0.5]]]), np.ones(1))
    for depth in (0.0, 0.9 * give, 1.5 * give):
        hand = HandContacts(np.tile(poses.centre[0, 0] + face - depth * out, (1, 26, 1)), np.arange(0, 24, 4))
        local = PushTerm(build_contact_grid(mesh, mesh.centre), hand, np.ones(1), tolerance=give)(
            poses, no_bound(poses)
        )
        assert local.value[0, 0] == pytest.approx(max(0.0, depth - give), abs=1e-6)
        assert local.g.any() == (depth > give)


def test_fingers_on_the_surface_do_not_pull() -> None:
    rng = np.random.default_rng(2)
    mesh = MESHES["mug"]
    hand, poses = contacts(rng, 1), random_poses(rng, 1, 1)
    corners = mesh.vertices[mesh.faces[rng.integers(len(mesh.faces), size=5)]] - mesh.centre
    touching = poses.scale[0] * corners.mean(axis=1) @ poses.R[0, 0].T + poses.centre[0, 0]
    hand.position[0, hand.region[:5]] = touching
    local = physical_terms(mesh, hand)[1](poses, no_bound(poses))
    np.testing.assert_allclose(local.value, 0.0, atol=1e-9)
    np.testing.assert_allclose(local.g, 0.0, atol=1e-6)


def test_a_far_finger_holds_nothing() -> None:
    rng = np.random.default_rng(3)
    hand, poses = contacts(rng, 1), random_poses(rng, 1, 1)
    hand.position[:] = poses.centre[0] + [0.5, 0.0, 0.0]
    push, pull = physical_terms(MESHES["mug"], hand)
    local = pull(poses, no_bound(poses))
    np.testing.assert_allclose(local.value, pull.weight[0] * pull.max_distance)
    assert not local.g.any()
    assert not push(poses, no_bound(poses)).value.any()


@settings(max_examples=10)
@given(st.integers(0, 10**6))
@pytest.mark.slow
def test_contact_does_not_depend_on_the_camera(seed: int) -> None:
    rng = np.random.default_rng(seed)
    hand, poses = contacts(rng, 2), random_poses(rng, 2, 2)
    T = se3.rigid(se3.exp_so3(rng.normal(size=3)), rng.normal(size=3))
    R, t = T[:3, :3], T[:3, 3]
    turned = PosesInCamera(R @ poses.R, poses.centre @ R.T + t, poses.scale)
    seen = replace(hand, position=se3.transform(T, hand.position.reshape(-1, 3)).reshape(hand.position.shape))
    for here, there in zip(physical_terms(MESHES["mug"], hand), physical_terms(MESHES["mug"], seen), strict=True):
        a, b = here(poses, no_bound(poses)), there(turned, no_bound(turned))
        np.testing.assert_allclose(a.value, b.value, atol=1e-6)
        # Translation and rotation turn with the camera, scale does not.
        np.testing.assert_allclose(a.g[..., :3] @ R.T, b.g[..., :3], atol=1e-3)
        np.testing.assert_allclose(a.g[..., 3:6] @ R.T, b.g[..., 3:6], atol=1e-3)
        np.testing.assert_allclose(a.g[..., 6], b.g[..., 6], atol=1e-3)


def test_hypotheses_do_not_know_of_each_other() -> None:
    rng = np.random.default_rng(4)
    hand, poses = contacts(rng, 2), random_poses(rng, 3, 2)
    for term in physical_terms(MESHES["mug"], hand):
        hypotheses_are_independent(term, poses)
