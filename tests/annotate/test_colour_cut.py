"""Bins of colours."""

from __future__ import annotations

import cv2
import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from getagrip.annotate.colour_cut import BINS, bins


def bin_of(lab: tuple[int, int, int]) -> tuple[int, int, int]:
    """The three bins of a colour of Lab that is one of RGB."""
    rgb = cv2.cvtColor(np.array([[lab]], np.uint8), cv2.COLOR_LAB2RGB)
    found = int(bins(rgb)[0, 0])
    return found // BINS**2, found // BINS % BINS, found % BINS


@given(light=st.integers(90, 190), a=st.integers(108, 148), b=st.integers(108, 148), more=st.integers(0, 20))
def test_bins_rise_with_each_colour(light: int, a: int, b: int, more: int) -> None:
    low, high = bin_of((light, a, b)), bin_of((light, a, b + more))
    assert low[2] <= high[2]
    assert all(0 <= each < BINS for each in (*low, *high))


def test_colours_beside_grey_are_told_apart() -> None:
    """Skin, white cardboard and a beige floor are within a tenth of the range."""
    assert bin_of((160, 128, 122))[2] < bin_of((160, 128, 128))[2] < bin_of((160, 128, 134))[2]
