"""Wrong masks are wrong in the way that their names say, in as many frames as asked for."""

from __future__ import annotations

import numpy as np

from getagrip.experiments.changes import FAULTS, WrongMasks, another_object, half, over
from helpers.scenes import SHORT, scene


def test_what_each_fault_does() -> None:
    mask, towards = np.zeros((60, 80), dtype=bool), np.array([1.0, 0.0])
    mask[20:40, 30:50] = True
    assert not (another_object(mask, towards) & mask).any()
    assert np.count_nonzero(another_object(mask, towards)) == np.count_nonzero(mask)
    left = half(mask, towards)
    np.testing.assert_array_equal(left, mask & (np.arange(80) < 40))
    assert (over(mask, towards) & mask).sum() == mask.sum()
    assert over(mask, towards)[:, 50:].any()
    assert not over(mask, towards)[:, :30].any()


def test_a_share_of_the_frames_has_wrong_masks_never_in_ignored_pixels() -> None:
    clip, masks = scene("can", 0, SHORT)
    for fault in FAULTS:
        same, changed = WrongMasks(fault, 0.5)(clip, masks, 0)
        assert same is clip
        differ = (changed.object != masks.object).any(axis=(1, 2))
        assert differ.sum() == 2
        assert not (changed.object & masks.ignore & ~masks.object).any()
    again = WrongMasks(fault, 0.5)(clip, masks, 0)[1]
    np.testing.assert_array_equal(changed.object, again.object)
