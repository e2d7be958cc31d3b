"""The z-buffer against a ray caster that tests every pixel against every face, and known answers."""

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from getagrip.geometry import se3
from getagrip.geometry.rasterize import (
    MIN_ZBUFFER_DEPTH_M,
    depth_and_face,
    interpolate_vertex_values,
    render_coverage,
    render_packed,
    render_rgb,
    true_masks,
)

SIZE = (48, 36)
K = np.array([[40.0, 0.0, 25.0], [0.0, 42.0, 17.0], [0.0, 0.0, 1.0]])


def depth_reference(vertices_cam, faces, K, size):
    """Moeller and Trumbore's test of every ray against every face."""
    width, height = size
    uv = np.stack(np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5), axis=-1)
    rays = np.concatenate([uv, np.ones((height, width, 1))], axis=-1) @ np.linalg.inv(K).T
    depth = np.full((height, width), np.inf)
    face = np.full((height, width), -1)
    for k, (a, b, c) in enumerate(vertices_cam[faces]):
        h = np.cross(rays, c - a)
        det = h @ (b - a)
        with np.errstate(divide="ignore", invalid="ignore"):
            beta = -(h @ a) / det
            q = np.cross(-a, b - a)
            gamma = rays @ q / det
            z = (c - a) @ q / det
        hit = (beta >= 0) & (gamma >= 0) & (beta + gamma <= 1) & (z >= MIN_ZBUFFER_DEPTH_M) & (z < depth)
        depth[hit], face[hit] = z[hit], k
    return depth, face


def cube(centre, side=0.2, turn=(0.3, 0.5, 0.1)):
    box = trimesh.creation.box(extents=[side] * 3)
    R = se3.exp_so3(np.array(turn))
    return box.vertices @ R.T + np.array(centre), np.asarray(box.faces)


@settings(deadline=None, max_examples=40)
@given(st.integers(0, 2**32 - 1), st.floats(-0.2, 1.0))
def test_equals_the_ray_caster_also_through_the_near_plane(seed, distance):
    rng = np.random.default_rng(seed)
    vertices = rng.normal(size=(12, 3)) * [0.4, 0.3, 0.4] + [0.0, 0.0, distance]
    faces = np.array([rng.choice(12, 3, replace=False) for _ in range(10)])
    depth, face = depth_and_face(vertices, faces, K, SIZE)
    expected, expected_face = depth_reference(vertices, faces, K, SIZE)
    close = np.isclose(depth, expected, rtol=1e-5)
    assert np.mean(close) > 0.995  # a pixel whose centre lies on an edge to the last digit may fall either way
    same = face[close] == expected_face[close]
    assert np.mean(same) > 0.995 or len(np.unique(np.sort(faces, axis=1), axis=0)) < len(faces)
    assert np.all(np.isinf(depth[face < 0]))
    assert np.all(depth >= np.float32(MIN_ZBUFFER_DEPTH_M))


def test_a_plane_has_its_depth_and_pixel_rule():
    vertices = np.array([[0.0, 0.0, 2.0], [1.0, 0.0, 2.0], [1.0, 1.0, 2.0], [0.0, 1.0, 2.0]])
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    depth, face = depth_and_face(vertices, faces, np.diag([10.0, 10.0, 1.0]), (8, 8))
    assert np.all(depth[:5, :5] == 2.0)  # pixels with centres in [0, 5]^2
    assert np.all(face[:5, :5] >= 0)
    assert np.all(np.isinf(depth[5:]))
    assert np.all(np.isinf(depth[:, 5:]))


def test_closed_meshes_have_no_cracks():
    ball = trimesh.creation.icosphere(subdivisions=4, radius=0.1)
    size = (200, 200)
    K = np.array([[300.0, 0.0, 100.0], [0.0, 300.0, 100.0], [0.0, 0.0, 1.0]])
    _, face = depth_and_face(ball.vertices + np.array([0.0, 0.0, 0.4]), np.asarray(ball.faces), K, size)
    u, v = np.meshgrid(np.arange(200) + 0.5 - 100, np.arange(200) + 0.5 - 100)
    radius = 300.0 * 0.0995 / np.sqrt(0.4**2 - 0.0995**2)
    assert np.all(face[u**2 + v**2 < radius**2] >= 0)


def test_behind_the_camera_or_edge_on_draws_nothing():
    vertices, faces = cube([0.0, 0.0, -0.5])
    assert np.all(depth_and_face(vertices, faces, K, SIZE)[1] == -1)
    edge_on = np.array([[0.0, 0.0, 0.5], [0.1, 0.0, 1.0], [-0.1, 0.0, 2.0]])
    centred = np.array([[40.0, 0.0, 24.5], [0.0, 40.0, 17.5], [0.0, 0.0, 1.0]])
    assert np.all(depth_and_face(edge_on, np.array([[0, 1, 2]]), centred, SIZE)[1] == -1)


@pytest.mark.compiles
def test_depth_interpolated_between_vertices_is_the_depth():
    vertices, faces = cube([0.05, 0.0, 0.5])
    depth, face = depth_and_face(vertices, faces, K, SIZE)
    z, one = interpolate_vertex_values(
        vertices, faces, K, face, np.stack([vertices[:, 2], np.ones(len(vertices))], axis=1)
    ).T
    np.testing.assert_allclose(z, depth[face >= 0], rtol=1e-6)
    np.testing.assert_allclose(one, 1.0)


