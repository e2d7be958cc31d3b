"""Masks as polygons, as a person could have drawn them: few corners, no specks."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray

COARSE = 1 / 1280
"""Largest distance of a polygon from the mask's border, as a share of the image's longer side."""
SPECK = 0.002
"""Parts smaller than this share of the largest one are left out, as are holes."""

Polygon = Float[ndarray, "_n 2"]


def traced(mask: Bool[ndarray, "H W"]) -> list[Polygon]:
    """Polygons around the parts of a mask [px]; filled (``clip.segments.polygons``) they give it again, nearly.

    A part with a hole has a polygon with a slit: along its border, in to the hole, around it and back out.
    """
    import cv2

    contours, tree = cv2.findContours(mask.astype(np.uint8), cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    if not contours:
        return []
    least = SPECK * max(float(cv2.contourArea(one)) for one in contours)
    coarse = COARSE * max(mask.shape)
    kept = {
        n: np.asarray(cv2.approxPolyDP(one, coarse, True)[:, 0], np.int64)
        for n, one in enumerate(contours)
        if cv2.contourArea(one) >= max(least, 1.0)
    }
    shapes = {n: corners for n, corners in kept.items() if tree[0][n][3] < 0 and len(corners) >= 3}
    for n, hole in kept.items():
        if (outside := int(tree[0][n][3])) in shapes and len(hole) >= 3:
            shapes[outside] = _with_hole(shapes[outside], hole)
    return [corners + 0.5 for corners in shapes.values()]


def _with_hole(outside: Int[ndarray, "n 2"], hole: Int[ndarray, "m 2"]) -> Int[ndarray, "k 2"]:
    """One polygon around both, slit where they are nearest to each other."""
    distance = np.linalg.norm(outside[:, None] - hole[None], axis=-1)
    i, j = np.unravel_index(int(distance.argmin()), distance.shape)
    around = np.concatenate([hole[j:], hole[: j + 1]])
    return np.concatenate([outside[: i + 1], around, outside[i:]])
