"""Laws of the frames that are used."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from getagrip.clip.clip import frame_indices


@given(st.integers(1, 400), st.integers(2, 60))
def test_frames_are_spread_over_the_clip(frames: int, wanted: int) -> None:
    index = frame_indices(frames, wanted)
    assert index[0] == 0
    assert index[-1] == frames - 1
    assert len(index) == min(frames, wanted)
    gaps = np.diff(index)
    assert len(gaps) == 0 or (gaps.min() >= 1 and gaps.max() - gaps.min() <= 1)
