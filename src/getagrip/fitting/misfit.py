"""Misfit: how much worse the masks are explained than by the object's own mesh; it stiffens the motion.

With a mesh of the category instead of the object's own, contours remain that no pose explains, and deviations bend the
motion to fit them. So deviations cost more the worse the masks are explained, unless the shape is fitted (``shape``).
"""

from __future__ import annotations

import numpy as np

from getagrip.fitting.observation import Observation

IMAGE_CONTOUR_ERROR_PX, CROP_CONTOUR_ERROR_PX = 0.4, 0.15
"""Mean distance between the contour of the object's own mesh and that of a mask: pixels of the image, plus pixels of
the crop. Right grasps of DexYCB's training subjects have 0.4 to 0.75 times as much (docs/method.md).
"""
STIFFNESS_EXPONENT = 3.0
"""Stiffness grows with this power of the misfit; 4 held measured motions too stiffly."""


def relative_contour_error(observation: Observation, mask: float) -> float:
    """Compute the mean distance of contours from those of the masks, relative to that of the object's own mesh.

    ``mask`` is the mean E_mask of a frame [px^2 of the crop], that distance times the visible length.
    """
    length = float(observation.targets[..., 4].sum(axis=1).mean())
    expected = IMAGE_CONTOUR_ERROR_PX * observation.crops.zoom + CROP_CONTOUR_ERROR_PX
    return mask / (length * expected) if length > 0.0 else 1.0


def stiffen_ridge(ridge: tuple[float, float], times: float) -> tuple[float, float]:
    """Return the stiffness of deviations at a misfit of ``times``: unchanged up to one."""
    factor = float(np.maximum(times, 1.0) ** STIFFNESS_EXPONENT)
    return ridge[0] * factor, ridge[1] * factor
