"""Agreement of masks where they differ from the result: if they agree, the result is wrong and not the masks.

Where a right result differs from rough masks, it does so elsewhere in each frame. A wrong pose, hand, mesh or camera
differs from exact masks at the same side of the object in successive frames. Where it meets most masks and some
successive ones much less, these masks lack a part, or their hands are wrong.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.checks.evidence import Evidence
from getagrip.geometry.depth import render_coverage

UNKNOWN_VALUE = float("nan")
MAX_GOOD_MISFIT, MIN_GOOD_IOU = 3.0, 0.9
"""A result that is better than both is not looked at."""
MIN_BUILT_IN_IOU = 0.85
"""A result of a built-in shape, which is not the object's, is looked at only if it is worse. In 45 grasps of videos its
misfit alone was large for two right results, and for no wrong one."""
N_DIFFERENCE_CELLS = 8
"""Cells of the square about a mask along either side, in which differences are summed: motion moves them by less."""
MIN_DIFFERENCE_CORRELATION = 0.5
"""Correlation of differences in successive frames from which masks agree. In trials on 8 synthetic clips with contours
off by 4 px in each frame anew it was at most 0.43 beside poses found right, and at least 0.85 in the four of 20 frames
with hands that turn wrongly (seen in trials, no command repeats it)."""

UNEVEN_IOU_RATIO = 0.9
"""Frames whose IOU is below this share of the median one are met less than the others."""


def consistent_contour_misfit(it: Evidence) -> float:
    """Return the contours' misfit to masks that agree with each other (``Evidence.misfit``).

    It is NaN where they do not, and for a built-in shape.
    """
    return (
        it.misfit
        if it.misfit > MAX_GOOD_MISFIT
        and not it.shape_assumed
        and difference_correlation(it) > MIN_DIFFERENCE_CORRELATION
        else UNKNOWN_VALUE
    )


def consistent_mean_iou(it: Evidence) -> float:
    """Return the IOU with masks that agree with each other.

    It is NaN where they do not, or where contours are near: then the object is small in the image.
    """
    iou, usual = float(np.nanmean(it.overlaps)), MIN_BUILT_IN_IOU if it.shape_assumed else MIN_GOOD_IOU
    return (
        iou
        if iou < usual and not it.misfit <= MAX_GOOD_MISFIT and difference_correlation(it) > MIN_DIFFERENCE_CORRELATION
        else UNKNOWN_VALUE
    )


def min_iou_ratio(it: Evidence) -> float:
    """Return the least IOU as a share of the median one; single frames do not count."""
    return float(_iou_by_median(it).min(initial=1.0))


def describe_low_iou_frames(it: Evidence) -> str:
    """Name the frames about the least IOU that are met less than the others."""
    by_median = _iou_by_median(it)
    worst, usual = int(by_median.argmin()), np.flatnonzero(by_median >= UNEVEN_IOU_RATIO)
    first = int(usual[usual < worst].max(initial=-1)) + 1
    last = int(usual[usual > worst].min(initial=len(by_median))) - 1
    names = np.array(it.iou_frames or it.clip.frames)[~np.isnan(it.overlaps)]
    some = f"masks from frame {names[first]} to {names[last]}" if first < last else f"masks about frame {names[first]}"
    median = float(np.nanmedian(it.overlaps))
    less = median * float(by_median[first : last + 1].mean())
    least = f"at worst {100.0 * by_median[worst]:.3g} % of the median one, {median:.2f}"
    return f"{some} are met with a mean IOU of {less:.2f}, {least}"


def _iou_by_median(it: Evidence) -> Float[ndarray, "n"]:
    """Return the IOU of each frame with a mask by the median one: the median of three frames in a row."""
    iou = it.overlaps[~np.isnan(it.overlaps)]
    if len(iou) < 3:
        return np.ones(len(iou))
    padded = np.pad(iou, 1, mode="reflect")  # a first or last frame does not count alone, either
    return np.asarray(np.median([padded[:-2], iou, padded[2:]], axis=0) / max(np.median(iou), 1e-9))


def difference_correlation(it: Evidence) -> float:
    """Correlate the differences between mask and silhouette in successive frames, median; 0 where none follow."""
    each = [_mask_difference(it, int(n)) for n in np.flatnonzero(it.mask_area > 0)]
    alike = [_correlate(a, b) for a, b in pairwise(each)]
    return float(np.median(alike)) if alike else 0.0


def _mask_difference(it: Evidence, n: int) -> Float[ndarray, "g g"]:
    """Pixels of the mask alone less those of the silhouette alone, outside ignored ones, in cells about the mask."""
    mask, ignored = it.masks.object[n], it.masks.ignore[n]
    silhouette = render_coverage(it.posed[n], it.clip.mesh.faces, it.clip.K[n], it.clip.size)
    rows, columns = np.nonzero(mask ^ (silhouette & (mask | ~ignored)))
    half = float(np.max(it.boxes[n, 2:] - it.boxes[n, :2]))
    across, down = (
        ((at - middle) / half + 1.0) * N_DIFFERENCE_CELLS / 2.0
        for at, middle in zip((columns, rows), it.centroids[n], strict=True)
    )
    edges = np.arange(N_DIFFERENCE_CELLS + 1.0)
    return np.histogram2d(down, across, (edges, edges), weights=np.where(mask[rows, columns], 1.0, -1.0))[0]


def _correlate(a: Float[ndarray, "g g"], b: Float[ndarray, "g g"]) -> float:
    """Correlate two differences; 0 where one is nothing."""
    size = float(np.linalg.norm(a) * np.linalg.norm(b))
    return float(np.sum(a * b)) / size if size else 0.0
