"""Profiles of bodies of revolution."""

from __future__ import annotations

import numpy as np
import pytest

from getagrip.geometry.profile import N_PROFILE_RADII, Profile
from getagrip.hands.grips import CATEGORY_PRIORS
from getagrip.synthetic import objects
from getagrip.synthetic.categories import SHAPE_MAKERS

REVOLVED = sorted(kind for kind, prior in CATEGORY_PRIORS.items() if prior.revolved)


@pytest.mark.parametrize("kind", REVOLVED)
def test_an_unchanged_profile_leaves_a_built_in_body_as_it_is(kind: str) -> None:
    mesh = SHAPE_MAKERS[kind]()
    profile = Profile.of(mesh)
    assert (profile.before > 0.0).all()
    np.testing.assert_allclose(profile.moved(mesh.vertices), mesh.vertices, atol=1e-12)


def test_radii_are_the_bodys_and_handles_do_not_count() -> None:
    profile = Profile.of(objects.pan(rim=0.125, height=0.042))
    assert profile.before.max() == pytest.approx(0.125, rel=0.01)
    assert np.ptp(profile.ends) == pytest.approx(0.042, rel=0.01)
    can = Profile.of(objects.can(radius=0.034, height=0.11))
    np.testing.assert_allclose(can.before[1:-1], 0.034, rtol=0.05)  # of 26 columns none is at y = radius exactly


def test_a_wider_body_is_wider_inside_and_keeps_its_handle() -> None:
    mesh = objects.mug(radius=0.041)
    profile = Profile.of(mesh)
    wider = profile.widened(np.full(N_PROFILE_RADII, 1.2))
    moved = wider.moved(mesh.vertices)
    was, now = (np.hypot(*(X[:, :2] - profile.axis).T) for X in (mesh.vertices, moved))
    inside = was < 0.9 * profile.before.min()
    np.testing.assert_allclose(now[inside], 1.2 * was[inside])
    handle = was > 1.1 * profile.before.max()
    out = np.interp(mesh.vertices[handle, 2], profile.heights, 0.2 * profile.before)
    np.testing.assert_allclose(now[handle] - was[handle], out, atol=1e-9)
    np.testing.assert_array_equal(moved[:, 2], mesh.vertices[:, 2])


def test_radii_are_stretched_at_their_own_heights_only() -> None:
    mesh = objects.bottle()
    times = np.ones(N_PROFILE_RADII)
    times[-1] = 2.0
    profile = Profile.of(mesh).widened(times)
    heights = profile.heights
    moved = profile.moved(mesh.vertices)
    low = mesh.vertices[:, 2] <= heights[-2]
    np.testing.assert_allclose(moved[low], mesh.vertices[low], atol=1e-12)
    top = mesh.vertices[:, 2] > heights[-1] - 1e-3
    was, now = (np.hypot(*X[top, :2].T) for X in (mesh.vertices, moved))
    assert (now > 1.5 * was)[was > 0.0].all()
