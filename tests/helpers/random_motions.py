"""Random rigid motions and hypotheses of timelines."""

from __future__ import annotations

import numpy as np

from getagrip.geometry import se3
from getagrip.timelines.observations import Hypotheses

K, N = 3, 5


def random_motions(rng: np.random.Generator, count: int = N) -> np.ndarray:
    return se3.rigid(se3.exp_so3(rng.normal(size=(count, 3))), rng.normal(0.0, 0.3, (count, 3)))


def random_hypotheses(rng: np.random.Generator, frames: int = N) -> Hypotheses:
    R, centre = se3.exp_so3(rng.normal(size=(K, frames, 3))), rng.normal(0.0, 0.2, (K, frames, 3))
    return Hypotheses(R, centre, rng.uniform(0.8, 1.2, K), np.sort(rng.uniform(size=K)))
