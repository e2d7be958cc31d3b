"""The term of order in depth: the side of the surface that a point is on, and derivatives of its error."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from getagrip.clip import Masks
from getagrip.fitting.energy import PosesInCamera, no_bound, occlusion_order
from getagrip.fitting.energy.occlusion_order import HandOrder, OrderTerm, corners_of
from getagrip.geometry import se3
from getagrip.geometry.mesh import Mesh
from getagrip.geometry.rasterize import depth_and_face
from helpers.clips import box
from helpers.scenes import SHORT, scene
from helpers.terms import MESHES, N, moved, random_poses

DEEP, NEAR = 0.55, 0.45


def term_of(mesh: Mesh, points: np.ndarray, side: int, cap: float = 1.0) -> OrderTerm:
    """The term for points at all frames, all on one side."""
    hand = HandOrder(np.tile(points, (N, 1, 1)), np.full((N, len(points)), side, np.int8))
    return OrderTerm(corners_of(mesh), hand, np.full(N, 3.0), cap=cap)


def still(centre: tuple[float, float, float] = (0.0, 0.0, 0.5), scale: float = 1.0) -> PosesInCamera:
    """A box before the camera."""
    R = np.tile(np.eye(3), (1, N, 1, 1))
    return PosesInCamera(R, np.tile(np.array(centre), (1, N, 1)), np.full(1, scale))


@pytest.mark.parametrize(("z", "side", "off"), [(DEEP, 1, 0.1), (NEAR, 1, 0.0), (DEEP, -1, 0.0), (NEAR, -1, 0.0)])
def test_a_point_that_is_seen_is_not_behind_the_surface(z: float, side: int, off: float) -> None:
    mesh = box(0.1, 0.1, 0.1)  # its front is at the near point
    term = term_of(mesh, np.array([[0.0, 0.0, z]]), side)
    poses = still()
    np.testing.assert_allclose(term(poses, no_bound(poses)).value, 3.0 * max(0.0, off - term.tolerance), atol=1e-9)


def test_a_point_that_is_hidden_is_not_before_the_surface() -> None:
    term, poses = term_of(box(0.1, 0.1, 0.1), np.array([[0.0, 0.0, 0.4]]), -1), still()
    np.testing.assert_allclose(term(poses, no_bound(poses)).value, 3.0 * (0.05 - term.tolerance), atol=1e-9)


def test_beside_the_object_nothing_is_wrong_and_far_off_costs_no_more() -> None:
    aside, poses = term_of(box(0.1, 0.1, 0.1), np.array([[0.2, 0.0, DEEP]]), 1), still()
    assert not aside(poses, no_bound(poses)).value.any()
    far = term_of(box(0.1, 0.1, 0.1), np.array([[0.0, 0.0, 2.0]]), 1, cap=0.04)(poses, no_bound(poses))
    np.testing.assert_allclose(far.value, 3.0 * 0.04)
    assert not far.g.any()


@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize("kind", list(MESHES))
def test_derivatives(kind: str, side: int) -> None:
    rng = np.random.default_rng(11)
    points = np.array([0.0, 0.0, 0.5 + side * 0.12]) + rng.normal(0.0, 0.008, (7, 3))
    term, poses, h = term_of(MESHES[kind], points, side), random_poses(rng), 1e-7
    found = term(poses, no_bound(poses))
    for n in range(N):
        for k in range(6):
            step = np.zeros((N, 7))
            step[n, k] = h
            up, down = (term(moved(poses, s * step), no_bound(poses)).value.sum(axis=1) for s in (1.0, -1.0))
            expected = (up - down) / (2.0 * h)
            grazing = np.abs(found.g[:, n, k] - expected) > 1e-3 * np.abs(found.g).max()
            assert grazing.sum() == 0
    grown = h * np.eye(7)[6]
    up, down = (term(moved(poses, s * grown), no_bound(poses)).value.sum(axis=1) for s in (1.0, -1.0))
    expected = (up - down) / (2.0 * h)
    np.testing.assert_allclose(found.g[..., 6].sum(axis=1), expected, atol=1e-3 * np.abs(found.g).max())
    assert (np.linalg.eigvalsh(found.H) >= -1e-9 * max(1.0, np.abs(found.H).max())).all()


def test_no_way_of_looking_matters() -> None:
    rng = np.random.default_rng(2)
    points = np.array([0.0, 0.0, 0.62]) + rng.normal(0.0, 0.01, (5, 3))
    poses, T = random_poses(rng), se3.exp_so3(np.array([0.2, -0.1, 0.4]))
    mesh = MESHES["mug"]
    value = term_of(mesh, points, 1)(poses, no_bound(poses)).value
    turned = PosesInCamera(T @ poses.R, poses.centre @ T.T, poses.scale)
    np.testing.assert_allclose(term_of(mesh, points @ T.T, 1)(turned, no_bound(turned)).value, value, atol=1e-9)
    assert value.any()


def test_the_true_pose_costs_less_than_one_before_or_behind_the_hand() -> None:
    clip, _ = scene("mug", 1, SHORT)
    assert clip.truth is not None
    hands = se3.transform(clip.hand.T_cam_hand, clip.hand.vertices)
    objects = se3.transform(clip.truth.T_cam_obj, clip.mesh.vertices)
    sees = [
        (depth_and_face(hand, clip.hand.faces, K, clip.size)[0], depth_and_face(mesh, clip.mesh.faces, K, clip.size)[0])
        for hand, mesh, K in zip(hands, objects, clip.K, strict=True)
    ]
    shown = np.array([hand < mesh for hand, mesh in sees])
    seen = np.array([mesh < hand for hand, mesh in sees])
    hand = HandOrder.of(clip.hand, clip.K, Masks(seen, shown, shown))
    assert (hand.side == 1).any()
    assert set(np.unique(hand.side)) <= {-1, 0, 1}
    T = clip.truth.T_cam_obj
    centre = se3.transform(T, clip.mesh.centre[None])[:, 0]
    ray = centre / np.linalg.norm(centre, axis=-1, keepdims=True)
    shifts = np.array([0.0, -0.05, -0.1])
    poses = PosesInCamera(np.tile(T[:, :3, :3], (3, 1, 1, 1)), centre + shifts[:, None, None] * ray, np.ones(3))
    term = OrderTerm(corners_of(clip.mesh), hand, np.ones(len(T)), cap=1.0)
    value = term(poses, no_bound(poses)).value.sum(axis=1)
    assert value[0] < value[1] < value[2]


@pytest.mark.parametrize("near", [1, 4, 30])
def test_what_lies_well_within_a_mask_is_what_erosion_leaves(near: int) -> None:
    rng = np.random.default_rng(near)
    mask = cv2.GaussianBlur(rng.random((40, 60)), (0, 0), 6.0) > 0.48
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * near + 1, 2 * near + 1))
    v, u = np.indices(mask.shape).reshape(2, -1)
    left = cv2.erode(mask.astype(np.uint8), disc).astype(bool)
    np.testing.assert_array_equal(occlusion_order._disc_in_mask(mask, u, v, disc > 0), left.ravel())
    whole = np.ones_like(mask)
    assert occlusion_order._disc_in_mask(whole, u, v, disc > 0).all()  # what is beyond the image is unknown
