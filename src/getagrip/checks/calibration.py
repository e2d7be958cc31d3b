"""Calibration of the probability that a result is right, and of the threshold above which results are kept.

The probability is a logistic regression on features (``checks.features``), fitted on training data:

    probability = 1 / (1 + exp(-(bias + sum_i weight_i x_i)))

Each feature x_i is clipped at the best end of its range in the training data. Only calibrated methods have a
probability, relative to the hand, to the camera, or of drafts in the image (``CALIBRATIONS``). A measured hand that
its evidence turned far was solved jointly with the object, as an estimated hand is: it is *corrected*, and has a
calibration of its own. So have hands that were *lifted* from 2D joints, whose results are drafts.

Results are kept by conformal risk control, for each kind of input. Among the n calibration results at least as probable
as t, w are wrong. A result of probability p is kept for a share s where (w + 1) / (n + 1) <= 1 - s at some t <= p:
among similar results at least this share of the kept ones is right. The probability of a calibration result comes from
a fit without results of the same object. For measured hands, the largest threshold counts: the rule holds for exact
hands and at each level of errors.

The candidate set of a result is the smallest that contains the right candidate with 90 %, by the same rule among the
results for which no smaller set suffices. Where the largest size is insufficient there is no set.

``calibrated.json`` holds the weights of the features, and the thresholds by kind of input. It is written by
``python -m benchmarks.probability``, ``python -m benchmarks.kept`` and ``python -m benchmarks.pixel_probability``.
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

Where = Literal["hand", "camera", "image"]
"""Frame in which a pose is compared with the true one; in the image its distance and size do not count."""
POSE_FRAMES: tuple[Where, ...] = "hand", "camera"
"""Frames with a calibration of measured and of estimated hands."""
MAX_ROTATION_DEG, MAX_SHARE_ACROSS = 20.0, 0.1
"""Errors below which a pose is right in the image: rotation; shift across the ray [diameters]."""
_ADD_MEANING = "right: the mean distance of vertices (ADD) in the {}, up to symmetries, is below 10 % of the diameter"
PROBABILITY_MEANINGS: Mapping[Where, str] = {
    "hand": _ADD_MEANING.format("hand"),
    "camera": _ADD_MEANING.format("camera"),
    "image": f"right: up to symmetries and median over frames, the rotation is within {MAX_ROTATION_DEG:g} degrees and "
    f"the centre across the ray within {100.0 * MAX_SHARE_ACROSS:g} % of the diameter; its distance does not count",
}
ROUNDING_TOLERANCE = 1e-4
"""Relative error by which limits are rounded in the file."""
InputKind = Literal[
    "measured", "corrected", "estimated", "joints", "network", "sensor", "lifted", "lifted-sensor", "lifted-shape"
]
"""Kind of a result's input: measured hands that the fit hardly changed; corrected measured hands; estimated hands
without further evidence, with 2D joints, with depth from a network, with depth from a sensor; hands that were lifted
from 2D joints, whose size is assumed, without and with depth from a sensor, and beside a built-in shape."""
LIFTED_KINDS: tuple[InputKind, ...] = "lifted", "lifted-sensor", "lifted-shape"
"""Kinds of hands that were lifted from 2D joints, as in drafts; their calibration is one of its own."""
KEEP_SHARES = (0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 0.98)
"""Shares of right results for which results are kept."""
CANDIDATE_SET_SIZES = (1, 2, 3, 5, 7)
"""Sizes of candidate sets."""
CALIBRATION_FILE = Path(__file__).with_name("calibrated.json")


@dataclass(frozen=True)
class FeatureWeight:
    """The weight of a feature, and its range in the training data.

    Attributes:
        weight: change of the logarithm of the odds by one unit of the feature.
        low: first percentile of the feature.
        high: 99th percentile of the feature.
    """

    weight: float
    low: float
    high: float

    def clipped(self, value: float) -> float:
        """Clip a value at the better end of the range; the worse end is open."""
        return max(value, self.low) if self.weight < 0.0 else min(value, self.high)

    def beyond(self, value: float) -> bool:
        """Return whether a value is worse than the range; never for a feature of weight 0."""
        limit = self.high if self.weight < 0.0 else self.low
        return (limit - value) * self.weight > abs(self.weight) * ROUNDING_TOLERANCE * abs(limit)


@dataclass(frozen=True)
class Calibration:
    """The calibration of one method.

    Attributes:
        where: frame in which poses are right.
        weights: weights by name of the feature.
        bias: logarithm of the odds where all features are 0.
        data: training data, in words.
        made: date, code and command of the fit.
    """

    where: Where
    weights: Mapping[str, FeatureWeight]
    bias: float
    data: str
    made: str

    def probability(self, signs: Mapping[str, float]) -> Probability:
        """Compute the probability of a result from its features."""
        clipped = {name: weight.clipped(signs[name]) for name, weight in self.weights.items()}
        logit = self.bias + sum(self.weights[name].weight * value for name, value in clipped.items())
        beyond = tuple(name for name, weight in self.weights.items() if weight.beyond(signs[name]))
        meaning = PROBABILITY_MEANINGS[self.where]
        meaning += f"; calibrated on {self.data}; for anything else it is an extrapolation"
        return Probability(float(sigmoid(np.array(logit))), meaning, beyond)


def sigmoid(logit: Float[ndarray, "*n"]) -> Float[ndarray, "*n"]:
    """Compute probabilities from logarithms of odds."""
    return np.asarray(0.5 * (1.0 + np.tanh(0.5 * logit)))


@dataclass(frozen=True)
class KeepThresholds:
    """Thresholds for one kind of input and one frame of comparison.

    Attributes:
        least: minimum probability that is kept, by share of right results; unattainable shares are absent.
        sets: minimum probability for a candidate set, by its size in ascending order; unattainable sizes are absent.
    """

    least: Mapping[float, float]
    sets: Mapping[int, float]

    def applied(self, right: Probability) -> Probability:
        """Return a probability with the share for which it is kept, and the size of its candidate set; 0 for none."""
        keep = max((share for share, least in self.least.items() if right.value >= least), default=0.0)
        size = next((size for size, least in self.sets.items() if right.value >= least), 0)
        return replace(right, keep=keep, candidates=size)


def kind_of_input(
    hands: HandsKind,
    evidence: Container[str],
    depth_images: float,
    corrected: bool = False,
    lifted: bool = False,
    shape_assumed: bool = False,
) -> InputKind:
    """Return the kind of an input by its hands, the terms of its evidence, and the feature ``depth-images``.

    ``corrected``: whether a measured hand was corrected (``features.was_corrected``). ``lifted``: whether an estimated
    hand has an assumed size and 2D joints. ``shape_assumed``: whether the mesh is a built-in shape.
    """
    if hands == "measured":
        return "corrected" if corrected else "measured"
    if lifted and shape_assumed:
        return "lifted-shape"
    if lifted:
        return "lifted-sensor" if "depth" in evidence and depth_images > 1.0 else "lifted"
    if "depth" in evidence:
        return "sensor" if depth_images > 1.0 else "network"
    return "joints" if "joints-2d" in evidence else "estimated"


def keep_threshold(probability: Float[ndarray, "n"], right: Bool[ndarray, "n"], share: float) -> float:
    """Compute the minimum probability of kept results, at a share of right ones; infinite where it is unattainable."""
    order = np.argsort(-probability, kind="stable")
    wrong, p = np.cumsum(~right[order]), probability[order]
    fits = (wrong + 1.0) / (np.arange(len(p)) + 2.0) <= 1.0 - share
    last = np.append(p[:-1] > p[1:], True)  # a threshold keeps all equal probabilities
    kept = np.flatnonzero(fits & last)
    return float(p[kept[-1]]) if len(kept) else float("inf")


def candidate_set_thresholds(
    probability: Float[ndarray, "n"], rank: Float[ndarray, "n"], share: float
) -> dict[int, float]:
    """Compute the minimum probability for each size of candidate set; unneeded and unattainable sizes are absent.

    ``rank`` is that of the first right candidate, from 1; infinite where none is right.
    """
    out, rest = dict[int, float](), np.ones(len(rank), dtype=bool)
    for size in CANDIDATE_SET_SIZES:
        least = keep_threshold(probability[rest], rank[rest] <= size, share)
        if np.isfinite(least):
            out[size] = least
            rest &= probability < least
    return out


Calibrations = dict[tuple[str, Where], Calibration]
"""By method and frame of comparison."""
Thresholds = dict[tuple[InputKind, Where], KeepThresholds]
"""By kind of input and frame of comparison."""


def read_calibrations(file: Path) -> tuple[Calibrations, Calibrations, Calibrations, Calibrations, Thresholds]:
    """Read the calibrations for measured, corrected, estimated and lifted hands, and the thresholds."""
    stored = json.loads(file.read_text(encoding="utf-8"))
    measured, corrected, estimated, lifted = (
        {
            (method, one["where"]): Calibration(
                **one | {"weights": {name: FeatureWeight(*numbers) for name, numbers in one["weights"].items()}}
            )
            for method, each in stored[hands].items()
            for one in each
        }
        for hands in ("measured", "corrected", "estimated", "lifted")
    )
    thresholds = {
        (one["input"], one["where"]): KeepThresholds(
            {float(share): p for share, p in one["least"].items()}, {int(size): p for size, p in one["sets"].items()}
        )
        for one in stored["keeping"]
    }
    return measured, corrected, estimated, lifted, thresholds


CALIBRATIONS, CORRECTED_CALIBRATIONS, ESTIMATED_CALIBRATIONS, LIFTED_CALIBRATIONS, KEEP_THRESHOLDS = read_calibrations(
    CALIBRATION_FILE
)
