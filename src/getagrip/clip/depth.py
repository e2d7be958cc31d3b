"""Depth images of a clip, as samples of the pixels about hand and object: what a fit needs, in little memory."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray

from getagrip.clip.data import Clip, Masks
from getagrip.geometry import se3
from getagrip.geometry.camera import bounding_boxes, project
from getagrip.io.array_data import ArrayData

DEPTH_KEY = "depth"
"""Key of ``Clip.evidence`` and of ``clip.json``, and the folder of the images."""
N_WINDOW_SAMPLES = 64
"""Samples along a side of a frame's window."""
WINDOW_MARGIN = 1.1
"""Side of a window in that of the box around hand and object."""
ASSUMED_DEPTH_ERROR = {"sensor": 0.003, "network": 0.01}
"""Error of a surface's distance that is assumed where a clip does not say [share of the distance]: 2 mm and 8 mm at
arm's length."""
MAX_DEPTH_RATIO = 2.0
"""Metric depth that shows the hand this many times as far away as it is given, or as near, is not used."""


MIN_SURROUNDINGS_DEPTH_RATIO = 0.85
"""Least distance of the pixels around the object [distances of the object]; below it, depth images are disparities."""
MIN_DEPTH_SAMPLES = 20
"""Pixels of the object, and around it, from which on their distances are compared."""


@dataclass(frozen=True)
class DepthSource:
    """The source of a clip's depth images, and their measure: ``depth`` in ``clip.json``.

    Attributes:
        scale: ``metric``: depth is in metres; ``clip``: times a factor that the clip has; ``frame``: that each frame
            has.
        source: ``sensor`` or ``network``.
        unit: what 1 in a file stands for [m, or the file's own measure].
        error: error of a surface's distance, the factor apart [share of the distance].
    """

    scale: Literal["metric", "clip", "frame"]
    source: Literal["sensor", "network"]
    unit: float = 1.0
    error: float = np.nan

    @property
    def assumed_error(self) -> float:
        """The error that is given, else the usual one of a sensor or network."""
        return ASSUMED_DEPTH_ERROR[self.source] if np.isnan(self.error) else self.error


@dataclass(frozen=True, eq=False)
class Depth(ArrayData):
    """Depth at pixels a stride apart, in a window about hand and object, in T frames.

    Attributes:
        z: (T, n, n) depth along the camera's axis, in ``source.scale``'s measure; 0 where it is not known.
        corner: (T, 2) column and row of the first sample in the depth image.
        stride: (T,) pixels of the depth image from one sample to the next.
        size: width and height of the depth images, which show what the clip's images show.
        source: what they are.
    """

    z: Float[ndarray, "T n n"]
    corner: Int[ndarray, "T 2"]
    stride: Int[ndarray, "T"]
    size: tuple[int, int]
    source: DepthSource

    def __len__(self) -> int:
        return len(self.z)

    def take(self, index: Int[ndarray, "n"]) -> Depth:
        """Return the depth of some of the frames, in the given order."""
        return replace(self, z=self.z[index], corner=self.corner[index], stride=self.stride[index])

    def thinned(self, every: int) -> Depth:
        """Return one sample in ``every`` of a row, and of a column."""
        return replace(self, z=self.z[:, ::every, ::every], stride=every * self.stride)

    def image(self, n: int) -> Float[ndarray, "h w"]:
        """Return the depth image of a frame, with the samples alone."""
        out, side = np.zeros(self.size[::-1]), self.z.shape[1]
        columns, rows = self.corner[n][:, None] + self.stride[n] * np.arange(side)
        (left, right), (top, bottom) = (
            np.searchsorted(columns, [0, self.size[0]]),
            np.searchsorted(rows, [0, self.size[1]]),
        )
        out[rows[top:bottom, None], columns[left:right]] = self.z[n, top:bottom, left:right]
        return out

    def intrinsics(self, clip: Clip) -> Float[ndarray, "T 3 3"]:
        """Return the intrinsics of the samples, taken for pixels with their centres at (j + 0.5, i + 0.5)."""
        zoom = np.array(self.size) / np.array(clip.size)
        M = np.zeros((len(self), 3, 3))
        M[:, 0, 0], M[:, 1, 1] = zoom[:, None] / self.stride
        M[:, :2, 2] = 0.5 - (self.corner + 0.5) / self.stride[:, None]
        M[:, 2, 2] = 1.0
        return M @ clip.K

    def of_masks(self, masks: Bool[ndarray, "T H W"], size: tuple[int, int]) -> Bool[ndarray, "T n n"]:
        """Sample masks of a ``size`` (width, height) where depth is sampled; False beyond the image."""
        found = np.zeros(self.z.shape, dtype=bool)
        for n, (corner, stride) in enumerate(zip(self.corner, self.stride, strict=True)):
            at = corner[:, None] + stride * np.arange(self.z.shape[-1])
            columns, rows = np.floor((at + 0.5) * (np.array(size) / np.array(self.size))[:, None]).astype(int)
            (left, right), (top, bottom) = np.searchsorted(columns, [0, size[0]]), np.searchsorted(rows, [0, size[1]])
            found[n, top:bottom, left:right] = masks[n][rows[top:bottom, None], columns[left:right]]
        return found


