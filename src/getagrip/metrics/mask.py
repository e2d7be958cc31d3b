"""Intersection over union (IOU) of the predicted and the observed object mask, outside ignored pixels.

The prediction is rendered by the z-buffer of ``geometry.kernels.depth``, not by the silhouettes of the fit, so that a
score cannot share the objective's errors.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from getagrip.clip import Clip, Masks
from getagrip.clip.masks import occluded_by_hand
from getagrip.clip.views import View, clip_in_view, masks_in_view
from getagrip.geometry import se3
from getagrip.geometry.camera import crops_around
from getagrip.geometry.mesh import Mesh
from getagrip.io.images import PackedMask, pack_masks

IOU_CROP_PX = 256
"""Side of the crops [px]: the paper's render_size."""


@dataclass(frozen=True)
class MaskIou:
    """IOU of each frame; NaN where no pixel of the object is observed.

    Attributes:
        crop: (T,) in 256 x 256 crops, 1.8 times the largest mask, around each observed mask, as in the paper.
        soft: (T,) as ``crop``, with pixels counted by their covered fraction, as in the authors' code: sum p r / sum
            min(p + r, 1).
        full: (T,) in the whole image, which includes predictions outside the crop.
    """

    crop: Float[ndarray, "T"]
    soft: Float[ndarray, "T"]
    full: Float[ndarray, "T"]


def _render_mask(mesh: Mesh | None, K: Float[ndarray, "3 3"], size: tuple[int, int]) -> Bool[ndarray, "H W"]:
    """Pixels whose centre is covered by a mesh in the camera frame; none without a mesh."""
    from getagrip.geometry.rasterize import render_coverage

    return np.zeros(size[::-1], dtype=bool) if mesh is None else render_coverage(mesh.vertices, mesh.faces, K, size)


def iou(predicted: Bool[ndarray, "H W"], observed: Bool[ndarray, "H W"], ignore: Bool[ndarray, "H W"]) -> float:
    """Compute the intersection over union outside ignored pixels; NaN where both masks are empty."""
    both = np.count_nonzero(predicted & observed & ~ignore)
    either = np.count_nonzero((predicted | observed) & ~ignore)
    return both / either if either else float("nan")


def soft_iou(fine: Bool[ndarray, "H2 W2"], observed: Bool[ndarray, "H W"], ignore: Bool[ndarray, "H W"]) -> float:
    """Compute the IOU with pixels whose covered fraction p counts quarters: sum p r / sum min(p + r, 1)."""
    parts = fine.view(np.uint8)
    quarters = (parts[::2, ::2] + parts[::2, 1::2] + parts[1::2, ::2] + parts[1::2, 1::2]) * ~ignore
    r = observed & ~ignore
    on_object = int(quarters[r].sum())
    either = 4 * np.count_nonzero(r) + int(quarters.sum()) - on_object
    return on_object / either if either else float("nan")


def iou_of_poses(
    mesh: Mesh, scale: float, T_cam_obj: Float[ndarray, "T 4 4"], K: Float[ndarray, "T 3 3"], masks: Masks
) -> MaskIou:
    """Compute the IOU of a posed object with the observed masks, per frame."""
    posed = [Mesh(se3.transform(T, scale * mesh.vertices), mesh.faces) for T in T_cam_obj]
    return iou_of_meshes(posed, K, masks)


def iou_in_views(
    clip: Clip, views: Sequence[View], mesh: Mesh, scale: float, T_cam_obj: Float[ndarray, "T 4 4"]
) -> dict[str, Float[ndarray, "T"]]:
    """Compute the IOU in the whole images of further views of a clip, by name, for those whose masks show the object.

    ``clip`` has the hand that hides the object where a view has no ignore masks. Raises ``InputError``.
    """
    found = {}
    for view in views:
        seen = clip_in_view(clip, view)
        masks = masks_in_view(seen, view)
        if masks is None or not masks.observed.any():
            continue
        judged = masks if masks.say_what_hides else occluded_by_hand(seen, masks)
        found[view.name] = iou_of_poses(mesh, scale, view.T_view_cam @ T_cam_obj, view.K, judged).full
    return found


def iou_of_meshes(meshes: Sequence[Mesh | None], K: Float[ndarray, "T 3 3"], masks: Masks) -> MaskIou:
    """Compute the IOU of each frame's mesh, in the camera frame, with the observed mask; 0 without a mesh."""
    from getagrip.geometry.rasterize import render_packed

    T, H, W = masks.object.shape
    out = MaskIou(*np.full((3, T), np.nan))
    frames = np.flatnonzero(masks.observed)
    if not frames.size:
        return out
    masks = masks.take(frames).in_bits
    crops = crops_around(masks.object, size=IOU_CROP_PX)
    observed, ignore = crops.resample(masks.object, outside=False), crops.resample(masks.ignore, outside=True)
    whole = zip(pack_masks(masks.object).frames, pack_masks(masks.ignore).frames, strict=True)
    once = crops.intrinsics(K[frames])
    twice = np.array([2.0, 2.0, 1.0])[:, None] * once  # double resolution
    for i, (n, (seen, hidden)) in enumerate(zip(frames, whole, strict=True)):
        mesh = meshes[int(n)]
        drawn = PackedMask.empty((H, W)) if mesh is None else render_packed(mesh.vertices, mesh.faces, K[n], (W, H))
        box = seen.box_with(drawn)
        out.full[n] = iou(drawn.part(box), seen.part(box), hidden.part(box))
        out.crop[n] = iou(_render_mask(mesh, once[i], (IOU_CROP_PX, IOU_CROP_PX)), observed[i], ignore[i])
        out.soft[n] = soft_iou(_render_mask(mesh, twice[i], (2 * IOU_CROP_PX, 2 * IOU_CROP_PX)), observed[i], ignore[i])
    return out
