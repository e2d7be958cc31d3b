"""Wrong masks are wrong in the way that their names say, in as many frames as asked for."""

from __future__ import annotations

import numpy as np

from getagrip.bench.inputs.perturbations import (
    MASK_FAULTS,
    WrongMasks,
    displace_mask,
    extend_mask_by_disc,
    halve_mask,
)
from helpers.scenes import SHORT, scene


def test_what_each_fault_does() -> None:
    mask, towards = np.zeros((60, 80), dtype=bool), np.array([1.0, 0.0])
    mask[20:40, 30:50] = True
    assert not (displace_mask(mask, towards) & mask).any()
    assert np.count_nonzero(displace_mask(mask, towards)) == np.count_nonzero(mask)
    left = halve_mask(mask, towards)
    np.testing.assert_array_equal(left, mask & (np.arange(80) < 40))
    assert (extend_mask_by_disc(mask, towards) & mask).sum() == mask.sum()
    assert extend_mask_by_disc(mask, towards)[:, 50:].any()
    assert not extend_mask_by_disc(mask, towards)[:, :30].any()


def test_a_share_of_the_frames_has_wrong_masks_never_in_ignored_pixels() -> None:
    clip, masks = scene("can", 0, SHORT)
    for fault in MASK_FAULTS:
        same, changed = WrongMasks(fault, 0.5)(clip, masks, 0)
        assert same is clip
        differ = (changed.object != masks.object).any(axis=(1, 2))
        assert differ.sum() == 2
        assert not (changed.object & masks.ignore & ~masks.object).any()
    again = WrongMasks(fault, 0.5)(clip, masks, 0)[1]
    np.testing.assert_array_equal(changed.object, again.object)
