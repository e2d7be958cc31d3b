"""Which frames of a clip are used."""

from __future__ import annotations

import numpy as np
from jaxtyping import Int
from numpy import ndarray


def frame_indices(frames: int, wanted: int) -> Int[ndarray, "n"]:
    """Return the indices of ``wanted`` frames, linearly spread, the ends included; all of them if there are fewer."""
    return np.unique(np.round(np.linspace(0, frames - 1, min(wanted, frames))).astype(int))