def surroundings_depth_ratio(
    z: Float[ndarray, "h w"], seen: Bool[ndarray, "h w"], others: Bool[ndarray, "h w"]
) -> float:
    """Return how many times as far away as the object that is ``seen`` what is around it is, in a depth image.

    ``others`` hide the object and do not count. NaN where too little is known of either.
    """
    rows, columns = np.nonzero(seen)
    if not len(rows):
        return np.nan
    ends = [(int(at.min()), int(at.max()) + 1, (int(np.ptp(at)) + 2) // 2) for at in (rows, columns)]
    box = tuple(slice(max(low - more, 0), high + more) for low, high, more in ends)
    near, far = (z[box][mask & (z[box] > 0.0)] for mask in (seen[box], ~seen[box] & ~others[box]))
    return float(np.median(far) / np.median(near)) if min(len(near), len(far)) >= MIN_DEPTH_SAMPLES else np.nan


def median_surroundings_depth_ratio(depth: Depth, masks: Masks, size: tuple[int, int]) -> float:
    """Return the median over frames of ``surroundings_depth_ratio``; ``size`` is the masks' width and height."""
    seen, others = depth.of_masks(masks.object, size), depth.of_masks(masks.ignore, size)
    each = np.array([surroundings_depth_ratio(*one) for one in zip(depth.z, seen, others, strict=True)])
    return float(np.median(each[np.isfinite(each)])) if np.isfinite(each).any() else np.nan


def sampling_windows(clip: Clip, masks: Masks, size: tuple[int, int]) -> tuple[Int[ndarray, "T 2"], Int[ndarray, "T"]]:
    """Return corner and stride of windows of ``N_WINDOW_SAMPLES`` samples about hand and object, in depth images of a ``size``."""
    uv = project(clip.K, se3.transform(clip.hand.T_cam_hand, clip.hand.vertices))
    boxes = bounding_boxes(masks.object)
    seen = (boxes[:, 2] > boxes[:, 0])[:, None]
    low = np.where(seen, np.minimum(uv.min(axis=1), boxes[:, :2]), uv.min(axis=1))
    high = np.where(seen, np.maximum(uv.max(axis=1), boxes[:, 2:]), uv.max(axis=1))
    low, high = np.clip(low, 0, clip.size), np.clip(high, 0, clip.size)
    zoom = np.array(size) / np.array(clip.size)
    stride = np.maximum(np.ceil(WINDOW_MARGIN * ((high - low) * zoom).max(axis=1) / N_WINDOW_SAMPLES), 1.0).astype(int)
    corner = np.floor((low + high) / 2.0 * zoom - stride[:, None] * N_WINDOW_SAMPLES / 2.0).astype(int)
    return corner, stride


def sample_window(image: Float[ndarray, "h w"], corner: Int[ndarray, "2"], stride: int) -> Float[ndarray, "n n"]:
    """Sample a depth image in a window; 0 beyond it."""
    out = np.zeros((N_WINDOW_SAMPLES, N_WINDOW_SAMPLES))
    columns, rows = corner[:, None] + stride * np.arange(N_WINDOW_SAMPLES)
    height, width = image.shape
    (left, right), (top, bottom) = np.searchsorted(columns, [0, width]), np.searchsorted(rows, [0, height])
    out[top:bottom, left:right] = image[rows[top:bottom, None], columns[left:right]]
    return out
