"""From signs to the probability that a result is right: a logistic regression, fitted on training data.

    probability = 1 / (1 + exp(-(bias + sum_i weight_i x_i)))

x_i are signs (``checks.signs``), none better than nearly all were in the training data. Only what was calibrated
has a probability: ``CALIBRATIONS`` (``calibrated``), by method and by where the pose is to be right.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.probability import Probability

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
