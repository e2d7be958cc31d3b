"""Plain MANO parameters and plain joints, over all frames in one file, already before the clip's camera.

MANO: ``global_orient`` (T, 3) or (T, 3, 3), ``hand_pose`` (T, P), ``betas`` (10) or (T, 10), ``transl`` (T, 3) [m].
What ``hand_pose`` means is in no such file and has to be said: rotation vectors, principal components or matrices;
relative to the flat hand or to MANO's mean pose. The wrong choice still looks like a hand.

Joints: ``joints`` (T, 21, 3) [m].
"""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.errors import UsageError
from getagrip.geometry import se3
from getagrip.hands.fit import ORDERS, JointOrder
from getagrip.hands.mano import Mano
from getagrip.hands.trackers.estimates import Seen, rotations
from getagrip.hands.trackers.records import Record, numbers

Encoding = Literal["axis-angle", "pca", "matrix"]
Mean = Literal["flat", "mean"]


def parameters(path: Path, record: Record, encoding: Encoding, mean: Mean, model: Mano | None) -> list[Seen]:
    """The hands of a file of MANO parameters. Raises ``InputError``, and ``UsageError`` where MANO's file is needed."""
    t = numbers(path, record, "transl", (-1, 3))
    T = len(t)
    R = rotations(path, "global_orient", numbers(path, record, "global_orient", (T, 3), (T, 3, 3)), 1)
    betas = np.broadcast_to(numbers(path, record, "betas", (T, 10), (10,)), (T, 10))
    if encoding == "matrix":
        matrices = numbers(path, record, "hand_pose", (T, 15, 3, 3))
        values = se3.log_so3(rotations(path, "hand_pose", matrices, 2)).reshape(T, 45)
    elif encoding == "axis-angle":
        values = numbers(path, record, "hand_pose", (T, 45), (T, 15, 3)).reshape(T, 45)
    else:
        counts = range(1, 46)
        values = numbers(path, record, "hand_pose", *((T, count) for count in counts))
    return [Seen(*each) for each in zip(R, _flat(values, encoding, mean, model), betas, t, strict=True)]


def _flat(values: Float[ndarray, "T P"], encoding: Encoding, mean: Mean, model: Mano | None) -> Float[ndarray, "T 45"]:
    """Poses as rotation vectors relative to the flat hand [rad]."""
    if encoding != "pca" and mean == "flat":
        return values
    if model is None:
        what = "principal components" if encoding == "pca" else "the mean pose"
        raise UsageError(f"--mano: got nothing, expected the folder of your MANO files: {what} stand in them")
    return model.pose(values, "pca" if encoding == "pca" else "axis_angle", flat_hand_mean=mean == "flat")


def joints(path: Path, record: Record, order: JointOrder) -> Float[ndarray, "T 21 3"]:
    """The joints of a file in this package's order, before the camera [m]. Raises ``InputError``."""
    return numbers(path, record, "joints", (-1, 21, 3))[:, ORDERS[order]]
