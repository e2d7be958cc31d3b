"""From signs to the probability that a result is right: a logistic regression, fitted on training data.

    probability = 1 / (1 + exp(-(bias + sum_i weight_i x_i)))

x_i are signs (``checks.features``), none better than nearly all were in the training data. Only what was calibrated
has a probability: ``CALIBRATIONS`` (``calibrated``), by method and by where the pose is to be right.

Keep only what is right: thresholds on the probability, by conformal risk control, for each kind of input.

Of n results of the calibration that are at least as probable as t, w are wrong. A result of probability p is kept for a
share s where (w + 1) / (n + 1) <= 1 - s at some t <= p: among results like those of the calibration the kept ones are
right with at least that share. Probabilities of the calibration are those of a fit without the result's own object.
Of measured hands the rule holds for exact ones and for those of each level of errors: the largest threshold counts.

A result's set of candidates is the smallest that holds the right one with 90 %, by the same rule among the results that
no smaller set is enough for. Where even the largest is not enough there is none.

The calibrations in ``calibrated.json``: weights of the signs, and thresholds by kind of input.

A measured hand that its evidence turned far was solved with the object as an estimate is: it is *corrected*, and has a
calibration of its own.

``python -m benchmarks.probability`` and ``python -m benchmarks.kept`` write it.
"""

from __future__ import annotations

import json
from collections.abc import Container, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from getagrip.provenance import HandsKind
from getagrip.result.findings import Probability

Where = Literal["hand", "camera"]
"""The frame in which a pose is compared with the true one: that of the hand, or of the camera."""
PROBABILITY_MEANING = (
    "right: the mean distance of vertices (ADD) in the {}, up to symmetries, is below 10 % of the diameter"
)
ROUNDING_TOLERANCE = 1e-4
"""Share of a limit by which its rounding in the file may be off."""


@dataclass(frozen=True)
class FeatureWeight:
    """The weight of a sign."""

    weight: float
    """For one unit of the sign, in the logarithm of the odds."""
    low: float
    high: float
    """The range of the sign in the training data, but for the last hundredth at either end."""

    def clipped(self, value: float) -> float:
        """Clip a value that is better than in training to the range; a worse one keeps counting."""
        return max(value, self.low) if self.weight < 0.0 else min(value, self.high)

    def beyond(self, value: float) -> bool:
        """Return whether a value is worse than the range; never of a sign that does not count."""
        limit = self.high if self.weight < 0.0 else self.low
        return (limit - value) * self.weight > abs(self.weight) * ROUNDING_TOLERANCE * abs(limit)


@dataclass(frozen=True)
class Calibration:
    """The calibration of one method.

    Attributes:
        where: the frame in which poses are right.
        weights: by name of the sign.
        bias: the logarithm of the odds where all signs are 0.
        data: on what it was fitted, in words.
        made: when, by which code and which command.
    """

    where: Where
    weights: Mapping[str, FeatureWeight]
    bias: float
    data: str
    made: str

    def probability(self, signs: Mapping[str, float]) -> Probability:
        """Compute the probability of a result with these signs."""
        clipped = {name: weight.clipped(signs[name]) for name, weight in self.weights.items()}
        logit = self.bias + sum(self.weights[name].weight * value for name, value in clipped.items())
        beyond = tuple(name for name, weight in self.weights.items() if weight.beyond(signs[name]))
        meaning = f"{PROBABILITY_MEANING.format(self.where)}; calibrated on {self.data}; for anything else it is an extrapolation"
        return Probability(float(sigmoid(np.array(logit))), meaning, beyond)


def sigmoid(logit: Float[ndarray, "*n"]) -> Float[ndarray, "*n"]:
    """Return the probabilities of logarithms of odds."""
    return np.asarray(0.5 * (1.0 + np.tanh(0.5 * logit)))


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


CALIBRATION_FILE = Path(__file__).with_name("calibrated.json")
Calibrations = dict[tuple[str, Where], Calibration]
"""By method, and by where poses are right."""
Thresholds = dict[tuple[InputKind, Where], KeepThresholds]
"""By kind of input, and by where poses are right."""


def read_calibrations(file: Path) -> tuple[Calibrations, Calibrations, Calibrations, Thresholds]:
    """Read the calibrations for measured, for corrected and for estimated hands, and the thresholds."""
    stored = json.loads(file.read_text(encoding="utf-8"))
    measured, corrected, estimated = (
        {
            (method, one["where"]): Calibration(
                **one | {"weights": {name: FeatureWeight(*numbers) for name, numbers in one["weights"].items()}}
            )
            for method, each in stored[hands].items()
            for one in each
        }
        for hands in ("measured", "corrected", "estimated")
    )
    thresholds = {
        (one["input"], one["where"]): KeepThresholds(
            {float(share): p for share, p in one["least"].items()}, {int(size): p for size, p in one["sets"].items()}
        )
        for one in stored["keeping"]
    }
    return measured, corrected, estimated, thresholds


CALIBRATIONS, CORRECTED_CALIBRATIONS, ESTIMATED_CALIBRATIONS, KEEP_THRESHOLDS = read_calibrations(CALIBRATION_FILE)
