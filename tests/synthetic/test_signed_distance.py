"""The least distance of moving points is that of all of them, though few are looked up."""

from __future__ import annotations

import numpy as np
import pytest

from getagrip.geometry import se3
from getagrip.synthetic.grasp import MinSignedDistance, SignedDistance
from getagrip.synthetic.objects import mug


@pytest.mark.parametrize("step", [0.0, 0.002, 0.05])
def test_the_least_is_that_of_all_points(step: float) -> None:
    distance, rng = SignedDistance(mug()), np.random.default_rng(0)
    X = 0.06 * rng.normal(size=(3, 40, 3)) + [0.0, 0.08, 0.0]
    least = MinSignedDistance(distance, 3, X)
    for k in range(8):
        which = np.flatnonzero(rng.uniform(size=3) < 0.8)
        turn = se3.exp_so3(5.0 * step * rng.normal(size=(3, 3)))
        X = X @ turn + step * np.array([0.0, -1.0, 0.0]) + 0.1 * step * rng.normal(size=X.shape)
        np.testing.assert_array_equal(least(X[which], which), distance(X[which]).min(axis=-1), err_msg=str(k))
    at_once = MinSignedDistance(distance, 3, X[0])(X, np.arange(3))
    np.testing.assert_array_equal(at_once, distance(X).min(axis=-1))
