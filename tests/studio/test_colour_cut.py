"""Bins of colours."""

from __future__ import annotations

import cv2
import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from getagrip.studio.masks.graph_cut import (
    COLOUR_PSEUDO_COUNT,
    KEYFRAME_COLOUR_WEIGHT,
    N_COLOUR_BINS,
    N_IMAGE_CELLS,
    ColourHistogram,
    LocalColourHistogram,
    colour_bins,
    colour_log_ratio,
)


def bin_of(lab: tuple[int, int, int]) -> tuple[int, int, int]:
    """The three bins of a colour of Lab that is one of RGB."""
    rgb = cv2.cvtColor(np.array([[lab]], np.uint8), cv2.COLOR_LAB2RGB)
    found = int(colour_bins(rgb)[0, 0])
    return found // N_COLOUR_BINS**2, found // N_COLOUR_BINS % N_COLOUR_BINS, found % N_COLOUR_BINS


@given(light=st.integers(90, 190), a=st.integers(108, 148), b=st.integers(108, 148), more=st.integers(0, 20))
def test_bins_rise_with_each_colour(light: int, a: int, b: int, more: int) -> None:
    low, high = bin_of((light, a, b)), bin_of((light, a, b + more))
    assert low[2] <= high[2]
    assert all(0 <= each < N_COLOUR_BINS for each in (*low, *high))


def test_colours_beside_grey_are_told_apart() -> None:
    """Skin, white cardboard and a beige floor are within a tenth of the range."""
    assert bin_of((160, 128, 122))[2] < bin_of((160, 128, 128))[2] < bin_of((160, 128, 134))[2]


@given(seed=st.integers(0, 99))
def test_what_places_say_of_a_colour_changes_steadily_and_in_a_cell_is_its_own(seed: int) -> None:
    rng = np.random.default_rng(seed)
    at, inside = rng.integers(0, 4, (80, 80)).astype(np.int32), rng.random((80, 80)) < 0.5
    keys, places = (
        ColourHistogram(np.zeros((2, N_COLOUR_BINS**3), np.float32)),
        LocalColourHistogram.of(at, inside, np.ones((80, 80), bool)),
    )
    x, y = np.meshgrid(np.arange(0.0, 80.0, 0.1, dtype=np.float32), np.float32([34.5, 44.5]))
    said = colour_log_ratio(np.zeros(x.shape, np.int32), keys, places, (x, y))
    assert np.abs(np.diff(said)).max() < 0.1
    middle = (np.arange(N_IMAGE_CELLS) + 0.5) * 80.0 / N_IMAGE_CELLS - 0.5
    counts = (
        places.counts[:, (3 * N_IMAGE_CELLS + np.arange(N_IMAGE_CELLS)) * N_COLOUR_BINS**3]
        + COLOUR_PSEUDO_COUNT * KEYFRAME_COLOUR_WEIGHT / N_COLOUR_BINS
    )
    np.testing.assert_allclose(np.interp(middle, x[0], said[0]), np.log(counts[0] / counts[1]), atol=0.01)
