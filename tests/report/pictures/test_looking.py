"""A camera that looks at points sees them all."""

from __future__ import annotations

import numpy as np
import pytest

from getagrip.geometry import se3
from getagrip.geometry.camera import project
from getagrip.report.pictures.panels import DistantCamera, look_at


@pytest.mark.parametrize(("side", "up"), [([0.0, 0.0, 1.0], [0.0, 1.0, 0.0]), ([1.0, 2.0, -3.0], [1.0, 2.0, -3.0])])
def test_cameras_see_all_that_they_look_at(side: list[float], up: list[float]) -> None:
    points = np.random.default_rng(0).normal(size=(50, 3)) * [0.1, 0.02, 0.05] + [1.0, 2.0, 3.0]
    eye: DistantCamera = look_at(points, np.array(side), np.array(up), 100)
    seen = se3.transform(eye.T_view_frame, points)
    uv = project(eye.K, seen)
    assert se3.is_rigid(eye.T_view_frame)
    assert 0.0 < uv.min() < uv.max() < 100.0
    assert np.ptp(uv, axis=0).max() > 70.0
    towards = eye.T_view_frame[:3, :3] @ (np.array(side) / np.linalg.norm(side))
    np.testing.assert_allclose(towards, [0.0, 0.0, -1.0], atol=1e-12)
    if side != up:
        assert (eye.T_view_frame[:3, :3] @ np.array(up))[1] < 0.0  # rows count downwards
