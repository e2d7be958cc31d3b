"""Equal rows."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from getagrip.geometry.mesh import same_rows

few = st.sampled_from([-1.5, -0.0, 0.0, 2.0])


@given(arrays(float, st.tuples(st.integers(0, 20), st.integers(1, 3)), elements=few))
def test_they_are_numbered_as_by_numpy(rows: np.ndarray) -> None:
    _, number = np.unique(rows, axis=0, return_inverse=True)
    np.testing.assert_array_equal(same_rows(rows), number.ravel())
