"""Outlier masks, which contradict those of other frames: another object's, half of one, or one that runs over.

A mask is an outlier if it differs far more from the predicted silhouette than most masks do. The clip is fitted again
without the outliers and all masks are compared again, until the outliers stay the same; poses in their frames are
interpolated.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from getagrip.fitting.image_iou import MaskOverlap
from getagrip.fitting.predicted_silhouette import NeighbourPrediction
from getagrip.fitting.problem import MethodResult, Problem
from getagrip.fitting.solved_hand import interpolate_solved_hand

MAX_OUTLIER_FITS = 4
"""Most fits, the first one with all masks."""
MIN_OUTLIER_FIT_FRAMES = 4
"""With fewer frames, outliers cannot be determined."""
OUTLIER_AREA_FRACTION = 0.3
"""An outlier differs from the predicted silhouette by more than this share of the object's silhouette,"""
OUTLIER_MEDIAN_FACTOR = 4.0
"""and by more than this multiple of the median mask's difference. Chosen on DexYCB's training subjects."""


def fit_without_outliers(problem: Problem, fit: Callable[[Problem], MethodResult]) -> tuple[Problem, MethodResult]:
    """Fit the problem without outlier masks; return the problem in the remaining frames, and its fit.

    Raises what ``fit`` raises.
    """
    everywhere = np.arange(len(problem.clip))
    found, some, used, limit = fit(problem), problem, everywhere, np.inf
    for _ in range(MAX_OUTLIER_FITS - 1):
        if len(used) < MIN_OUTLIER_FIT_FRAMES:
            break
        solved = some.as_found(found)
        predicted = NeighbourPrediction.by(solved, found.poses, used)
        T = interpolate_solved_hand(problem.clip.hand.T_cam_hand, solved.clip.hand.T_cam_hand, used)
        whole = replace(problem, clip=problem.clip.with_hand_at(T)) if found.hand else problem
        met = predicted.overlap(whole.warped(found.warp), everywhere)
        limit = outlier_threshold(met)
        inliers = np.flatnonzero(met.differing <= limit)
        if np.array_equal(inliers, used):
            break
        used = inliers
        some = problem.at(problem.clip.take(used))
        found = fit(some)
    names = tuple(name for n, name in enumerate(problem.clip.frames) if n not in used)
    some = some.as_found(found)
    return replace(some, trust=replace(some.trust, outliers=names, outlier_threshold=limit)), found


def outlier_threshold(met: MaskOverlap) -> float:
    """Return the outlier threshold: the largest difference of a mask from its predicted silhouette [px]."""
    size = float(np.median(met.silhouette))
    return max(OUTLIER_AREA_FRACTION * size, OUTLIER_MEDIAN_FACTOR * float(np.median(met.differing)))
