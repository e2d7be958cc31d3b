"""Keep only what is right: thresholds on the probability, by conformal risk control, for each kind of input.

Of n results of the calibration that are at least as probable as t, w are wrong. A result of probability p is kept for a
share s where (w + 1) / (n + 1) <= 1 - s at some t <= p: among results like those of the calibration the kept ones are
right with at least that share. Probabilities of the calibration are those of a fit without the result's own object.
Of measured hands the rule holds for exact ones and for those of each level of errors: the largest threshold counts.

A result's set of candidates is the smallest that holds the right one with 90 %, by the same rule among the results that
no smaller set is enough for. Where even the largest is not enough there is none.
"""

from __future__ import annotations

from collections.abc import Container, Mapping
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from getagrip.probability import Probability
from getagrip.provenance import HandsKind

InputKind = Literal["measured", "corrected", "estimated", "joints", "network", "sensor"]
"""Kind of a result's input: measured hands, as they came or nearly so; measured ones that were solved with the object,
since their evidence turned them far; estimated ones without further evidence, with 2D joints, with a network's depth,
with a sensor's."""
KEEP_SHARES = (0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 0.98)
"""Shares that results are kept for."""
CANDIDATE_SET_SIZES = (1, 2, 3, 5, 7)
"""Sizes of sets of candidates."""


@dataclass(frozen=True)
class KeepThresholds:
    """Thresholds for one kind of input and one frame.

    Attributes:
        least: for each share of right results, the least probability that is kept; shares that none attains are absent.
        sets: for each size of a set, the smallest first, the least probability at which it is enough; likewise.
    """

    least: Mapping[float, float]
    sets: Mapping[int, float]

    def applied(self, right: Probability) -> Probability:
        """Return a probability with what it is kept for, and the size of its set; 0 for none."""
        keep = max((share for share, least in self.least.items() if right.value >= least), default=0.0)
        size = next((size for size, least in self.sets.items() if right.value >= least), 0)
        return replace(right, keep=keep, candidates=size)


def kind_of_input(
    hands: HandsKind, evidence: Container[str], depth_images: float, corrected: bool = False
) -> InputKind:
    """Return the kind of an input by its hands, the terms that its evidence gave, and the sign ``depth-images``.

    ``corrected``: whether a measured hand was (``signs.was_corrected``).
    """
    if hands == "measured":
        return "corrected" if corrected else "measured"
    if "depth" in evidence:
        return "sensor" if depth_images > 1.0 else "network"
    return "joints" if "joints-2d" in evidence else "estimated"


def keep_threshold(probability: Float[ndarray, "n"], right: Bool[ndarray, "n"], share: float) -> float:
    """Compute the least probability from which on results are kept; infinite where none can be."""
    order = np.argsort(-probability, kind="stable")
    wrong, p = np.cumsum(~right[order]), probability[order]
    fits = (wrong + 1.0) / (np.arange(len(p)) + 2.0) <= 1.0 - share
    last = np.append(p[:-1] > p[1:], True)  # a threshold takes all that are alike
    kept = np.flatnonzero(fits & last)
    return float(p[kept[-1]]) if len(kept) else float("inf")


def candidate_set_thresholds(
    probability: Float[ndarray, "n"], rank: Float[ndarray, "n"], share: float
) -> dict[int, float]:
    """Compute the least probability for each size of a set; sizes that nothing needs or that never do are absent.

    ``rank``: of the first right candidate, from 1; infinite where none is right.
    """
    out, rest = dict[int, float](), np.ones(len(rank), dtype=bool)
    for size in CANDIDATE_SET_SIZES:
        least = keep_threshold(probability[rest], rank[rest] <= size, share)
        if np.isfinite(least):
            out[size] = least
            rest &= probability < least
    return out
