"""Which poses of a hand are likely: fingers bend about one axis and hardly twist or spread.

Each joint's rotation vector is read in the joint's own axes, (twist along the bone, bend about the hinge, spread across
both), where it is Gaussian; bends have limits beside, a little beyond the normal ranges of motion (American Academy of
Orthopaedic Surgeons: 0-90, 0-100 and 0-90 degrees from knuckle to fingertip; thumb 0-50 and 0-80).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.clip import FINGERS
from getagrip.hands.generic_skeleton import THUMB_PAD_DIRECTION
from getagrip.hands.model import KNUCKLES, HandModel, mirrored

FINGER_BEND, THUMB_BEND = 0.3, 0.1
"""Most likely bend of each joint [rad]."""
FINGER_SIGMA_RAD = np.array([[0.10, 0.8, 0.25], [0.05, 0.8, 0.05], [0.05, 0.6, 0.05]])
"""Standard deviations of twist, bend and spread, from knuckle to fingertip [rad]."""
THUMB_SIGMA_RAD = np.array([[0.30, 0.5, 0.50], [0.15, 0.6, 0.20], [0.05, 0.6, 0.05]])
FINGER_LIMITS = np.radians([[-30.0, 100.0], [-10.0, 115.0], [-15.0, 90.0]])
"""Smallest and largest bend [rad]."""
THUMB_LIMITS = np.radians([[-40.0, 60.0], [-30.0, 70.0], [-25.0, 95.0]])
LIMIT_SIGMA_RAD = 0.05
"""A bend so far beyond its limit costs one unit [rad]."""


class PosePrior(NamedTuple):
    """Gaussians and limits for the joints of the five ``FINGERS``.

    Attributes:
        axes: (5, 3, 3, 3) rows: along the bone, the hinge, across both.
        mean: (5, 3, 3) most likely rotation vectors, in the hand frame's axes [rad].
        spread: (5, 3, 3) standard deviations of twist, bend and spread [rad].
        limits: (5, 3, 2) smallest and largest bend [rad].
    """

    axes: Float[ndarray, "5 3 3 3"]
    mean: Float[ndarray, "5 3 3"]
    spread: Float[ndarray, "5 3 3"]
    limits: Float[ndarray, "5 3 2"]

    @staticmethod
    def of(model: HandModel) -> PosePrior:
        """Make the prior of a model, its axes from the rest pose."""
        each = np.array(KNUCKLES)[:, None] + np.arange(3)
        points = np.concatenate([model.joints[each], model.template[model.tips][:, None]], axis=1)
        bone = np.diff(points, axis=1)
        bone /= np.linalg.norm(bone, axis=-1, keepdims=True)
        pad = np.array([[0.0, -1.0, 0.0]] * 5)
        pad[FINGERS.index("thumb")] = THUMB_PAD_DIRECTION if model.side == "right" else mirrored(THUMB_PAD_DIRECTION)
        hinge = np.cross(bone, pad[:, None])
        hinge /= np.linalg.norm(hinge, axis=-1, keepdims=True)
        axes = np.stack([bone, hinge, np.cross(bone, hinge)], axis=2)
        bend = np.array([[THUMB_BEND] * 3] + [[FINGER_BEND] * 3] * 4)
        return PosePrior(
            axes=axes,
            mean=bend[..., None] * hinge,
            spread=np.stack([THUMB_SIGMA_RAD] + [FINGER_SIGMA_RAD] * 4),
            limits=np.stack([THUMB_LIMITS] + [FINGER_LIMITS] * 4),
        )

    def residuals(self, q: Float[ndarray, "T 5 3 3"]) -> tuple[Float[ndarray, "T 60"], Float[ndarray, "T 60 45"]]:
        """Compute residuals of poses and their Jacobian: 45 of the Gaussian, 15 of the limits."""
        T = len(q)
        own = np.einsum("fkab,tfkb->tfka", self.axes, q - self.mean) / self.spread
        bend = np.einsum("fkb,tfkb->tfk", self.axes[:, :, 1], q)
        low, high = self.limits[..., 0], self.limits[..., 1]
        beyond = (np.minimum(bend - low, 0.0) + np.maximum(bend - high, 0.0)) / LIMIT_SIGMA_RAD
        J = np.zeros((T, 60, 45))
        scaled = self.axes / self.spread[..., None]
        for joint in range(15):
            f, k = divmod(joint, 3)
            at = slice(3 * joint, 3 * joint + 3)
            J[:, at, at] = scaled[f, k]
            J[:, 45 + joint, at] = (beyond[:, f, k] != 0.0)[:, None] * self.axes[f, k, 1] / LIMIT_SIGMA_RAD
        return np.concatenate([own.reshape(T, 45), beyond.reshape(T, 15)], axis=1), J
