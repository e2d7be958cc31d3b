"""The plane that objects lie on: found from where they lie, one of them on another."""

from __future__ import annotations

import numpy as np
import pytest

from getagrip.geometry import se3
from getagrip.readers.datasets.dexycb.dexycb_clips import support_plane, world_of_plane
from helpers.clips import box


@pytest.mark.parametrize("seed", range(3))
def test_the_plane_is_found_though_one_object_lies_on_another(seed: int) -> None:
    rng = np.random.default_rng(seed)
    tilt = se3.exp_so3(rng.uniform(-0.2, 0.2, 3)) @ se3.exp_so3(np.array([np.radians(90.0 + 35.0), 0.0, 0.0]))
    up = tilt[:, 2]
    resting = []
    for n in range(9):
        size = rng.uniform(0.03, 0.2, 3)
        place = [*rng.uniform(-0.2, 0.2, 2), size[2] / 2 + (0.12 if n == 4 else 0.0)]
        on_table = box(*size).vertices @ se3.exp_so3(np.array([0.0, 0.0, rng.uniform(0.0, 6.0)])).T + place
        resting.append(on_table @ tilt.T + [0.0, 0.0, 0.8])
    normal, height = support_plane(resting)
    assert np.degrees(np.arccos(np.clip(normal @ up, -1.0, 1.0))) < 0.5
    assert height == pytest.approx(0.8 * up[2], abs=0.002)
    T_world_cam = world_of_plane(normal, height)
    assert se3.is_rigid(T_world_cam)
    lowest = [float(se3.transform(T_world_cam, points)[:, 2].min()) for points in resting]
    np.testing.assert_allclose(np.delete(lowest, 4), 0.0, atol=0.003)
    assert lowest[4] == pytest.approx(0.12, abs=0.003)
