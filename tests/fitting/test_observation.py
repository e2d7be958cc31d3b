"""Laws of observations: crops, levels, what is hidden, what is beyond the image."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy import ndarray

from getagrip.clip import Masks
from getagrip.fitting.energy.mask import (
    DISTANCE_FIELD_SIZE_PX,
    MASK_CROP_SIZE_PX,
    MASK_LEVELS_PX,
    N_COVERAGE_TARGETS,
    Observation,
    SilhouetteMesh,
    observe_masks,
)
from getagrip.geometry import se3
from getagrip.geometry.camera import project
from getagrip.geometry.kernels.silhouette import silhouettes, unpack
from helpers.clips import box

K = np.array([[200.0, 0.0, 80.0], [0.0, 210.0, 60.0], [0.0, 0.0, 1.0]])
WIDTH, HEIGHT = 160, 120


def discs(at: list[tuple[float, float]], radius: float = 20.0) -> ndarray:
    i, j = np.indices((HEIGHT, WIDTH)) + 0.5
    return np.stack([(i - y) ** 2 + (j - x) ** 2 < radius**2 for x, y in at])


def observed(seen: ndarray, ignore: ndarray | None = None, use_ignore: bool = True) -> Observation:
    ignore = np.zeros_like(seen) if ignore is None else ignore
    return observe_masks(Masks(seen, ignore), np.tile(K, (len(seen), 1, 1)), use_ignore)


def at_level(bits: dict[int, ndarray], level: int = MASK_CROP_SIZE_PX) -> ndarray:
    return unpack(bits[level], level)


def test_what_an_observation_holds() -> None:
    o = observed(discs([(60.0, 50.0), (90.0, 70.0)]))
    assert sorted(o.observed) == sorted(o.valid) == sorted(MASK_LEVELS_PX)
    for level in MASK_LEVELS_PX:
        assert at_level(o.observed, level).shape == at_level(o.valid, level).shape == (2, level, level)
        share = at_level(o.observed, level).mean(axis=(1, 2))
        np.testing.assert_allclose(share, np.pi / 4 / 1.8**2, rtol=0.05)
    np.testing.assert_array_equal(o.area, at_level(o.observed).sum(axis=(1, 2)))
    assert o.field.shape == (2, DISTANCE_FIELD_SIZE_PX, DISTANCE_FIELD_SIZE_PX)
    assert o.targets.shape == (2, N_COVERAGE_TARGETS, 5)
    one = o.take(np.array([1]))
    np.testing.assert_array_equal(one.field, o.field[[1]])
    np.testing.assert_array_equal(one.crops.corner, o.crops.corner[[1]])


@given(st.integers(0, 10**6))
def test_the_cameras_of_the_crops_see_the_same(seed: int) -> None:
    rng = np.random.default_rng(seed)
    o = observed(discs([(70.0, 60.0)]))
    X = np.array([0.0, 0.0, 0.5]) + rng.uniform(-0.1, 0.1, (10, 3))
    fx, fy, cx, cy = o.K[0]
    inside = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    expected = (project(K, X) - o.crops.corner[0]) * o.crops.zoom
    np.testing.assert_allclose(project(inside, X), expected, atol=1e-9)


def test_rendering_with_the_cameras_of_the_crops_gives_the_observed_mask() -> None:
    mesh = box(0.1, 0.06, 0.04)
    t = SilhouetteMesh.of(mesh, np.zeros(3))
    R, centre = se3.exp_so3(np.array([[0.3, 0.5, 0.2]])), np.array([[0.01, -0.02, 0.4]])

    def drawn(K4: ndarray, height: int, width: int) -> ndarray:
        bits = np.empty((1, height, -(-width // 64)), np.uint64)
        silhouettes(R, centre, np.ones(1), t.vertices, t.planes, t.edges, t.closed, K4, bits)
        return unpack(bits, width)

    seen = drawn(np.array([[200.0, 210.0, 80.0, 60.0]]), HEIGHT, WIDTH)
    o = observed(seen)
    again = drawn(o.K, MASK_CROP_SIZE_PX, MASK_CROP_SIZE_PX)
    pixel = o.crops.zoom  # crop pixels per image pixel: the observed outline is known to half of one
    outline = (np.abs(o.field) < pixel).sum() * (MASK_CROP_SIZE_PX / DISTANCE_FIELD_SIZE_PX) ** 2
    assert (again ^ at_level(o.observed)).sum() < 0.5 * outline
    sides = again.sum() / at_level(o.observed).sum()
    assert sides == pytest.approx(1.0, abs=0.02)


@pytest.mark.parametrize("zoom", [0.8, 1.0, 1.02, 1.5, 2.0])
def test_no_level_takes_an_object_for_larger_or_smaller_than_it_is(zoom: float) -> None:
    frames = np.arange(12)
    size = (
        zoom * 0.5 * DISTANCE_FIELD_SIZE_PX / 1.8
    )  # so that the crops at 128 pixels have the images' resolution, or nearly
    at = np.array([80.0, 60.0]) + np.stack([np.sin(frames), np.cos(2.0 * frames)], axis=1)
    i, j = np.indices((HEIGHT, WIDTH)) + 0.5
    boxes = np.stack([np.maximum(abs(j - u), abs(i - v)) < 0.5 * size for u, v in at])
    o = observed(boxes)
    true = (size * o.crops.zoom) ** 2
    for level in MASK_LEVELS_PX:
        share = (
            at_level(o.observed, level).sum(axis=(1, 2)).mean()
            * (MASK_CROP_SIZE_PX / level) ** 2
            / boxes.sum(axis=(1, 2)).mean()
        )
        assert share / o.crops.zoom**2 == pytest.approx(1.0, abs=0.015), level
    inside = (o.field < 0.0).sum(axis=(1, 2)).mean() * (MASK_CROP_SIZE_PX / DISTANCE_FIELD_SIZE_PX) ** 2
    assert inside == pytest.approx(true, rel=0.06)


def test_nothing_is_known_beyond_the_image() -> None:
    o = observed(discs([(10.0, 60.0)]))
    u = (np.arange(MASK_CROP_SIZE_PX) + 0.5) / o.crops.zoom + o.crops.corner[0, 0]
    assert u[0] < 0.0
    np.testing.assert_array_equal(
        at_level(o.valid)[0], np.broadcast_to(u >= 0.0, (MASK_CROP_SIZE_PX, MASK_CROP_SIZE_PX))
    )


def test_hidden_pixels_do_not_count_unless_asked_to() -> None:
    seen = discs([(80.0, 60.0)])
    ignore = np.zeros_like(seen)
    ignore[:, :, 85:] = True
    visible = seen & ~ignore
    o, blind = observed(visible, ignore), observed(visible, ignore, use_ignore=False)
    hidden = ~at_level(o.valid)[0]
    assert hidden.any()
    assert not (hidden & at_level(o.observed)[0]).any()
    assert at_level(blind.valid).all()
    # No boundary point lies on the border with the occluder.
    image_u = o.targets[0, :, 0] / o.crops.zoom + o.crops.corner[0, 0]
    used = o.targets[0, :, 4] > 0
    assert used.sum() == N_COVERAGE_TARGETS
    assert np.sum(image_u[used] > 84.0) <= 2  # those at its ends, which are visible


def test_nothing_is_the_object_where_all_is_hidden() -> None:
    seen = discs([(80.0, 60.0)])
    ignore = np.zeros_like(seen)
    ignore[:, 40:80, 80:120] = True
    o = observed(seen & ~ignore, ignore)
    for level in MASK_LEVELS_PX:
        hidden = ~at_level(o.valid, level)
        assert hidden.any()
        assert not (hidden & at_level(o.observed, level)).any()


def test_where_object_and_ignored_overlap_the_object_wins() -> None:
    seen = discs([(80.0, 60.0)])
    o = observed(seen, np.ones_like(seen))
    np.testing.assert_array_equal(at_level(o.valid), at_level(o.observed))


@settings(max_examples=10)
@given(st.floats(40.0, 120.0), st.floats(40.0, 80.0), st.floats(24.0, 36.0))
def test_fields_and_targets_of_a_disc(x: float, y: float, radius: float) -> None:
    o = observed(discs([(x, y)], radius))
    field, zoom = o.field[0], o.crops.zoom
    centre, r = (np.array([x, y]) - o.crops.corner[0]) * zoom, radius * zoom
    v, u = (np.indices((DISTANCE_FIELD_SIZE_PX, DISTANCE_FIELD_SIZE_PX)) + 0.5) * (
        MASK_CROP_SIZE_PX / DISTANCE_FIELD_SIZE_PX
    )
    expected = np.hypot(u - centre[0], v - centre[1]) - r
    known = at_level(o.valid, 128)[0]
    tolerance = 1.5 * zoom + 2.0  # a pixel of the image, and one of the field
    assert np.abs(field - expected)[known].max() < tolerance
    points = o.targets[0][o.targets[0, :, 4] > 0]
    out = points[:, :2] - centre
    assert np.abs(np.linalg.norm(out, axis=1) - r).max() < tolerance
    cosine = np.sum(out * points[:, 2:4], axis=1) / np.linalg.norm(out, axis=1)
    assert np.median(cosine) > 0.9
    # Counted in steps from pixel to pixel, a circle's outline is up to sqrt(2) shorter than it is.
    assert 0.6 * 2 * np.pi * r < points[:, 4].sum() < 1.2 * 2 * np.pi * r
