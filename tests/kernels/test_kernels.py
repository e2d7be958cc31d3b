"""Every kernel against its readable specification, on random poses of closed, open, compound and broken meshes."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from numpy import ndarray

from getagrip.datasets.synthetic import shapes
from getagrip.fitting import observation
from getagrip.fitting.energy.mask import SilhouetteMesh
from getagrip.fitting.observation import _boundary
from getagrip.geometry import se3
from getagrip.geometry.mesh import Mesh
from getagrip.kernels import contour, reference
from getagrip.kernels.closest import SLACK, FaceGrid, screen, signed_distance
from getagrip.kernels.silhouette import (
    NEAR,
    PLANES,
    mismatch,
    pack,
    project,
    rasterise,
    silhouette_edges,
    silhouettes,
    unpack,
)
from helpers.clips import box

SEEDS = st.integers(0, 2**32 - 1)
"""Random numbers come from numpy, not from hypothesis, which loves the round ones: pixel centres exactly on an edge."""


def _soup(seed: int) -> Mesh:
    """Triangles that share vertices but no sense: edges of one to several faces, wound any way."""
    rng = np.random.default_rng(seed)
    faces = np.array([rng.permutation(12)[:3] for _ in range(10)])
    return Mesh(rng.uniform(-0.05, 0.05, (12, 3)), faces)


def _sheet() -> Mesh:
    """An open, curved sheet."""
    x, y = np.meshgrid(np.linspace(-0.05, 0.05, 6), np.linspace(-0.04, 0.04, 5))
    at = np.arange(30).reshape(5, 6)
    a, b, c, d = (at[i : i + 4, j : j + 5].ravel() for i in (0, 1) for j in (0, 1))
    vertices = np.stack([x, y, 5.0 * x**2], axis=-1).reshape(-1, 3)
    return Mesh(vertices, np.concatenate([np.stack([a, b, c], 1), np.stack([b, d, c], 1)]))


def _two_boxes() -> Mesh:
    """Two closed parts that cut through each other, the second wound inward."""
    a, b = box(0.09, 0.05, 0.03), box(0.03, 0.08, 0.06)
    return Mesh(np.concatenate([a.vertices, b.vertices + 0.01]), np.concatenate([a.faces, b.faces[:, ::-1] + 8]))


MESHES = {
    "box": box(0.1, 0.06, 0.04),
    "mug": shapes.mug(),
    "two boxes": _two_boxes(),
    "sheet": _sheet(),
    "soup": _soup(3),
}
WHICH = st.sampled_from(sorted(MESHES))
SIZE = 64


def _pose(seed: int, away: float = 0.4) -> tuple[ndarray, ndarray, float, ndarray]:
    """R, centre, scale, K: something of the size of a hand in a picture of 64 pixels, at times partly outside."""
    rng = np.random.default_rng(seed)
    R = se3.exp_so3(rng.normal(size=3) * 2.0)
    centre = np.array([*rng.uniform(-0.08, 0.08, 2), away + rng.uniform(-0.1, 0.1)])
    K = np.array([170.0, 175.0, 31.0, 33.0]) + rng.uniform(-2.0, 2.0, 4)
    return R, centre, float(rng.uniform(0.7, 1.4)), K


def _tables(mesh: Mesh) -> Surface:
    return SilhouetteMesh.of(mesh, np.zeros(3))


def _outlined(mesh: Mesh, seed: int) -> tuple[ndarray, ndarray, ndarray]:
    """Projected vertices (3, V), outline edges (3, n), and the mask as bits, by the kernels."""
    R, centre, scale, K = _pose(seed)
    t = _tables(mesh)
    uvz, edge = np.empty_like(t.vertices), np.empty((3, t.edges.shape[1] + 1), np.int64)
    project(t.vertices, R, centre, scale, K, uvz)
    n = silhouette_edges(t.planes, t.edges, R, centre, scale, np.empty(len(mesh.faces) + 1, np.int64), edge)
    bits = np.empty((SIZE, 1), np.uint64)
    lines, planes = np.empty((5, len(edge[0]))), np.empty((SIZE, 1, PLANES), np.uint64)
    rasterise(uvz, edge, n, t.closed, 1.0, lines, planes, bits)
    return uvz, edge[:, :n], bits


def _blobs(seed: int, size: int = SIZE) -> tuple[ndarray, ndarray]:
    """A mask of overlapping discs, and pixels that count: all but a disc."""
    rng = np.random.default_rng(seed)
    i, j = np.indices((size, size)) + 0.5

    def disc() -> ndarray:
        y, x = rng.uniform(0.2, 0.8, 2) * size
        return np.asarray((i - y) ** 2 + (j - x) ** 2 < (rng.uniform(0.08, 0.25) * size) ** 2)

    seen = disc() | disc()
    return seen, ~disc() | seen


# Silhouettes


@given(WHICH, SEEDS)
def test_projection(which: str, seed: int) -> None:
    mesh = MESHES[which]
    R, centre, scale, K = _pose(seed)
    uvz = np.empty((3, len(mesh.vertices)))
    visible = project(np.ascontiguousarray(mesh.vertices.T), R, centre, scale, K, uvz)
    expected = reference.project(mesh.vertices, R, centre, scale, K)
    np.testing.assert_allclose(uvz.T, expected, rtol=1e-12, atol=1e-12)
    assert visible == (expected[:, 2].min() >= NEAR)


@given(WHICH, SEEDS)
def test_silhouette_edges(which: str, seed: int) -> None:
    mesh = MESHES[which]
    uvz, edges, _ = _outlined(mesh, seed)
    np.testing.assert_array_equal(edges.T, reference.silhouette_edges(uvz.T, mesh.edges, mesh.faces))


@given(WHICH, SEEDS)
@pytest.mark.slow
def test_a_silhouette_covers_what_its_faces_cover(which: str, seed: int) -> None:
    mesh = MESHES[which]
    uvz, _, bits = _outlined(mesh, seed)
    np.testing.assert_array_equal(unpack(bits, SIZE), reference.silhouette(uvz.T, mesh.faces, (SIZE, SIZE)))


@settings(max_examples=10)
@given(st.integers(0, 10**6))
def test_any_triangle_soup_has_a_silhouette(seed: int) -> None:
    mesh = _soup(seed)
    uvz, _, bits = _outlined(mesh, seed)
    np.testing.assert_array_equal(unpack(bits, SIZE), reference.silhouette(uvz.T, mesh.faces, (SIZE, SIZE)))


@settings(max_examples=10)
@given(WHICH, SEEDS, st.integers(5, 90), st.integers(5, 150))
@pytest.mark.slow
def test_silhouettes_of_many_poses_in_images_of_any_size(which: str, seed: int, height: int, width: int) -> None:
    mesh = MESHES[which]
    poses = [_pose(seed + k) for k in range(4)]
    R, centre, scale, K = (np.array(x) for x in zip(*poses, strict=True))
    centre[3, 2] = NEAR  # this one reaches behind the camera: nothing is drawn
    t = _tables(mesh)
    bits = np.empty((4, height, -(-width // 64)), np.uint64)
    silhouettes(R, centre, scale, t.vertices, t.planes, t.edges, t.closed, K, bits)
    for k, mask in enumerate(unpack(bits, width)):
        uvz = reference.project(mesh.vertices, R[k], centre[k], scale[k], K[k])
        np.testing.assert_array_equal(mask, reference.silhouette(uvz, mesh.faces, (height, width)))
    assert not unpack(bits, width)[3].any()


def test_a_silhouette_may_fill_the_image_or_miss_it() -> None:
    t = _tables(box(0.2, 0.2, 0.2))
    K = np.tile([100.0, 100.0, 32.0, 32.0], (2, 1))
    bits = np.empty((2, 64, 1), np.uint64)
    centre = np.array([[0.0, 0.0, 0.2], [5.0, 0.0, 0.5]])
    silhouettes(np.tile(np.eye(3), (2, 1, 1)), centre, np.ones(2), t.vertices, t.planes, t.edges, t.closed, K, bits)
    full, none = unpack(bits, 64)
    assert full.all()
    assert not none.any()


@given(hnp.arrays(bool, st.tuples(st.integers(1, 3), st.integers(1, 5), st.integers(1, 200))))
def test_masks_survive_packing(masks: ndarray) -> None:
    bits = pack(masks)
    assert bits.shape == (*masks.shape[:2], -(-masks.shape[2] // 64))
    np.testing.assert_array_equal(unpack(bits, masks.shape[2]), masks)


@given(hnp.arrays(bool, (3, 7, 128)))
def test_mismatch_counts_pixels(masks: ndarray) -> None:
    assert mismatch(*pack(masks)) == reference.mismatch(*masks)


# Contours


@pytest.mark.compiles
@given(WHICH, SEEDS, st.sampled_from([0.7, 1.0, 2.5]), st.sampled_from([1.0, 0.25]))
def test_contour_points(which: str, seed: int, step: float, zoom: float) -> None:
    uvz, edges, bits = _outlined(MESHES[which], seed)
    uvz[:2] /= zoom  # positions are those of the crop, the mask is that of the level
    _, valid = _blobs(seed)
    points, lines = np.zeros((7, 1500)), np.empty((12, edges.shape[1]))
    n = contour.sample_contour(uvz, edges, edges.shape[1], zoom, step, bits, pack(valid), lines, points)
    expected = reference.sample_contour(uvz.T, edges.T, zoom, step, unpack(bits, SIZE), valid)
    assert n == expected.shape[1]
    np.testing.assert_allclose(points[:5, :n], expected[:5], rtol=1e-9, atol=1e-9)


@settings(max_examples=8)
@given(SEEDS)
@pytest.mark.slow
def test_contour_points_lie_on_the_contour_and_face_outward(seed: int) -> None:
    uvz, edges, bits = _outlined(MESHES["mug"], seed)
    points = np.zeros((7, 1500))
    everywhere, lines = pack(np.ones((SIZE, SIZE), bool)), np.empty((12, edges.shape[1]))
    n = contour.sample_contour(uvz, edges, edges.shape[1], 1.0, 1.0, bits, everywhere, lines, points)
    within = np.all((points[:2, :n] > 1.0) & (points[:2, :n] < SIZE - 1.0), axis=0)
    at, normal = points[:2, :n][:, within], points[3:5, :n][:, within]
    np.testing.assert_allclose(np.linalg.norm(normal, axis=0), 1.0)
    finer = reference.silhouette(uvz.T * [8, 8, 1], MESHES["mug"].faces, (8 * SIZE, 8 * SIZE))
    outside, inside = (finer[tuple(np.int64(8 * (at + s * normal))[::-1])] for s in (0.3, -0.3))
    assert outside.sum() <= 0.15 * len(outside)  # a few: at sharp corners another part of the outline is near
    assert inside.sum() >= 0.85 * len(inside)


def _points(rng: np.random.Generator, n: int) -> ndarray:
    points = np.zeros((7, 60))
    angle = rng.uniform(0.0, 2.0 * np.pi, n)
    points[:2, :n] = rng.uniform(0.0, 256.0, (2, n))
    points[contour.Z, :n] = rng.uniform(0.2, 0.6, n)
    points[3:5, :n] = np.cos(angle), np.sin(angle)
    points[contour.DISTANCE, :n], points[contour.WEIGHT, :n] = rng.normal(size=n), rng.uniform(0.1, 2.0, n)
    return points


@given(SEEDS, st.integers(0, 60))
def test_distances_are_looked_up_between_pixels(seed: int, n: int) -> None:
    rng = np.random.default_rng(seed)
    points, field = _points(rng, n), rng.normal(size=(128, 128)).astype(np.float32)
    expected = reference.sample_field(points[:, :n], field, 0.5, 2.0, 0.3)
    contour.sample_field(points, n, field, 0.5, 2.0, 0.3)
    # The kernel stops short of the last row and column by a millionth of a pixel.
    np.testing.assert_allclose(points[:, :n], expected, rtol=1e-4, atol=1e-4)


@given(SEEDS, st.integers(0, 60))
def test_observed_points_take_hold_of_the_contour(seed: int, n: int) -> None:
    rng = np.random.default_rng(seed)
    points = _points(rng, n)
    targets = np.column_stack([rng.uniform(0, 256, (20, 2)), _points(rng, 20)[3:5, :20].T, rng.uniform(1, 4, 20)])
    matched = np.empty((7, 20))
    value = contour.match_boundary(points, n, targets, 6400.0, 0.7, 2.0, matched)
    expected, expected_value = reference.match_boundary(points[:, :n], targets, 6400.0, 0.7, 2.0)
    np.testing.assert_allclose(matched, expected, rtol=1e-9, atol=1e-9)
    assert value == pytest.approx(expected_value)


@given(SEEDS, st.integers(0, 60))
def test_normal_equations(seed: int, n: int) -> None:
    rng = np.random.default_rng(seed)
    points = _points(rng, n)
    centre, K = np.array([0.0, 0.0, 0.4]) + rng.normal(0.0, 0.1, 3), np.array([400.0, 380.0, 120.0, 130.0])
    g, H = np.zeros(7), np.zeros((7, 7))
    contour.accumulate(points, n, centre, K, g, H)
    expected_g, expected_H = reference.normal_equations(points[:, :n], centre, K)
    np.testing.assert_allclose(g, expected_g, rtol=1e-9, atol=1e-6)
    np.testing.assert_allclose(np.triu(H), np.triu(expected_H), rtol=1e-9, atol=1e-6)
    assert not np.tril(H, -1).any()


def test_a_contour_point_moves_as_its_derivative_says() -> None:
    rng = np.random.default_rng(0)
    points = _points(rng, 1)
    points[contour.DISTANCE, 0] = points[contour.WEIGHT, 0] = 1.0
    centre, K = np.array([0.02, -0.01, 0.4]), np.array([400.0, 380.0, 120.0, 130.0])
    a, _ = reference.normal_equations(points[:, :1], centre, K)
    u, v, z, nx, ny = points[:5, 0]
    X = np.array([(u - K[2]) * z / K[0], (v - K[3]) * z / K[1], z])
    for k in range(7):

        def along(t: float, k: int = k) -> float:
            step = t * np.eye(7)[k]
            Y = X + step[:3] + np.cross(step[3:6], X - centre) + step[6] * (X - centre)
            return float(nx * (K[0] * Y[0] / Y[2] + K[2]) + ny * (K[1] * Y[1] / Y[2] + K[3]))

        assert a[k] == pytest.approx((along(1e-6) - along(-1e-6)) / 2e-6, rel=1e-5)


# Observations


@given(SEEDS)
def test_distance_fields(seed: int) -> None:
    seen, valid = _blobs(seed)
    np.testing.assert_allclose(
        observation.signed_distance(seen, valid), reference.distance_field(seen, valid), atol=1e-4
    )


@given(SEEDS)
@pytest.mark.slow
def test_distances_are_rounded_correctly(seed: int) -> None:
    """Else the same clip would give other bits in other processes."""
    from scipy.ndimage import distance_transform_edt

    rng = np.random.default_rng(seed)
    for size in (32, 64, 250):
        target = rng.random((size, size)) < 0.3 / size
        np.testing.assert_array_equal(
            observation.distance_to(target), distance_transform_edt(~target).astype(np.float32)
        )


def test_a_distance_field_of_nothing_is_far_away() -> None:
    nothing, everything = np.zeros((16, 16), bool), np.ones((16, 16), bool)
    for seen, valid in ((nothing, everything), (everything, everything), (nothing, nothing)):
        np.testing.assert_allclose(
            observation.signed_distance(seen, valid), reference.distance_field(seen, valid), atol=1e-4
        )


@given(SEEDS)
def test_borders_with_an_occluder_do_not_attract(seed: int) -> None:
    seen, valid = _blobs(seed)
    field = reference.distance_field(seen, valid)
    from scipy.ndimage import distance_transform_edt

    assert (field[seen] <= 0.5 - distance_transform_edt(~(valid & ~seen))[seen] + 1e-6).all()


@given(SEEDS)
def test_observed_boundary_points(seed: int) -> None:
    seen, valid = _blobs(seed)
    field = observation.signed_distance(seen, valid)
    targets = np.empty((28, 5))
    _boundary(seen, valid, field, 2.0, targets)
    expected = reference.boundary_targets(seen, valid, field, 2.0, 28)
    np.testing.assert_allclose(targets, expected, atol=1e-4)
    assert (targets[:, 4] > 0).any()


# Distances


def _corners(mesh: Mesh) -> tuple[ndarray, ndarray]:
    return mesh.vertices[mesh.faces], mesh.planes[:, :3]


@pytest.mark.parametrize("which", ["box", "mug", "spoon"])
@pytest.mark.slow
def test_the_specification_of_distance_agrees_with_libigl(which: str) -> None:
    import igl

    mesh = {"box": MESHES["box"], "mug": MESHES["mug"], "spoon": shapes.spoon()}[which]
    low, high = mesh.vertices.min(axis=0) - 0.03, mesh.vertices.max(axis=0) + 0.03
    points = np.random.default_rng(1).uniform(low, high, (300, 3))
    d, n = reference.signed_distance(points, *_corners(mesh))
    expected = igl.signed_distance(points, mesh.vertices, mesh.faces, sign_type=igl.SIGNED_DISTANCE_TYPE_PSEUDONORMAL)[
        0
    ]
    np.testing.assert_allclose(d, expected, atol=1e-7)
    np.testing.assert_allclose(np.linalg.norm(n, axis=1), 1.0, atol=1e-9)


@settings(max_examples=10)
@given(st.sampled_from(["box", "mug", "sheet", "two boxes"]), SEEDS)
@pytest.mark.slow
def test_distance_from_a_grid_of_near_faces(which: str, seed: int) -> None:
    mesh = MESHES[which]
    corners, normals = _corners(mesh)
    grid = FaceGrid.of(corners, margin=0.03)
    rng = np.random.default_rng(seed)
    far = grid.origin + grid.spacing * (np.array(grid.face.shape) - 1)
    points = rng.uniform(grid.origin, far, (100, 3))
    exact, direction = reference.signed_distance(points, corners, normals)
    found = np.array([signed_distance(*p, corners, grid.normals, grid.face, grid.origin, grid.spacing) for p in points])
    assert (np.abs(found[:, 0]) >= np.abs(exact) - 1e-8).all()  # it is the distance to a face, if not the nearest
    right = np.abs(found[:, 0] - exact) < 1e-9
    assert right.mean() > 0.8
    assert np.mean(np.abs(found[:, 0] - exact) < 5e-4) >= 0.97
    clear = right & (np.abs(exact) > 1e-4)
    np.testing.assert_allclose(found[clear, 1:], direction[clear], atol=1e-4)


@pytest.mark.parametrize("which", ["mug", "plate", "bowl"])
@pytest.mark.slow
def test_inside_and_outside_of_thin_walls(which: str) -> None:
    mesh = getattr(shapes, which)()
    corners, normals = _corners(mesh)
    grid = FaceGrid.of(corners, margin=0.03)
    rng = np.random.default_rng(2)
    face = rng.integers(len(corners), size=400)
    height = rng.uniform(-0.001, 0.003, (400, 1))
    points = np.einsum("pk,pki->pi", rng.dirichlet([1.0, 1.0, 1.0], 400), corners[face]) + height * normals[face]
    exact, _ = reference.signed_distance(points, corners, normals)
    found = np.array(
        [signed_distance(*p, corners, grid.normals, grid.face, grid.origin, grid.spacing)[0] for p in points]
    )
    assert np.mean(np.sign(found) == np.sign(exact)) > 0.99
    assert np.mean(np.abs(found - exact) < 2e-4) > 0.98


@settings(max_examples=10)
@given(SEEDS)
@pytest.mark.slow
def test_screening_brings_points_into_the_frame_of_the_object(seed: int) -> None:
    mesh = MESHES["mug"]
    corners, normals = _corners(mesh)
    grid = FaceGrid.of(corners, margin=0.03)
    rng = np.random.default_rng(seed)
    R, centre, scale, _ = _pose(seed)
    points = centre + rng.normal(0.0, 0.05, (50, 3))
    local, rough = np.empty((50, 3)), np.empty(50)
    screen(points, R, centre, scale, grid.distance, grid.origin, grid.spacing, local, rough)
    expected, expected_rough = reference.screen(points, R, centre, scale, grid.distance, grid.origin, grid.spacing)
    np.testing.assert_allclose(local, expected, atol=1e-12)
    np.testing.assert_array_equal(rough, expected_rough)
    near = np.isfinite(rough)
    exact, _ = reference.signed_distance(local[near], corners, normals)
    assert (np.abs(rough[near] - exact) <= SLACK * grid.spacing).all()
