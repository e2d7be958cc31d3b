"""A metric: the angle between the object's z axis and the true one, both in the hand."""

import numpy as np

from getagrip.metrics.evaluate.comparison import Comparison
from getagrip.metrics.evaluate.metric import Metric


def axis_error(it: Comparison) -> np.ndarray:
    """In each frame [deg]."""
    found, true = (track.T_ref_obj[:, :3, 2] for track in (it.predicted, it.true))
    return np.degrees(np.arccos(np.clip(np.sum(found * true, axis=1), -1.0, 1.0)))


TILT = Metric(
    "tilt_deg",
    lambda it, contact: axis_error(it),
    "deg",
    "tilt",
    label="tilt, °",
    needs_truth=True,
    meaning="tilt: error of the object's z axis",
)
