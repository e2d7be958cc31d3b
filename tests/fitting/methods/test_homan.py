"""HOMan: the object placed in its box, and the joint descent of object and hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from getagrip.fitting.energy.contact import HandContacts, PullTerm, PushTerm, build_contact_grid
from getagrip.fitting.energy.homan_terms import SmoothnessTerm, vertex_moments
from getagrip.fitting.methods.homan import JointEnergy, RigidBodies, place_in_box, refine_by_levenberg_marquardt
from getagrip.geometry import camera, se3
from helpers.clips import box
from helpers.terms import N, some_term

BOX = box(0.1, 0.06, 0.04)


@given(st.integers(0, 10**6))
@settings(max_examples=10)
def test_an_object_is_placed_in_its_box(seed: int) -> None:
    rng = np.random.default_rng(seed)
    R = se3.exp_so3(rng.normal(size=(6, 3)))
    K = np.array([[600.0, 0.0, 320.0], [0.0, 600.0, 240.0], [0.0, 0.0, 1.0]])
    low = rng.uniform(0.0, 400.0, 2)
    seen = np.concatenate([low, low + rng.uniform(40.0, 120.0, 2)])
    centre = place_in_box(R, BOX.vertices, K, seen)
    uv = camera.project(K, BOX.vertices @ np.swapaxes(R, 1, 2) + centre[:, None])
    least, most = uv.min(axis=1), uv.max(axis=1)
    np.testing.assert_allclose((least + most) / 2.0, np.tile((seen[:2] + seen[2:]) / 2.0, (6, 1)), atol=0.5)
    np.testing.assert_allclose(np.linalg.norm(most - least, axis=1), np.linalg.norm(seen[2:] - seen[:2]), rtol=0.02)


def joint_scene(seed: int = 0) -> tuple[JointEnergy, RigidBodies]:
    """Object and hand near each other, the hand a little off where it was given; all terms but the mask."""
    rng = np.random.default_rng(seed)
    R_hand, away = se3.exp_so3(rng.normal(size=(N, 3))), np.array([0.0, 0.0, 0.5])
    input_hand = se3.rigid(R_hand, away + rng.normal(0.0, 0.01, (N, 3)))
    grip = rng.normal(0.0, 0.01, (N, 3))
    points = away + rng.normal(0.0, 0.03, (N, 26, 3))
    contacts, weight = HandContacts(points, np.arange(0, 24, 4)), np.full(N, 1e5)
    body = build_contact_grid(BOX, BOX.centre)
    push, pull = PushTerm(body, contacts, weight, delta=1e-9), PullTerm(body, contacts, weight, 0.01, delta=1e-9)
    hand_smooth = SmoothnessTerm(vertex_moments(points[0] - points[0].mean(0)), 1e5)
    energy = JointEnergy(
        object_in_camera=[SmoothnessTerm(vertex_moments(BOX.vertices), 1e5)],
        hand_in_camera=[some_term("reprojection", rng), hand_smooth],
        object_in_hand=[push, pull, some_term("interaction", rng)],
        T_cam_hand=input_hand,
    )
    hand_centre = se3.transform(input_hand, grip[:, None])[:, 0]
    bodies = RigidBodies(
        R=se3.exp_so3(rng.normal(size=(N, 3))),
        centre=np.array([0.0, 0.0, 0.5]) + rng.normal(0.0, 0.005, (N, 3)),
        log_scale=0.05,
        hand_R=se3.exp_so3(rng.normal(0.0, 0.05, (N, 3))) @ input_hand[:, :3, :3],
        hand_centre=hand_centre + rng.normal(0.0, 0.005, (N, 3)),
        grip=grip,
    )
    return energy, bodies


def test_the_gradient_of_the_joint_energy() -> None:
    energy, bodies = joint_scene()
    values, equations = energy(bodies)
    g, cross = equations.g, equations.cross
    assert values["push"] > 0.0
    assert values["pull"] > 0.0
    h = 1e-7
    for n in range(N):
        for k in range(12):
            step = np.zeros((N, 12))
            step[n, k] = h
            ahead, behind = (sum(energy(bodies.retract(s * step, 0.0))[0].values()) for s in (1.0, -1.0))
            assert g[n, k] == pytest.approx((ahead - behind) / (2.0 * h), rel=1e-3, abs=1e-4 * np.abs(g).max())
    still = np.zeros((N, 12))
    ahead, behind = (sum(energy(bodies.retract(still, s * h))[0].values()) for s in (1.0, -1.0))
    assert g[:, 12].sum() == pytest.approx((ahead - behind) / (2.0 * h), rel=1e-3)
    np.testing.assert_allclose(cross, np.swapaxes(np.swapaxes(cross, 0, 1), 2, 3), atol=1e-9 * np.abs(cross).max())


@pytest.mark.parametrize("free_scale", [False, True])
def test_descent_goes_down_and_keeps_a_known_scale(free_scale: bool) -> None:
    energy, bodies = joint_scene(1)
    found = refine_by_levenberg_marquardt(energy, bodies, 5, free_scale)
    assert found.energy < sum(energy(bodies)[0].values())
    assert found.energy == pytest.approx(sum(energy(found.bodies)[0].values()))
    assert (found.bodies.log_scale == bodies.log_scale) == (not free_scale)


def test_an_unmoved_hand_holds_the_object_where_the_camera_sees_it() -> None:
    energy, bodies = joint_scene(2)
    input_hand = energy.T_cam_hand
    same = replace(
        bodies, hand_R=input_hand[:, :3, :3], hand_centre=se3.transform(input_hand, bodies.grip[:, None])[:, 0]
    )
    np.testing.assert_allclose(same.T_cam_hand, input_hand, atol=1e-12)
    held = same.in_hand()
    middle = se3.transform(input_hand, held.centre[0][:, None])[:, 0]
    np.testing.assert_allclose(middle, same.centre, atol=1e-12)
    np.testing.assert_allclose(input_hand[:, :3, :3] @ held.R[0], same.R, atol=1e-12)
