"""Gaps between the object's masks and those of what hides it: what lies in them tells nothing.

Where a hand hides an object, the one's mask begins where the other's ends. Masks of annotators and networks often leave
a few pixels between them that are neither's. Counted as background, these say that the object ends there, though it
goes on behind the hand: at the true pose they are in the silhouette and not in the mask, nothing elsewhere makes up for
it, and the object is drawn away from the hand.
"""

from __future__ import annotations

import cv2
import numpy as np
from jaxtyping import Bool
from numpy import ndarray

from getagrip.compiling import kernel

MAX_GAP_PX = 12
"""Widest gap [px of the crop]."""
OPPOSITE_SIDES_COSINE = np.cos(np.radians(120.0))
"""A gap's pixel has the object on one side and what hides it on the other; by the cosine of the angle between them."""
GAP_SHARE = 0.4
"""Masks have gaps where these are so large a share of the border. Exact masks have pixels between the two, too, in the
corners where the object's outline goes behind the hand: less, in nine clips of ten. (Medians over DexYCB's training
subjects: exact 0.23, gaps of 1 px 0.66, of 2 px 0.95; contours off by 1, 2 and 4 px 0.37, 0.57 and 0.65.)"""
_Y, _X = np.mgrid[-MAX_GAP_PX : MAX_GAP_PX + 1, -MAX_GAP_PX : MAX_GAP_PX + 1].reshape(2, -1)
_OFFSET_ORDER = np.argsort(_X * _X + _Y * _Y, kind="stable")
_OFFSETS = np.stack([_X, _Y], axis=1)[_OFFSET_ORDER][1:]
"""Steps (x, y) to other pixels, nearest first."""


def find_gap_pixels(
    observed: Bool[ndarray, "N s s"], hidden: Bool[ndarray, "N s s"], share: float = GAP_SHARE
) -> Bool[ndarray, "N s s"]:
    """Return the pixels of a clip's crops in gaps between the object's masks and what hides it.

    The nearest pixels of both are on opposite sides of these, and a gap is at most ``MAX_GAP_PX`` pixels wide. There are
    none unless gaps are more than ``share`` of the border of both: no masks have any by 1, all that keep apart by 0.
    """
    if share >= 1.0:
        return np.zeros_like(observed)
    found, touching = np.empty_like(observed), 0
    around = np.ones((2 * MAX_GAP_PX + 1, 2 * MAX_GAP_PX + 1), np.uint8)
    for n, (s, h) in enumerate(zip(observed, hidden, strict=True)):
        near, near_hidden = (cv2.dilate(m.view(np.uint8), around).view(bool) for m in (s, h))
        found[n] = near & near_hidden & ~(s | h)
        _keep_gaps(s, h, _OFFSETS, found[n])
        touching += int(np.count_nonzero(cv2.dilate(h.view(np.uint8), around[:3, :3]).view(bool) & s))
    area = int(np.count_nonzero(found))
    return found if area > share * (area + touching) else np.zeros_like(found)


@kernel("b2 b2 i2 b2")
def _keep_gaps(observed, hidden, offsets, found):
    """Keep those of the pixels in ``found`` that are in gaps."""
    size = len(found)
    for i in range(size):
        for j in range(size):
            if not found[i, j]:
                continue
            x0 = y0 = x1 = y1 = 0
            to_object = to_hidden = 0.0
            for k in range(len(offsets)):
                x, y = offsets[k, 0], offsets[k, 1]
                distance = np.sqrt(x * x + y * y)
                # One that is yet to be found is no nearer than this: then the gap is too wide.
                if distance + (max(to_object, to_hidden) or distance) > MAX_GAP_PX + 1.0:
                    break
                if not (0 <= i + y < size and 0 <= j + x < size):
                    continue
                if to_object == 0.0 and observed[i + y, j + x]:
                    x0, y0, to_object = x, y, distance
                if to_hidden == 0.0 and hidden[i + y, j + x]:
                    x1, y1, to_hidden = x, y, distance
                if to_object > 0.0 and to_hidden > 0.0:
                    break
            both = to_object > 0.0 and to_hidden > 0.0
            found[i, j] = both and x0 * x1 + y0 * y1 <= OPPOSITE_SIDES_COSINE * to_object * to_hidden
