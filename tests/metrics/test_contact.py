"""Contact distances, contact sets and stable contact area: known answers and laws."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

from getagrip.geometry import se3
from getagrip.geometry.mesh import Mesh
from getagrip.metrics.contact import (
    CONTACT_SIDES,
    MAX_CACHED_SURFACE_FACES,
    MAX_SIGNED_DISTANCE_M,
    ContactDefinition,
    ContactDistances,
    close_holes,
    contact_distances,
    pairwise_iou,
    signed_distance,
    stable_contact,
    stable_contact_area,
)
from getagrip.metrics.pose import ObjectTrack

sets = arrays(bool, array_shapes(min_dims=2, max_dims=2, min_side=1, max_side=20))


def sphere(radius: float, subdivisions: int = 4) -> Mesh:
    ball = trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius)
    return Mesh(np.asarray(ball.vertices), np.asarray(ball.faces, dtype=np.int64))


def posed(*T: np.ndarray) -> np.ndarray:
    return np.stack(T)


@given(sets)
def test_pairwise_iou_is_what_python_sets_say(contact: np.ndarray) -> None:
    frames = [set(np.flatnonzero(row)) for row in contact]
    expected = [[len(a & b) / len(a | b) if a | b else 0.0 for b in frames] for a in frames]
    np.testing.assert_allclose(pairwise_iou(contact), expected)


@given(sets)
def test_the_diagonal_adds_one_for_each_frame_that_touches(contact: np.ndarray) -> None:
    T, overlap = len(contact), pairwise_iou(contact)
    touching = np.count_nonzero(contact.any(axis=1))
    pairs = stable_contact_area(overlap) * T * (T - 1) if T > 1 else 0.0
    assert stable_contact_area(overlap, diagonal=True) == pytest.approx((pairs + touching) / T**2)


def test_stable_contact_area_of_one_set_of_disjoint_sets_and_of_none() -> None:
    same, disjoint = np.tile([True, False, True], (5, 1)), np.eye(5, dtype=bool)
    assert stable_contact_area(pairwise_iou(same)) == 1.0
    assert stable_contact_area(pairwise_iou(disjoint)) == 0.0
    assert stable_contact_area(pairwise_iou(disjoint), diagonal=True) == pytest.approx(1 / 5)
    assert stable_contact_area(pairwise_iou(np.zeros((5, 3), bool)), diagonal=True) == 0.0
    assert np.isnan(stable_contact_area(pairwise_iou(same[:1])))


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(0.01, 0.1))
@pytest.mark.slow
def test_signed_distance_to_a_ball(seed: int, radius: float) -> None:
    points = np.random.default_rng(seed).normal(scale=radius, size=(200, 3))
    ball = sphere(radius)
    exact = np.linalg.norm(points, axis=1) - radius
    found = signed_distance(points, ball.vertices, ball.faces)
    np.testing.assert_allclose(found, exact, atol=0.004 * radius)
    near = signed_distance(points, ball.vertices, ball.faces, max_distance=0.2 * radius)
    np.testing.assert_array_equal(near[found <= 0.2 * radius], found[found <= 0.2 * radius])
    assert np.all(near[found > 0.2 * radius] > 0.2 * radius)


def test_what_lies_in_two_overlapping_parts_lies_inside() -> None:
    a, b = sphere(0.03), sphere(0.03)
    both = Mesh(
        np.concatenate([a.vertices, b.vertices + np.array([0.03, 0.0, 0.0])]), np.concatenate([a.faces, b.faces + 2562])
    )
    # In one part only, by the wall of the other: there the nearest face looks away from the point.
    point = np.array([[-0.0005, 0.0, 0.0], [0.0005, 0.0, 0.0], [0.015, 0.0, 0.0], [0.07, 0.0, 0.0]])
    assert np.all((signed_distance(point, both.vertices, both.faces) < 0) == [True, True, True, False])


def test_hand_and_object_side_agree_on_a_ball_in_a_ball() -> None:
    small, large = sphere(0.020), sphere(0.026)
    (inside,) = contact_distances(small, [ObjectTrack(np.eye(4)[None], 1.0)], large.vertices[None], large.faces)
    np.testing.assert_allclose(inside.object, -0.006, atol=1e-4)
    np.testing.assert_allclose(inside.area, -0.006, atol=1e-4)
    np.testing.assert_allclose(inside.hand, 0.006, atol=1e-4)
    assert inside.contact("object", 0.0).all()
    assert not inside.contact("hand", 0.005).any()
    assert inside.contact("hand", 0.010).all()
    np.testing.assert_allclose(inside.depth("object"), 0.006, atol=1e-4)
    assert not inside.depth("hand").any()


def test_touching_balls_are_in_contact_where_the_formula_says() -> None:
    radius, gap = 0.02, 0.002
    ball = sphere(radius)
    T = se3.rigid(t=np.array([2 * radius + gap, 0.0, 0.0]))
    (distances,) = contact_distances(ball, [ObjectTrack(T[None], 1.0)], ball.vertices[None], ball.faces)
    exact = np.linalg.norm(ball.vertices + T[:3, 3], axis=1) - radius
    for threshold in (0.005, 0.010):
        found = distances.contact("object", threshold)[0]
        sure = np.abs(exact - threshold) > 1e-4
        np.testing.assert_array_equal(found[sure], (exact <= threshold)[sure])
        assert found.sum() == pytest.approx(distances.contact("hand", threshold).sum(), rel=0.05)
    assert not distances.contact("object", 0.0).any()


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(0.5, 2.0))
@pytest.mark.slow
def test_contact_does_not_depend_on_the_hand_frame_nor_on_where_the_scale_is(seed: int, scale: float) -> None:
    rng = np.random.default_rng(seed)
    G = se3.rigid(se3.exp_so3(rng.normal(size=3)), rng.normal(size=3))
    T = se3.rigid(se3.exp_so3(rng.normal(size=(2, 3))), rng.normal(scale=0.01, size=(2, 3)))
    hand, ball = sphere(0.03, 2), sphere(0.02, 2)
    hands = np.stack([hand.vertices, 1.1 * hand.vertices])
    scaled = Mesh(scale * ball.vertices, ball.faces)
    (here,) = contact_distances(ball, [ObjectTrack(T, scale)], hands, hand.faces)
    (there,) = contact_distances(scaled, [ObjectTrack(G @ T, 1.0)], se3.transform(G, hands), hand.faces)
    for side in CONTACT_SIDES:
        near = np.minimum(getattr(here, side), getattr(there, side)) < MAX_SIGNED_DISTANCE_M
        np.testing.assert_allclose(getattr(here, side)[near], getattr(there, side)[near], atol=1e-7)


@pytest.mark.parametrize("subdivisions", [3, 4])
def test_a_surface_met_again_among_others_is_measured_as_before(subdivisions: int) -> None:
    # Search trees of few faces are kept, by the surface's vertices and faces; those of many are not.
    ball = sphere(1.0, subdivisions)
    assert (len(ball.faces) <= MAX_CACHED_SURFACE_FACES) == (subdivisions == 3)
    points = np.random.default_rng(0).normal(scale=0.03, size=(200, 3))
    inside_out = ball.faces[:, ::-1]
    for radius in (0.03, 0.04, 0.03):
        for faces in (ball.faces, inside_out):
            found = signed_distance(points, radius * ball.vertices, faces)
            np.testing.assert_allclose(found, np.linalg.norm(points, axis=1) - radius, atol=4e-4)


def test_an_open_wrist_is_closed() -> None:
    whole = sphere(0.04)
    centres = whole.vertices[whole.faces].mean(axis=1)
    opened = whole.faces[(centres[:, 2] < 0.03) & (centres[:, 0] < 0.035)]  # two holes
    assert not Mesh(whole.vertices, opened).is_closed
    vertices, faces = close_holes(whole.vertices, opened)
    assert len(vertices) == len(whole.vertices) + 2
    closed = Mesh(vertices, faces)
    assert closed.is_closed
    assert 0.85 * whole.volume < closed.volume < whole.volume
    assert signed_distance(np.array([[0.0, 0.0, 0.02]]), vertices, faces)[0] < 0
    batched, _ = close_holes(np.stack([whole.vertices, 2 * whole.vertices]), opened)
    np.testing.assert_allclose(batched[1], 2 * batched[0])


def test_a_hand_is_closed_before_it_is_touched() -> None:
    """What lies under its open wrist is as deep inside as it is below the border's plane."""
    whole = sphere(0.04)
    opened = whole.faces[whole.vertices[whole.faces].mean(axis=1)[:, 2] < 0.03]
    held = ObjectTrack(se3.rigid(t=np.array([0.0, 0.0, 0.024]))[None], 1.0)
    (distances,) = contact_distances(sphere(0.004, 2), [held], whole.vertices[None], opened)
    for deep in (distances.object, distances.area):
        assert -0.005 < deep.max() < 0.0


@given(sets)
def test_stable_contact_is_that_of_the_points_within_the_threshold(contact: np.ndarray) -> None:
    near, far = np.where(contact, 0.004, 0.006), np.full(contact.shape, 1.0)
    for side in CONTACT_SIDES:
        distances = ContactDistances(**dict.fromkeys(CONTACT_SIDES, far) | {side: near})
        found = stable_contact(distances, ContactDefinition(side, 0.005))
        np.testing.assert_array_equal(found.share, contact.mean(axis=1))
        overlap = pairwise_iou(contact)
        assert found.sca == pytest.approx(stable_contact_area(overlap), nan_ok=True)
        assert found.diagonal == stable_contact_area(overlap, diagonal=True)


def test_each_triangle_of_a_soup_is_a_hole_closed_over_its_middle() -> None:
    corners = np.random.default_rng(0).normal(size=(2, 20_000, 3, 3))
    faces = np.arange(60_000).reshape(-1, 3)
    vertices, closed = close_holes(corners.reshape(2, -1, 3), faces)  # a loop over holes would take seconds
    np.testing.assert_allclose(vertices[:, 60_000:], corners.mean(axis=2), atol=1e-12)
    assert len(closed) == 4 * len(faces)
