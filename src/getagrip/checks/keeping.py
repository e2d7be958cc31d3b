"""Keep only what is right: thresholds on the probability, by conformal risk control, for each kind of input.

Of n results of the calibration that are at least as probable as t, w are wrong. A result of probability p is kept for a
share s where (w + 1) / (n + 1) <= 1 - s at some t <= p: among results like those of the calibration the kept ones are
right with at least that share. Probabilities of the calibration are those of a fit without the result's own object.

A result's set of candidates are those of energies up to a factor of the least, the smallest by which at least 90 % of
the results that are probable enough have the right one among them, by the same rule. Less probable ones have no set.
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

InputKind = Literal["measured", "estimated", "joints", "depth"]
"""Kind of a result's input: measured hands; estimated ones without further evidence, with 2D joints, with depth."""
SHARES = (0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 0.98)
"""Shares that results are kept for."""


@dataclass(frozen=True)
class Keeping:
    """Thresholds for one kind of input and one frame.

    Attributes:
        least: for each share of right results, the least probability that is kept; shares that none attains are absent.
        probable: least probability of a result with a set of candidates.
        times: candidates of up to this multiple of the least energy belong to the set.
    """

    least: Mapping[float, float]
    probable: float
    times: float

    def applied(self, right: Probability, energy: Float[ndarray, "K"]) -> Probability:
        """Return a probability with what it is kept for; ``energy`` of the candidates, the best first."""
        keep = max((share for share, least in self.least.items() if right.value >= least), default=0.0)
        within = np.count_nonzero(np.maximum.accumulate(energy) <= self.times * max(energy.min(), 1e-9))
        return replace(right, keep=keep, candidates=int(within) if right.value >= self.probable else 0)


def kind_of_input(hands: HandsKind, evidence: Container[str]) -> InputKind:
    """Return the kind of an input by its hands and the names of the terms that its evidence gave."""
    if hands == "measured":
        return "measured"
    return "depth" if "depth" in evidence else "joints" if "joints-2d" in evidence else "estimated"


def least_kept(probability: Float[ndarray, "n"], right: Bool[ndarray, "n"], share: float) -> float:
    """Compute the least probability from which on results are kept; infinite where none can be."""
    order = np.argsort(-probability, kind="stable")
    wrong, p = np.cumsum(~right[order]), probability[order]
    fits = (wrong + 1.0) / (np.arange(len(p)) + 2.0) <= 1.0 - share
    last = np.append(p[:-1] > p[1:], True)  # a threshold takes all that are alike
    kept = np.flatnonzero(fits & last)
    return float(p[kept[-1]]) if len(kept) else float("inf")


def least_times(times: Float[ndarray, "n"], share: float) -> float:
    """Compute the factor that holds the first right candidates of this share; ``times``: theirs, infinite for none."""
    rank = int(np.ceil(share * (len(times) + 1)))
    return float(np.sort(times)[rank - 1]) if rank <= len(times) else float("inf")
