"""How well poses meet the masks on the full image."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.clip import Clip, Masks
from getagrip.fitting.energy.mask import SilhouetteMesh
from getagrip.kernels.silhouette import silhouettes, unpack


def image_iou(clip: Clip, masks: Masks, T_hand_obj: Float[ndarray, "T 4 4"], scale: float) -> Float[ndarray, "T"]:
    """IOU of rendered and observed object mask on the full image, outside ignored pixels."""
    T_cam_obj = clip.hand.T_cam_hand @ T_hand_obj
    K = np.stack([clip.K[:, 0, 0], clip.K[:, 1, 1], clip.K[:, 0, 2], clip.K[:, 1, 2]], axis=1)
    width, height = clip.size
    bits = np.empty((len(clip), height, -(-width // 64)), np.uint64)
    R, t = np.ascontiguousarray(T_cam_obj[:, :3, :3]), np.ascontiguousarray(T_cam_obj[:, :3, 3])
    silhouettes(R, t, np.full(len(clip), scale), *SilhouetteMesh.of(clip.mesh, np.zeros(3)).tables, K, bits)
    both, either = np.empty(len(clip)), np.empty(len(clip))
    for n, (there, ignored) in enumerate(zip(masks.object, masks.ignore, strict=True)):
        rendered = unpack(bits[n], width) & (there | ~ignored)
        both[n], either[n] = np.count_nonzero(rendered & there), np.count_nonzero(rendered | there)
    return both / np.maximum(either, 1.0)
