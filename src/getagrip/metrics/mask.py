"""Intersection over union of the predicted and the observed object mask, where pixels say something about the object.

The prediction is drawn by the z-buffer of ``kernels.depth`` and not by the silhouettes that the fit uses, so that a
score cannot share the objective's mistakes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from getagrip import se3
from getagrip.camera import crops_around
from getagrip.clip import Masks
from getagrip.mesh import Mesh

CROP = 256
"""Side of the crops [px]: the paper's render_size."""


@dataclass(frozen=True)
class MaskIou:
    """IOU of each frame; NaN where no pixel of the object is seen."""

    crop: Float[ndarray, "T"]
    """In 256 x 256 crops, 1.8 times the largest mask, around each observed mask: the paper's."""
    soft: Float[ndarray, "T"]
    """The same with partly covered pixels counted in part, as the authors' code does: sum p r / sum min(p + r, 1)."""
    full: Float[ndarray, "T"]
    """On the whole image, so that a prediction outside the crop is punished."""


def object_mask(
    mesh: Mesh, scale: float, T_cam_obj: Float[ndarray, "4 4"], K: Float[ndarray, "3 3"], size: tuple[int, int]
) -> Bool[ndarray, "H W"]:
    """Pixels whose centre the posed object covers; ``size`` is (width, height)."""
    from getagrip.kernels.depth import depth_and_face

    return depth_and_face(se3.transform(T_cam_obj, scale * mesh.vertices), mesh.faces, K, size)[1] >= 0


def iou(
    predicted: Bool[ndarray, "*batch H W"], observed: Bool[ndarray, "*batch H W"], ignore: Bool[ndarray, "*batch H W"]
) -> Float[ndarray, "*batch"]:
    """Intersection over union outside ignored pixels; NaN where both masks are empty there."""
    both = np.sum(predicted & observed & ~ignore, axis=(-1, -2))
    either = np.sum((predicted | observed) & ~ignore, axis=(-1, -2))
    return np.where(either > 0, both / np.maximum(either, 1), np.nan)


def mask_iou(
    mesh: Mesh, scale: float, T_cam_obj: Float[ndarray, "T 4 4"], K: Float[ndarray, "T 3 3"], masks: Masks
) -> MaskIou:
    """IOU of a posed object with the observed masks, frame by frame."""
    T, H, W = masks.object.shape
    out = MaskIou(*np.full((3, T), np.nan))
    seen = np.flatnonzero((masks.object & ~masks.ignore).any(axis=(1, 2)))
    if not seen.size:
        return out
    crops = crops_around(masks.object[seen], size=CROP)
    observed = crops.resample(masks.object[seen], outside=False)
    ignore = crops.resample(masks.ignore[seen], outside=True)
    double = np.array([2.0, 2.0, 1.0])[:, None] * crops.intrinsics(K[seen])  # twice as many pixels each way
    for i, n in enumerate(seen):
        full = object_mask(mesh, scale, T_cam_obj[n], K[n], (W, H))
        out.full[n] = iou(full, masks.object[n], masks.ignore[n])
        crop = object_mask(mesh, scale, T_cam_obj[n], crops.intrinsics(K[seen])[i], (CROP, CROP))
        out.crop[n] = iou(crop, observed[i], ignore[i])
        fine = object_mask(mesh, scale, T_cam_obj[n], double[i], (2 * CROP, 2 * CROP))
        p = fine.reshape(CROP, 2, CROP, 2).mean(axis=(1, 3)) * ~ignore[i]
        r = observed[i] & ~ignore[i]
        out.soft[n] = np.sum(p * r) / np.sum(np.minimum(p + r, 1.0))
    return out
