"""The object's motion in the image beyond that of the camera.

Masks of two frames are compared outside hidden pixels. The number of differing pixels over the length of the visible
contour is the contour's mean displacement. Where the camera moves, the earlier mask is first warped to the later camera
as a plane that faces the camera. Several depths of this plane are tried, and the least displacement counts: an object
is static if the camera's motion explains its mask's motion at any depth.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray

from getagrip.clip import Clip, Masks
from getagrip.geometry import se3
from getagrip.geometry.camera import bounding_boxes

RELATIVE_DEPTHS = (0.5, 0.7, 0.85, 1.0, 1.2, 1.5, 2.0)
"""Depths of the plane, as multiples of the hand's depth."""
MIN_VISIBLE_CONTOUR_PX = 12.0
"""Length of the visible contour below which a pair of frames is not compared [px]."""
Window = tuple[int, int, int, int]
"""Left, top, right and bottom [px], the last two exclusive."""
CAMERA_MOTION_TOLERANCE = 1e-4
"""Change of the camera's pose below which it is static [m; rad]."""


@dataclass(frozen=True)
class ImageMotion:
    """Displacements of the contour between close frames.

    Attributes:
        moved: (L, T) mean displacement from frame t - l - 1 to frame t [px]; NaN where it is unknown.
        by_camera: (L, T) displacement of the object's centre by the camera's motion [px]; the plane explains its effect
            on the outline only in part.
    """

    moved: Float[ndarray, "L T"]
    by_camera: Float[ndarray, "L T"]

    @property
    def jitter(self) -> float:
        """Distance between the contours of two masks without any motion [px]; 0 where it is unknown.

        Motion grows with the time between two frames, jitter does not: ``m_1^2 = j^2 + v^2`` and
        ``m_L^2 = j^2 + (L v)^2`` in the median frame.
        """
        L = self.lags
        if L < 2 or np.isnan(self.moved[L - 1]).all():
            return 0.0
        square = (L**2 * self.moved[0] ** 2 - self.moved[L - 1] ** 2) / (L**2 - 1.0)
        return float(np.sqrt(max(np.nanmedian(square), 0.0)))

    @property
    def lags(self) -> int:
        """Maximum number of frames between two compared ones."""
        return len(self.moved)


def image_motion(clip: Clip, masks: Masks, lags: int) -> ImageMotion:
    """Measure the object's motion in the image over 1 to ``lags`` frames.

    Without ``clip.world`` the camera is assumed to be static.
    """
    T = len(clip)
    moved, by_camera = np.full((lags, T), np.nan), np.zeros((lags, T))
    contour = [visible_contour(o, i) for o, i in zip(masks.object, masks.ignore, strict=True)]
    boxes = bounding_boxes(masks.object)
    depth = float(np.median(se3.transform(clip.hand.T_cam_hand, clip.hand.vertices.mean(axis=1)[:, None])[:, 0, 2]))
    for t in range(1, T):
        for lag in range(1, min(lags, t) + 1):
            s = t - lag
            length = (contour[s] + contour[t]) / 2.0
            if min(contour[s], contour[t]) < MIN_VISIBLE_CONTOUR_PX:
                continue
            window = _enlarged_window(boxes[[s, t]], clip.size)
            homographies = _homographies(clip, s, t, depth)
            moved[lag - 1, t] = min(_count_differing_pixels(masks, s, t, H, window) / length for H in homographies)
            middle = (boxes[s, :2] + boxes[s, 2:]) / 2.0
            by_camera[lag - 1, t] = _displacement(homographies[len(homographies) // 2], middle)
    return ImageMotion(moved, by_camera)


def visible_contour(object_: Bool[ndarray, "H W"], ignore: Bool[ndarray, "H W"]) -> float:
    """Return the length of a mask's border with visible background [px]."""
    rows, cols = np.flatnonzero(object_.any(axis=1)), np.flatnonzero(object_.any(axis=0))
    if not rows.size:
        return 0.0
    box = slice(max(rows[0] - 1, 0), rows[-1] + 2), slice(max(cols[0] - 1, 0), cols[-1] + 2)
    mask, outside = object_[box], ~(object_[box] | ignore[box])
    across = (mask[:, 1:] & outside[:, :-1]) | (mask[:, :-1] & outside[:, 1:])
    down = (mask[1:] & outside[:-1]) | (mask[:-1] & outside[1:])
    # On average a line crosses 4 / pi as many pixel borders as its length.
    return float(across.sum() + down.sum()) * np.pi / 4.0


def _enlarged_window(boxes: Int[ndarray, "n 4"], size: tuple[int, int]) -> Window:
    """Return the window around boxes, enlarged by half their size on each side, within the image."""
    low, high = boxes[:, :2].min(axis=0), boxes[:, 2:].max(axis=0)
    edge = (high - low) // 2
    (left, top), (right, bottom) = np.maximum(low - edge, 0), np.minimum(high + edge, size)
    return int(left), int(top), int(right), int(bottom)


def _homographies(clip: Clip, s: int, t: int, depth: float) -> list[Float[ndarray, "3 3"] | None]:
    """Homographies of a static plane from frame s to frame t, for each depth; None for the identity."""
    same = np.array_equal(clip.K[s], clip.K[t])
    if clip.world is None:
        return [None] if same else [clip.K[t] @ np.linalg.inv(clip.K[s])]
    T_ts = se3.inverse(clip.world.T_world_cam[t]) @ clip.world.T_world_cam[s]
    R, shift = T_ts[:3, :3], T_ts[:3, 3]
    if same and np.abs(R - np.eye(3)).max() < CAMERA_MOTION_TOLERANCE and np.abs(shift).max() < CAMERA_MOTION_TOLERANCE:
        return [None]
    K_s = np.linalg.inv(clip.K[s])
    return [clip.K[t] @ (R + np.outer(shift, [0.0, 0.0, 1.0 / (d * depth)])) @ K_s for d in RELATIVE_DEPTHS]


def _displacement(H: Float[ndarray, "3 3"] | None, uv: Float[ndarray, "2"]) -> float:
    if H is None:
        return 0.0
    x, y, w = H @ [*uv, 1.0]
    return float(np.hypot(x / w - uv[0], y / w - uv[1]))


def _count_differing_pixels(masks: Masks, s: int, t: int, H: Float[ndarray, "3 3"] | None, window: Window) -> float:
    """Count the pixels of a window in which two masks differ and none is hidden; the first is warped by H."""
    left, top, right, bottom = window
    box = slice(top, bottom), slice(left, right)
    if H is None:
        earlier, hidden = masks.object[s][box], masks.ignore[s][box]
    else:
        labels = (masks.ignore[s] * np.uint8(2)) | masks.object[s].astype(np.uint8)
        # OpenCV's origin is the centre of the first pixel, this package's its corner.
        into = np.array([[1.0, 0.0, -0.5 - left], [0.0, 1.0, -0.5 - top], [0.0, 0.0, 1.0]])
        from_centre = np.array([[1.0, 0.0, 0.5], [0.0, 1.0, 0.5], [0.0, 0.0, 1.0]])
        size = right - left, bottom - top
        moved = cv2.warpPerspective(labels, into @ H @ from_centre, size, flags=cv2.INTER_NEAREST)
        earlier, hidden = (moved & 1) > 0, moved == 2
    return float(np.count_nonzero((earlier ^ masks.object[t][box]) & ~(hidden | masks.ignore[t][box])))
