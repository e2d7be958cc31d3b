"""Polygons and run lengths give the pixels that they hold, or are refused."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from getagrip.errors import InputError
from getagrip.readers.masks.mask_regions import decode_region, decode_run_lengths, fill_polygons
from helpers.program_files import SIZE, encoded


def test_polygons_fill_the_pixels_whose_centres_they_hold() -> None:
    square = fill_polygons(Path("c.json"), "s", [[3.0, 2.0, 9.0, 2.0, 9.0, 6.0, 3.0, 6.0]], SIZE)
    expected = np.zeros(SIZE[::-1], dtype=bool)
    expected[2:6, 3:9] = True
    inner = np.zeros_like(expected)
    inner[3:5, 4:8] = True
    assert square[inner].all()
    assert np.count_nonzero(square != expected) <= 2 * (6 + 4) + 4  # the border's own pixels, at most
    everything = fill_polygons(Path("c.json"), "s", [[-20, -14, 40, -14, 40, 28, -20, 28]], SIZE)
    assert everything.all()


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(0.0, 1.0), st.booleans())
def test_run_lengths_come_back(seed: int, share: float, compressed: bool) -> None:
    mask = np.random.default_rng(seed).random(SIZE[::-1]) < share
    np.testing.assert_array_equal(decode_run_lengths(Path("c"), "s", encoded(mask, compressed), SIZE), mask)


JUNK = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**70), 2**70) | st.floats() | st.text(max_size=12),
    lambda inner: st.lists(inner, max_size=8) | st.dictionaries(st.sampled_from(["size", "counts", "x"]), inner),
    max_leaves=20,
)


@settings(max_examples=200, deadline=None)
@given(JUNK | st.fixed_dictionaries({"size": st.just([14, 20]), "counts": JUNK | st.text("0123456789:;<=>?@PQRSTUVo")}))
@pytest.mark.slow
def test_any_segmentation_is_read_or_refused(value: Any) -> None:
    try:
        assert decode_region(Path("c.json"), "annotations[0].segmentation", value, SIZE).shape == SIZE[::-1]
    except InputError as error:
        assert "annotations[0].segmentation" in str(error)  # noqa: PT017


@pytest.mark.parametrize(
    "segmentation",
    [
        [[1, 1, 2, 2]],
        [[float("inf"), 1, 2, 2, 3, 3]],
        [[1e9, 1, 2, 2, 3, 3]],
        [["a", 1, 2, 2, 3, 3]],
        [[1, 1, 2, 2, 3, 3, 4]],
        {"size": [14, 21], "counts": [294]},
        {"size": [14, 20], "counts": [2**62, 2**62]},
        {"size": [14, 20], "counts": [-1, 281]},
        {"size": [14, 20], "counts": "o" * 100},
        {"size": [14, 20], "counts": "\u00ff"},
    ],
)
def test_impossible_segmentations(refused: Callable[..., str], segmentation: Any) -> None:
    refused(lambda: decode_region(Path("c.json"), "annotations[7]", segmentation, SIZE), "c.json", "annotations[7]")
