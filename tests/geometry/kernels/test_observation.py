"""Distance fields and boundaries of observed masks against their readable specification."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given

from getagrip.fitting.energy import mask
from getagrip.fitting.energy.mask import _spread_boundary_targets
from helpers import kernels as reference
from helpers.posed_meshes import SEEDS, blobs


@given(SEEDS)
def test_distance_fields(seed: int) -> None:
    seen, valid = blobs(seed)
    np.testing.assert_allclose(mask.signed_distance(seen, valid), reference.distance_field(seen, valid), atol=1e-4)


@given(SEEDS)
@pytest.mark.slow
def test_distances_are_rounded_correctly(seed: int) -> None:
    """Else the same clip would give other bits in other processes."""
    from scipy.ndimage import distance_transform_edt

    rng = np.random.default_rng(seed)
    for size in (32, 64, 250):
        target = rng.random((size, size)) < 0.3 / size
        np.testing.assert_array_equal(
            mask.distance_transform(target), distance_transform_edt(~target).astype(np.float32)
        )


def test_a_distance_field_of_nothing_is_far_away() -> None:
    nothing, everything = np.zeros((16, 16), bool), np.ones((16, 16), bool)
    for seen, valid in ((nothing, everything), (everything, everything), (nothing, nothing)):
        np.testing.assert_allclose(mask.signed_distance(seen, valid), reference.distance_field(seen, valid), atol=1e-4)


@given(SEEDS)
def test_borders_with_an_occluder_do_not_attract(seed: int) -> None:
    seen, valid = blobs(seed)
    field = mask.signed_distance(seen, valid)
    from scipy.ndimage import distance_transform_edt

    assert (field[seen] <= 0.5 - distance_transform_edt(~(valid & ~seen))[seen] + 1e-6).all()


@given(SEEDS)
def test_observed_boundary_points(seed: int) -> None:
    seen, valid = blobs(seed)
    field = mask.signed_distance(seen, valid)
    targets = np.empty((28, 5))
    _spread_boundary_targets(seen, valid, field, 2.0, targets)
    expected = reference.boundary_targets(seen, valid, field, 2.0, 28)
    np.testing.assert_allclose(targets, expected, atol=1e-4)
    assert (targets[:, 4] > 0).any()
