"""Checks of one segment's result, whatever its state: what a hand need not tell."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.checks.check import Check, percent
from getagrip.checks.evidence import Evidence
from getagrip.geometry import se3
from getagrip.geometry.depth import covered

NEAREST, FARTHEST = 0.05, 20.0
"""Distances from the camera [m] that are plausible of an object, as they are of a given hand."""
LEAST_SHOWN = 0.5
"""A mask with a smaller share of the largest one's pixels shows too little of the object to tell where that is."""


def distance(it: Evidence) -> float:
    """Return the object's distance from the camera [m]: the least where that is too near, else the largest."""
    middle = _posed(it).mean(axis=1)
    away = np.linalg.norm(middle, axis=1)
    return float(away.min() if away.min() < NEAREST else away.max())


def pixels(it: Evidence) -> float:
    """Return the pixels of the largest mask."""
    return float(it.mask_area.max())


def drift(it: Evidence) -> float:
    """Measure how far masks move against the silhouette.

    That is the distance of their middles from where it is in most frames, in sizes of the mask (the root of its area),
    but for the tenth of the frames in which it is largest.
    """
    posed, offsets = _posed(it), []
    for n in np.flatnonzero(it.mask_area >= LEAST_SHOWN * it.mask_area.max()):
        mask, ignored = it.masks.object[n], it.masks.ignore[n]
        silhouette = covered(posed[n], it.clip.mesh.faces, it.clip.K[n], it.clip.size) & (mask | ~ignored)
        if silhouette.any():
            rows, columns = np.nonzero(silhouette)
            middle = np.array([columns.mean(), rows.mean()]) + 0.5
            offsets.append((it.centroids[n] - middle) / np.sqrt(it.mask_area[n]))
    if not offsets:
        return float("nan")
    from_most = np.linalg.norm(np.array(offsets) - np.median(offsets, axis=0), axis=1)
    return float(np.quantile(from_most, 0.9))


def _posed(it: Evidence) -> Float[ndarray, "T V 3"]:
    """Return the object's vertices before the camera [m]."""
    assert it.T_hand_obj is not None
    return np.asarray(se3.transform(it.clip.hand.T_cam_hand @ it.T_hand_obj, it.scale * it.clip.mesh.vertices))


SEGMENT_CHECKS = (
    Check(
        "object-distance", distance, low=NEAREST, high=FARTHEST, shown="{:.3g} m".format,
        fault="the object is {value} from the camera",
        advice="check the masks, the mesh's size and the focal length",
    ),
    Check(
        "mask-pixels", pixels, low=50.0,
        fault="even the largest mask has {value} pixels only, too few to locate the object",
        advice="are these masks of the object? Give larger images",
    ),
)  # fmt: skip
STATIC = Check(
    "static-moves", drift, high=0.2, shown=percent,
    fault="the segment is static, but the masks move by {value} of their size against one pose",
    advice="does the object move in some of these frames, or is the camera's motion wrong? Correct the segments",
)  # fmt: skip
