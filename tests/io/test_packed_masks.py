"""Packed masks stand for arrays, in little memory."""

from __future__ import annotations

import pickle
import tracemalloc
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from numpy import ndarray

from getagrip.clip import Masks, read_clip, read_masks, write_clip
from getagrip.clip.clip import FrameMasks
from getagrip.geometry.camera import bounding_boxes
from getagrip.io.images import PackedMask, PackedMasks, pack_masks
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


@st.composite
def any_masks(draw: st.DrawFn) -> ndarray:
    """Draw a mask: empty, full, of a box that may touch the border, or of any pixels."""
    height, width = draw(st.integers(1, 14)), draw(st.integers(1, 40))
    mask = np.zeros((height, width), dtype=bool)
    (top, bottom), (left, right) = (sorted(draw(st.integers(0, side)) for _ in "ab") for side in (height, width))
    fill = draw(st.sampled_from([0.0, 0.2, 1.0]))
    box = mask[top:bottom, left:right]
    box[:] = np.random.default_rng(draw(st.integers(0, 99))).random(box.shape) < fill
    return mask | draw(st.sampled_from([False, False, False, True]))


@given(mask=any_masks(), data=st.data())
def test_a_packed_mask_is_the_array(mask: ndarray, data: st.DataObject) -> None:
    packed, (height, width) = PackedMask.of(mask), mask.shape
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    box = (columns[0], rows[0], columns[-1] + 1, rows[-1] + 1) if mask.any() else (0, 0, 0, 0)
    assert (packed.box, packed.area, packed.is_full) == (box, mask.sum(), mask.all())
    np.testing.assert_array_equal(packed.unpacked, mask)
    np.testing.assert_array_equal(PackedMask.of_bits(np.packbits(mask, axis=1), width).unpacked, mask)
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(packed)).unpacked, mask)
    np.testing.assert_array_equal(PackedMask.full(mask.shape).unpacked, np.ones_like(mask))
    np.testing.assert_array_equal(PackedMask.empty(mask.shape).unpacked, np.zeros_like(mask))

    around = np.pad(mask, 9)  # a part may leave the image
    (top, bottom), (left, right) = (
        sorted(data.draw(st.integers(-9, side + 9)) for _ in "ab") for side in (height, width)
    )
    expected = around[top + 9 : bottom + 9, left + 9 : right + 9]
    np.testing.assert_array_equal(packed.part((left, top, right, bottom)), expected)
    at = [np.sort(data.draw(hnp.arrays(int, 5, elements=st.integers(-9, side + 8)))) for side in (height, width)]
    np.testing.assert_array_equal(packed.grid(*at), around[at[0][:, None] + 9, at[1] + 9])
    np.testing.assert_array_equal(packed.at(at[0][::-1], at[1]), around[at[0][::-1] + 9, at[1] + 9])

    grown = cv2.dilate(mask.view(np.uint8), np.ones((3, 3), np.uint8)).view(bool)
    np.testing.assert_array_equal(packed.grown.unpacked, grown)


@given(mask=any_masks(), seed=st.integers(0, 99), fill=st.sampled_from([0.0, 0.5, 1.0]))
def test_two_masks_are_compared_as_arrays(mask: ndarray, seed: int, fill: float) -> None:
    other = np.random.default_rng(seed).random(mask.shape) < fill
    one, two = PackedMask.of(mask), PackedMask.of(other)
    assert one.exceeds(two) == (mask & ~other).any()
    assert one.box_with(two) == PackedMask.of(mask | other).box


def test_masks_of_workers_stay_packed() -> None:
    back = pickle.loads(pickle.dumps(PACKED))
    assert isinstance(back, PackedMasks)
    np.testing.assert_array_equal(back, DENSE)
    np.testing.assert_array_equal(back.boxes, bounding_boxes(DENSE))
    np.testing.assert_array_equal(back.areas, DENSE.sum(axis=(1, 2)))
    assert pack_masks(back) is back
    np.testing.assert_array_equal(pack_masks(DENSE), DENSE)


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
