"""Two masks of a frame that differ: a mug whose inside, of another colour, only one key shows."""

from __future__ import annotations

import numpy as np
import pytest
from numpy import ndarray

from getagrip.studio.masks.graph_cut import ColourHistogram, colour_bins
from getagrip.studio.masks.optical_flow import SmallFrame
from getagrip.studio.masks.propagate_clip import merge_masks
from getagrip.studio.masks.propagate_frame import TrackedMask, place_in_window, signed_distance
from getagrip.studio.store.labels import OBJECT_LABEL, OCCLUDER_LABEL

SIZE = (120, 100)


def box(left: int, top: int, right: int, bottom: int) -> ndarray:
    out = np.zeros(SIZE[::-1], bool)
    out[top:bottom, left:right] = True
    return out


OUTSIDE, INSIDE, GROUND = box(40, 40, 80, 80), box(40, 25, 80, 40), box(80, 40, 95, 80)
IMAGE = np.full((*SIZE[::-1], 3), (150, 110, 70), np.uint8)
IMAGE[OUTSIDE], IMAGE[INSIDE] = (30, 90, 50), (160, 160, 165)
FRAME = SmallFrame(IMAGE, colour_bins(IMAGE), IMAGE)
COLOURS = [ColourHistogram.of(IMAGE, OUTSIDE | INSIDE, np.ones(SIZE[::-1], bool))]


def carried(mask: ndarray, trust: float = 1.0) -> TrackedMask:
    nothing = np.full((2, *mask.shape), -24.0, np.float32)
    inside = np.concatenate([signed_distance(mask)[None], nothing])
    return TrackedMask(5, (0, 0), inside, np.ones(mask.shape, np.float32), trust, np.zeros(mask.shape, np.float32))


@pytest.mark.parametrize("share", [0.2, 0.5, 0.8])
def test_where_two_masks_differ_the_keys_colours_decide(share: float) -> None:
    """What one of them has lost is the object's; what the other has of the ground is not, however near its key is."""
    true = OUTSIDE | INSIDE
    for one, other in ((true, OUTSIDE), (OUTSIDE, true), (true, true | GROUND), (OUTSIDE | GROUND, true)):
        both, confidence = merge_masks(carried(one), carried(other), share, FRAME, COLOURS)
        found = place_in_window(both, (0, 0), SIZE)[0][OBJECT_LABEL - 1] > 0
        assert (found & true).sum() / (found | true).sum() > 0.95
        apart = 1.0 - (one & other).sum() / (one | other).sum()
        assert confidence == pytest.approx(1.0 - 4.0 * share * (1.0 - share) * apart**2)


@pytest.mark.parametrize("share", [0.1, 0.9])
def test_what_is_in_front_comes_from_the_side_that_has_not_lost_its_way(share: float) -> None:
    hand = box(70, 40, 95, 80)
    sees, lost = carried(OUTSIDE | INSIDE), carried(OUTSIDE | GROUND, trust=0.01)
    sees.inside[OCCLUDER_LABEL - 1], sees.known[hand] = signed_distance(hand), 0.0
    both, _ = merge_masks(sees, lost, share, FRAME, COLOURS)
    found = place_in_window(both, (0, 0), SIZE)[0][OCCLUDER_LABEL - 1] > 0
    assert (found == hand).mean() > 0.99


def test_what_lies_beyond_a_cut_does_not_count() -> None:
    """There is one side only, then; its trust is all that is known."""
    for trusts in ((0.0, 0.7), (0.7, 0.0), (0.0, 0.0)):
        one, other = (carried(OUTSIDE, trust) for trust in trusts)
        assert merge_masks(one, other, 0.5, FRAME, COLOURS)[1] == max(trusts)


def test_two_empty_masks_are_an_empty_one() -> None:
    empty = np.zeros((0, 0), np.float32)
    nothing = TrackedMask(5, (3, 4), np.zeros((3, 0, 0), np.float32), empty, 1.0, empty)
    both, confidence = merge_masks(nothing, nothing, 0.5, FRAME, COLOURS)
    assert not both.inside.size
    assert confidence == 1.0
