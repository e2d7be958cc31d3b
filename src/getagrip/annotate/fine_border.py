"""The border of a mask at the image's own size: pixels near to it go to the side with the more similar colours nearby.

Localised region-based segmentation (Lankton, Tannenbaum, "Localizing Region-Based Active Contours", IEEE TIP 2008), one
step of it from the border that was found at a smaller size.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float32, UInt8
from numpy import ndarray

BORDER_SEARCH_PX = 2.5
"""The border moves by less than this [px of the smaller size]."""
SIDE_INTERIOR_PX = 0.8
"""Pixels farther from it than this count for their side's colours [px of the smaller size]."""
COLOUR_WINDOW_RADIUS_PX = 4.0
"""Half side of the squares in which colours are averaged: small, but from wherever the border may be they reach both
sides [px of the smaller size]."""
BORDER_SMOOTHING_PX = 0.5
"""Standard deviation of the Gaussian that smooths the border [px of the smaller size]."""
SIDE_COLOUR_SIGMA = 4.0
"""Standard deviation of a side's colours [of 255]."""


def refine_full_resolution(
    image: UInt8[ndarray, "H W 3"], inside: Float32[ndarray, "H W"], zoom: float
) -> Bool[ndarray, "H W"]:
    """Draw the border anew, near the one that signed distances give [px of the smaller size].

    ``zoom``: how many times larger the image is.
    """
    import cv2

    near = np.abs(inside) < BORDER_SEARCH_PX
    if not near.any():
        return np.asarray(inside > 0.0)
    margin = round((BORDER_SEARCH_PX + COLOUR_WINDOW_RADIUS_PX) * zoom)
    rows, columns = (slice(max(0, int(i.min()) - margin), int(i.max()) + margin) for i in np.nonzero(near))
    part = rows, columns
    colours = cv2.cvtColor(np.ascontiguousarray(image[part]), cv2.COLOR_RGB2LAB).astype(np.float32)
    square = (2 * round(COLOUR_WINDOW_RADIUS_PX * zoom) + 1,) * 2
    apart = []
    for side in (inside[part] > SIDE_INTERIOR_PX, inside[part] < -SIDE_INTERIOR_PX):
        weight = side.astype(np.float32)
        total = cv2.boxFilter(weight, -1, square) + 1e-4
        mean = cv2.boxFilter(colours * weight[..., None], -1, square) / total[..., None]
        off = colours - mean
        apart.append(np.einsum("hwc,hwc->hw", off, off) + SIDE_COLOUR_SIGMA**2)
    score = inside[part] / BORDER_SEARCH_PX + (apart[1] - apart[0]) / (apart[1] + apart[0])
    found = inside > 0.0
    smooth = cv2.GaussianBlur(score, (0, 0), BORDER_SMOOTHING_PX * zoom)
    found[part] = np.where(near[part], smooth > 0.0, found[part])
    return np.asarray(found)
