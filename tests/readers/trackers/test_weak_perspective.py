"""A weak perspective keeps the projection."""

from __future__ import annotations

import numpy as np

from getagrip.geometry.camera import project
from getagrip.readers.trackers.estimates import Camera, WeakPerspective
from helpers.hand_files import SIZE, cam_crop_to_full


def test_weak_perspective_keeps_the_projection() -> None:
    """Whatever the focal lengths, the hand's origin stays in its pixel, and its size in pixels the same."""
    rng = np.random.default_rng(0)
    K2 = np.array([[500.0, 0.0, 300.0], [0.0, 505.0, 260.0], [0.0, 0.0, 1.0]])
    for _ in range(20):
        centre, side = rng.uniform(100, 500, 2), rng.uniform(50, 400)
        cam = np.array([rng.uniform(0.5, 10), *rng.normal(scale=0.1, size=2)])
        weak = WeakPerspective.of_crop(centre, side, cam)
        t = weak.before(Camera(K2, SIZE))
        np.testing.assert_allclose(project(K2, t[None])[0], centre + side * cam[0] / 2 * cam[1:])
        np.testing.assert_allclose(K2[0, 0] / t[2], side * cam[0] / 2)
        full = cam_crop_to_full(cam, centre, side, SIZE, 1234.0)
        other = WeakPerspective.of_translation(full, 1234.0, np.array(SIZE) / 2.0)
        np.testing.assert_allclose(other.origin, weak.origin, rtol=1e-6)
        np.testing.assert_allclose(other.pixels_per_metre, weak.pixels_per_metre, rtol=1e-6)
