"""Packed masks stand for arrays, in little memory."""

from __future__ import annotations

import tracemalloc
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy import ndarray

from getagrip.clip import Masks, read_clip, read_masks, write_clip
from getagrip.clip.clip import FrameMasks
from getagrip.io.images import PackedMasks
from helpers.clips import small_clip

DENSE = np.random.default_rng(0).random((5, 7, 19)) < 0.2
DENSE[2] = False
DENSE[3] = False
DENSE[3, 6, 18] = True
PACKED: Any = PackedMasks.of(DENSE, (19, 7))
SOME = np.array([4, 0, 2])


def test_they_are_the_array() -> None:
    assert (PACKED.shape, len(PACKED), PACKED.dtype, PACKED.ndim) == (DENSE.shape, 5, bool, 3)
    np.testing.assert_array_equal(PACKED, DENSE)
    np.testing.assert_array_equal(np.stack(list(PACKED)), DENSE)
    np.testing.assert_array_equal(PACKED[-1], DENSE[-1])
    for index in (SOME, slice(1, 4), DENSE.any(axis=(1, 2))):
        assert isinstance(PACKED[index], PackedMasks)
        np.testing.assert_array_equal(PACKED[index], DENSE[index])
    np.testing.assert_array_equal(PACKED[:, 2:4, -1], DENSE[:, 2:4, -1])
    np.testing.assert_array_equal(PACKED.any(axis=(1, 2)), DENSE.any(axis=(1, 2)))
    np.testing.assert_array_equal(PACKED.any(axis=1), DENSE.any(axis=1))
    np.testing.assert_array_equal(PACKED.copy(), DENSE)
    assert PACKED.any()
    assert not PACKED[2:3].any()


def test_operators_give_arrays() -> None:
    turned = DENSE[::-1]
    for made, true in ((PACKED & turned, DENSE & turned), (~PACKED, ~DENSE), (DENSE | PACKED[::-1], DENSE | turned)):
        assert isinstance(made, ndarray)
        np.testing.assert_array_equal(made, true)


def test_a_frame_cannot_be_written_to() -> None:
    with pytest.raises(ValueError, match="read-only"):
        PACKED[0][0, 0] = True


def test_masks_of_a_folder_equal_those_written(tmp_path: Path) -> None:
    clip, masks = small_clip(3)
    found = read_masks(read_clip(write_clip(clip, masks, tmp_path / clip.name)))
    assert isinstance(found.object, PackedMasks)
    assert found == masks
    assert found.take(SOME[1:]) == masks.take(SOME[1:])
    np.testing.assert_array_equal(found.observed, masks.observed)


def test_long_clips_take_a_bit_for_a_pixel_of_the_object() -> None:
    size, count = (1920, 1080), 60

    def frames() -> Any:
        for n in range(count):
            mask = np.zeros(size[::-1], dtype=bool)
            mask[300 : 700 + n, 400:900] = True
            yield FrameMasks(mask, mask)

    tracemalloc.start()
    masks = Masks.packed(frames(), size)
    assert masks.observed.sum() == 0
    assert [int(mask.sum()) for mask in masks.object] == [500 * (400 + n) for n in range(count)]
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 12 * size[0] * size[1] + count * 2 * 500 * 500 // 7  # a few frames, and all of them packed
