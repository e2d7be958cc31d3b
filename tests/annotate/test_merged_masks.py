"""Two masks of a frame that differ: a mug whose inside, of another colour, only one key shows."""

from __future__ import annotations

import numpy as np
import pytest
from numpy import ndarray

from getagrip.annotate.carried_masks import Carried, placed, signed_distance
from getagrip.annotate.colour_cut import Colours
from getagrip.annotate.labels import OBJECT
from getagrip.annotate.merged_masks import merged

SIZE = (120, 100)


def box(left: int, top: int, right: int, bottom: int) -> ndarray:
    out = np.zeros(SIZE[::-1], bool)
    out[top:bottom, left:right] = True
    return out


OUTSIDE, INSIDE, GROUND = box(40, 40, 80, 80), box(40, 25, 80, 40), box(80, 40, 95, 80)
IMAGE = np.full((*SIZE[::-1], 3), (150, 110, 70), np.uint8)
IMAGE[OUTSIDE], IMAGE[INSIDE] = (30, 90, 50), (160, 160, 165)
COLOURS = [Colours.of(IMAGE, OUTSIDE | INSIDE, np.ones(SIZE[::-1], bool))]


def carried(mask: ndarray, trust: float = 1.0) -> Carried:
    nothing = np.full((2, *mask.shape), -24.0, np.float32)
    inside = np.concatenate([signed_distance(mask)[None], nothing])
    return Carried(5, (0, 0), inside, np.ones(mask.shape, np.float32), trust)


@pytest.mark.parametrize("share", [0.2, 0.5, 0.8])
def test_where_two_masks_differ_the_keys_colours_decide(share: float) -> None:
    """What one of them has lost is the object's; what the other has of the ground is not, however near its key is."""
    true = OUTSIDE | INSIDE
    for one, other in ((true, OUTSIDE), (OUTSIDE, true), (true, true | GROUND), (OUTSIDE | GROUND, true)):
        both, agreement = merged(carried(one), carried(other), share, IMAGE, COLOURS)
        found = placed(both, (0, 0), SIZE)[0][OBJECT - 1] > 0
        assert (found & true).sum() / (found | true).sum() > 0.95
        assert agreement == pytest.approx((one & other).sum() / (one | other).sum())


def test_two_empty_masks_are_an_empty_one() -> None:
    nothing = Carried(5, (3, 4), np.zeros((3, 0, 0), np.float32), np.zeros((0, 0), np.float32), 1.0)
    both, agreement = merged(nothing, nothing, 0.5, IMAGE, COLOURS)
    assert not both.inside.size
    assert agreement == 1.0
