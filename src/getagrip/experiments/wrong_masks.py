"""Masks that are wrong in some frames, as those of a video segmenter that loses its object.

``changes.WrongMasks`` makes them. Sizes are in that of the mask: the root of its area.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

Fault = Callable[[Bool[ndarray, "H W"], Float[ndarray, "2"]], Bool[ndarray, "H W"]]
"""From a mask that is not empty, and a direction (x, y) in the image, to a wrong one."""
AWAY, BESIDE, RADIUS = 1.2, 0.6, 0.6
"""Distance of another object; distance from the mask's middle, and radius, of the disc by which a mask runs over."""


def another_object(mask: Bool[ndarray, "H W"], towards: Float[ndarray, "2"]) -> Bool[ndarray, "H W"]:
    """Return a mask of the same shape beside the object."""
    rows, columns = np.nonzero(mask)
    dx, dy = np.rint(AWAY * np.sqrt(len(rows)) * towards).astype(int)
    rows, columns = rows + dy, columns + dx
    inside = (rows >= 0) & (rows < len(mask)) & (columns >= 0) & (columns < mask.shape[1])
    wrong = np.zeros_like(mask)
    wrong[rows[inside], columns[inside]] = True
    return wrong


def half(mask: Bool[ndarray, "H W"], towards: Float[ndarray, "2"]) -> Bool[ndarray, "H W"]:
    """Return one side of the object."""
    dx, dy = _from_middle(mask)
    return mask & (dx * towards[0] + dy * towards[1] < 0.0)


def over(mask: Bool[ndarray, "H W"], towards: Float[ndarray, "2"]) -> Bool[ndarray, "H W"]:
    """Return the object with a disc that its mask runs over."""
    dx, dy = _from_middle(mask)
    size = np.sqrt(np.count_nonzero(mask))
    return mask | (np.hypot(dx - BESIDE * size * towards[0], dy - BESIDE * size * towards[1]) < RADIUS * size)


def _from_middle(mask: Bool[ndarray, "H W"]) -> tuple[Float[ndarray, "1 W"], Float[ndarray, "H 1"]]:
    """Columns and rows, from those of the mask's middle."""
    rows, columns = np.nonzero(mask)
    return np.arange(mask.shape[1])[None] - columns.mean(), np.arange(len(mask))[:, None] - rows.mean()


FAULTS: dict[str, Fault] = {"another object": another_object, "half": half, "runs over": over}
"""Each fault, by the name that tables call it."""
