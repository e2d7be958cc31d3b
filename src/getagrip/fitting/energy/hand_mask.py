"""E_mask of the hand: pixels in which its silhouette differs from its mask."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.fitting.energy.hand_term import HandInCamera
from getagrip.fitting.energy.term import Quadratic
from getagrip.fitting.hand_silhouette import HandSilhouette


@dataclass(frozen=True)
class HandMaskTerm:
    """Differing pixels of each frame by the hand's rigid motion and size; fingers are those given.

    Attributes:
        seen: the hand and its mask, with the mask's field.
        weight: (N,) energy per pixel of the hand's crop.
    """

    seen: HandSilhouette
    weight: Float[ndarray, "N"]
    name: str = "hand-mask"

    def __call__(self, poses: HandInCamera, bound: Float[ndarray, "B"]) -> Quadratic:
        found = Quadratic.zero(poses, poses.size)
        about = self.seen.errors.tracked.vertices - poses.middle
        for b, (R, centre, scale) in enumerate(zip(poses.R, poses.centre, poses.scale, strict=True)):
            arm = scale * about @ np.swapaxes(R, -1, -2)
            contour = self.seen.contour(arm + centre[:, None])
            arm = np.take_along_axis(arm, contour.nearest[..., None], axis=1)
            grown = np.sum(arm * contour.along, axis=-1, keepdims=True)
            value, g, H = contour.quadratic(
                np.concatenate([contour.along, np.cross(arm, contour.along), grown], axis=-1)
            )
            found.value[b] = self.weight * value
            found.g[b, :, :7], found.H[b, :, :7, :7] = self.weight[:, None] * g, self.weight[:, None, None] * H
        return found
