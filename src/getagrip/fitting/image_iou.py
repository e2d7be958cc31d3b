"""How well poses meet the masks on the full image."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.clip import Clip, Masks
from getagrip.fitting.energy.mask import SilhouetteMesh
from getagrip.kernels.silhouette import silhouettes, unpack

RENDER_BATCH_FRAMES = 64
"""Frames that are rendered at once: those of a long clip would fill the memory."""


class MaskOverlap(NamedTuple):
    """Rendered and observed object mask of each frame, on the full image [px].

    Attributes:
        both: (T,) pixels of both, outside ignored ones.
        either: (T,) pixels of either, likewise.
        silhouette: (T,) pixels of the rendered one, hidden or not.
    """

    both: Float[ndarray, "T"]
    either: Float[ndarray, "T"]
    silhouette: Float[ndarray, "T"]

    @property
    def iou(self) -> Float[ndarray, "T"]:
        """Their IOU; 0 where there is no pixel of either."""
        return self.both / np.maximum(self.either, 1.0)

    @property
    def differing(self) -> Float[ndarray, "T"]:
        """Pixels of one of the two."""
        return self.either - self.both


def mask_overlap(clip: Clip, masks: Masks, T_hand_obj: Float[ndarray, "T 4 4"], scale: float) -> MaskOverlap:
    """Compute the overlap of the posed object with the masks."""
    T_cam_obj = clip.hand.T_cam_hand @ T_hand_obj
    K = np.stack([clip.K[:, 0, 0], clip.K[:, 1, 1], clip.K[:, 0, 2], clip.K[:, 1, 2]], axis=1)
    width, height = clip.size
    R, t = np.ascontiguousarray(T_cam_obj[:, :3, :3]), np.ascontiguousarray(T_cam_obj[:, :3, 3])
    tables = SilhouetteMesh.of(clip.mesh, np.zeros(3)).tables
    both, either, silhouette = np.empty(len(clip)), np.empty(len(clip)), np.empty(len(clip))
    bits = np.empty((min(len(clip), RENDER_BATCH_FRAMES), height, -(-width // 64)), np.uint64)
    for first in range(0, len(clip), RENDER_BATCH_FRAMES):
        some = slice(first, first + RENDER_BATCH_FRAMES)
        drawn = bits[: len(R[some])]
        silhouettes(R[some], t[some], np.full(len(drawn), scale), *tables, K[some], drawn)
        for n, (there, ignored) in enumerate(zip(masks.object[some], masks.ignore[some], strict=True), start=first):
            rendered = unpack(drawn[n - first], width)
            silhouette[n] = np.count_nonzero(rendered)
            rendered &= there | ~ignored
            both[n], either[n] = np.count_nonzero(rendered & there), np.count_nonzero(rendered | there)
    return MaskOverlap(both, either, silhouette)


def image_iou(clip: Clip, masks: Masks, T_hand_obj: Float[ndarray, "T 4 4"], scale: float) -> Float[ndarray, "T"]:
    """Compute the IOU of rendered and observed object mask on the full image, outside ignored pixels."""
    return mask_overlap(clip, masks, T_hand_obj, scale).iou