def test_masks_separate_visible_from_hidden_pixels():
    held, hand, wall = cube([0.0, 0.0, 0.6]), cube([0.1, 0.0, 0.4], 0.1), cube([0.0, 0.0, 2.0], 0.9)
    seen, ignore, holding = true_masks(held, [hand], [], K, SIZE)
    alone = depth_and_face(*held, K, SIZE)[1] >= 0
    assert not np.any(seen & ignore)
    np.testing.assert_array_equal(seen, alone & ~ignore)
    np.testing.assert_array_equal(ignore, depth_and_face(*hand, K, SIZE)[1] >= 0)
    np.testing.assert_array_equal(holding, ignore)
    # Another hand is ignored, and is not the one that holds it.
    other = cube([-0.1, 0.0, 0.4], 0.1)
    _, both, same = true_masks(held, [hand, other], [], K, SIZE)
    np.testing.assert_array_equal(same, holding)
    np.testing.assert_array_equal(both & ~holding, depth_and_face(*other, K, SIZE)[1] >= 0)
    # A wall behind hides nothing and changes nothing; the same cube in front as an object does.
    np.testing.assert_array_equal(true_masks(held, [hand], [wall], K, SIZE)[1], ignore)
    np.testing.assert_array_equal(true_masks(held, [], [hand], K, SIZE)[1], ignore)


def test_colours_of_vertices_are_interpolated():
    vertices, faces = cube([0.0, 0.0, 0.6])
    left = (vertices[:, 0] < 0.0)[:, None]
    colours = np.where(left, [1.0, 0.0, 0.0], [0.0, 0.0, 1.0])
    picture = render_rgb([(vertices, faces, colours)], K, SIZE).astype(int)
    seen = depth_and_face(vertices, faces, K, SIZE)[1] >= 0
    columns = np.flatnonzero(seen[18])
    inner = picture[18, columns[1:-1]]
    assert np.all(inner[:, 1] == 0)
    share = inner[:, 2] / inner.sum(axis=1)  # of blue, whatever the light
    assert np.all(np.diff(share) >= 0.0)
    assert share[0] < 0.15
    assert share[-1] > 0.95
    assert np.diff(share).max() < 0.1  # in small steps
    same = render_rgb([(vertices, faces, np.tile([1.0, 0.0, 0.0], (len(vertices), 1)))], K, SIZE)
    np.testing.assert_array_equal(same, render_rgb([(vertices, faces, (1.0, 0.0, 0.0))], K, SIZE))


@pytest.mark.parametrize("background", [None, (0.0, 0.5, 1.0), np.full((36, 48, 3), 7, np.uint8)])
def test_pictures_show_mesh_and_background(background):
    vertices, faces = cube([0.0, 0.0, 0.6])
    picture = render_rgb([(vertices, faces, (1.0, 0.0, 0.0))], K, SIZE, background)
    empty = render_rgb([], K, SIZE, background)
    assert (picture.shape, picture.flags.c_contiguous) == ((36, 48, 3), True)
    outline = depth_and_face(vertices, faces, K, SIZE)[1] >= 0
    assert np.all(picture[18, 24, 1:] == 0)
    assert picture[18, 24, 0] > 80
    np.testing.assert_array_equal(picture[0, 0], empty[0, 0])
    assert np.count_nonzero((picture != empty).any(axis=-1)) >= 0.95 * np.count_nonzero(outline)


@given(seed=st.integers(0, 10**6), near=st.booleans())
def test_a_packed_rendering_is_the_rendering(seed: int, near: bool) -> None:
    rng = np.random.default_rng(seed)
    vertices = rng.normal(size=(12, 3)) * rng.uniform(0.01, 0.4) + rng.uniform([-1.0, -0.8, 0.4], [1.0, 0.8, 1.5])
    if not near:
        vertices[:, 2] = np.maximum(vertices[:, 2], 0.1)
    faces = rng.integers(0, 12, (9, 3))
    mask = render_coverage(vertices, faces, K, SIZE)
    np.testing.assert_array_equal(mask, depth_and_face(vertices, faces, K, SIZE)[1] >= 0)
    np.testing.assert_array_equal(render_packed(vertices, faces, K, SIZE).unpacked, mask)


def test_a_mesh_looks_the_same_beside_another_and_at_the_border():
    background = np.random.default_rng(0).integers(0, 256, (36, 48, 3)).astype(np.uint8)
    one, other = ((*cube([x, y, 0.9]), (1.0, 0.0, 0.0)) for x, y in ((-0.56, -0.36), (0.52, 0.41)))
    alone, beside, empty = (render_rgb(meshes, K, SIZE, background) for meshes in ([one], [other], []))
    assert (alone != empty)[0, 0].any()
    assert (beside != empty)[-1, -1].any()
    np.testing.assert_array_equal(empty, background)
    both = np.where(alone == empty, beside, alone)
    np.testing.assert_array_equal(render_rgb([one, other], K, SIZE, background), both)
