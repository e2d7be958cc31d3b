"""Masks that contradict those of other frames: another object's, half of one, or one that runs over.

A mask is doubted that differs by far from the silhouette that the other frames foretell, while most do not. The clip is
fitted again without the doubted masks and all are looked at again, until the same ones are doubted; poses in their
frames are interpolated.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from getagrip.fitting.image_iou import Overlap
from getagrip.fitting.predicted_silhouette import NeighbourPrediction
from getagrip.fitting.problem import MethodResult, Problem

FITS = 4
"""Most fits, the first one with all masks."""
FEWEST = 4
"""With fewer frames, nobody can tell which masks contradict the others."""
SHARE = 0.3
"""A doubted mask differs from the silhouette that is foretold by more than this share of the object's silhouette,"""
TIMES = 4.0
"""and by more than so many times as much as the median mask. Chosen on DexYCB's training subjects."""


def fit_without_outliers(problem: Problem, fit: Callable[[Problem], MethodResult]) -> tuple[Problem, MethodResult]:
    """What ``fit`` finds in the frames whose masks are believed, and the problem in these frames.

    Raises what ``fit`` raises.
    """
    everywhere = np.arange(len(problem.clip))
    found, some, used, limit = fit(problem), problem, everywhere, np.inf
    for _ in range(FITS - 1):
        if len(used) < FEWEST:
            break
        predicted = NeighbourPrediction.by(some.warped(found.warp), found.poses, used)
        met = predicted.overlap(problem.warped(found.warp), everywhere)
        limit = outlier_threshold(met)
        believed = np.flatnonzero(met.differing <= limit)
        if np.array_equal(believed, used):
            break
        used = believed
        some = problem.at(problem.clip.take(used), problem.input_masks.take(used))
        found = fit(some)
    names = tuple(name for n, name in enumerate(problem.clip.frames) if n not in used)
    some = some.warped(found.warp)
    return replace(some, trust=replace(some.trust, outliers=names, outlier_threshold=limit)), found


def outlier_threshold(met: Overlap) -> float:
    """Pixels by which a mask may differ from the silhouette that is foretold before it is doubted."""
    size = float(np.median(met.silhouette))
    return max(SHARE * size, TIMES * float(np.median(met.differing)))
