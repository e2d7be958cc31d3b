"""Pinhole cameras and square crops.

Pixel (row i, column j) has its centre at (u, v) = (j + 0.5, i + 0.5).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int, Shaped
from numpy import ndarray

from getagrip.io.images import PackedMask, PackedMasks


def project(
    K: Float[ndarray, "*#batch 3 3"], X_cam: Float[ndarray, "*#batch points 3"]
) -> Float[ndarray, "*batch points 2"]:
    """Project points in the camera frame [m] to pixel coordinates (u, v)."""
    uvw = X_cam @ np.swapaxes(K, -1, -2)
    return uvw[..., :2] / uvw[..., 2:]


def backproject(
    K: Float[ndarray, "*#batch 3 3"], uv: Float[ndarray, "*#batch points 2"]
) -> Float[ndarray, "*batch points 3"]:
    """Return the points at depth 1 on the rays through pixel coordinates; multiply by the depth [m]."""
    uv1 = np.concatenate([uv, np.ones((*uv.shape[:-1], 1))], axis=-1)
    return uv1 @ np.swapaxes(np.linalg.inv(K), -1, -2)


@dataclass(frozen=True)
class Crops:
    """One square window per frame, all of the same side, resampled to ``size`` x ``size`` pixels.

    Attributes:
        corner: (T, 2) top left corners (u, v) in the image [px]; windows may leave the image.
        side: side of the windows in the image [px].
        size: side of the resampled crop [px].
    """

    corner: Float[ndarray, "T 2"]
    side: float
    size: int

    @property
    def zoom(self) -> float:
        """Crop pixels per image pixel."""
        return self.size / self.side

    def intrinsics(self, K: Float[ndarray, "T 3 3"]) -> Float[ndarray, "T 3 3"]:
        """Return the intrinsics of the crops, from those of the images."""
        M = np.zeros((len(self.corner), 3, 3))
        M[:, 0, 0] = M[:, 1, 1] = self.zoom
        M[:, :2, 2] = -self.corner * self.zoom
        M[:, 2, 2] = 1.0
        return M @ K

    def resample(self, images: Shaped[ndarray, "T H W"], outside: int | bool) -> Shaped[ndarray, "T size size"]:
        """Crop label images by nearest neighbours; pixels beyond the image become ``outside``."""
        T, H, W = images.shape
        centres = (np.arange(self.size) + 0.5) / self.zoom
        out = np.full((T, self.size, self.size), outside, dtype=images.dtype)
        for n, image in enumerate(images.frames if isinstance(images, PackedMasks) else images):
            cols = np.floor(self.corner[n, 0] + centres).astype(int)
            rows = np.floor(self.corner[n, 1] + centres).astype(int)
            (left, right), (top, bottom) = np.searchsorted(cols, [0, W]), np.searchsorted(rows, [0, H])
            at = rows[top:bottom], cols[left:right]
            packed = isinstance(image, PackedMask)
            out[n, top:bottom, left:right] = image.grid(*at) if packed else image.take(at[0], 0).take(at[1], 1)
        return out


def bounding_boxes(masks: Shaped[ndarray, "T H W"]) -> Int[ndarray, "T 4"]:
    """Return (u0, v0, u1, v1) [px], end exclusive, of each mask's non-zero pixels; zeros for an empty mask."""
    if isinstance(masks, PackedMasks):
        return masks.boxes.copy()
    boxes = np.zeros((len(masks), 4), dtype=int)
    for n, mask in enumerate(masks):
        rows, cols = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
        if rows.size:
            boxes[n] = cols[0], rows[0], cols[-1] + 1, rows[-1] + 1
    return boxes


def crops_around(masks: Shaped[ndarray, "T H W"], expand: float = 1.8, size: int = 256) -> Crops:
    """Make square crops centred on each frame's mask, which needs a pixel, ``expand`` times the largest mask's size.

    All frames have one side, so that a pixel of energy is worth the same; each has its own centre, so that an object
    moving across the image keeps its resolution.
    """
    return crops_of_boxes(bounding_boxes(masks).astype(float), expand, size)


def crops_of_boxes(boxes: Float[ndarray, "T 4"], expand: float, size: int) -> Crops:
    """Make square crops centred on each frame's box (u0, v0, u1, v1) [px], ``expand`` times the largest box's side."""
    side = expand * float((boxes[:, 2:] - boxes[:, :2]).max())
    centre = (boxes[:, :2] + boxes[:, 2:]) / 2.0
    return Crops(corner=centre - side / 2.0, side=side, size=size)
