"""Hidden joints: they are behind the object or the hand itself, not in front of the background.

A joint away from all pixels of hand and object would be visible. So each joint costs its distance from the pixels that
can hide it, by the same robust cost as a click (``rigid_pnp``).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from getagrip.hands.from_2d.rigid_pnp import CLICK_OUTLIER_SIGMAS, project_hand_joints

MAX_DISTANCE_IMAGE_PX = 320
"""Maximum side of the images of distances [px]."""


class OcclusionDistances(NamedTuple):
    """Distances from the pixels that show a hand or can hide it, in n frames."""

    distance: Float[ndarray, "n h w"]
    """Distance of each pixel [px of the video]; zero in frames without masks."""
    zoom: float
    """Pixels of ``distance`` per pixel of the video."""

    @staticmethod
    def of(possible: Bool[ndarray, "n h w"], zoom: float) -> OcclusionDistances:
        """Measure distances from the ``possible`` pixels, in images scaled by ``zoom``."""
        import cv2

        off = [cv2.distanceTransform((~each).astype(np.uint8), cv2.DIST_L2, 5) / zoom for each in possible]
        known = np.asarray(possible.any(axis=(1, 2)))
        return OcclusionDistances(np.where(known[:, None, None], np.array(off).reshape(possible.shape), 0.0), zoom)

    def take(self, rows: ndarray) -> OcclusionDistances:
        """Return the distances of some frames."""
        return self._replace(distance=self.distance[rows])

    def at(self, uv: Float[ndarray, "n k 2"]) -> tuple[Float[ndarray, "n k"], Float[ndarray, "n k 2"]]:
        """Return the distance at points [px], and its derivative; both zero outside the image."""
        n, h, w = self.distance.shape
        if not (n and h > 1 and w > 1):
            return np.zeros(uv.shape[:2]), np.zeros(uv.shape)
        x, y = np.moveaxis(np.nan_to_num(uv * self.zoom - 0.5, posinf=-2.0, neginf=-2.0), -1, 0)
        inside = (x > 0.0) & (x < w - 1.0) & (y > 0.0) & (y < h - 1.0)
        i, j = (np.clip(np.floor(v), 0, size - 2).astype(int) for v, size in ((x, w), (y, h)))
        a, b = np.where(inside, x - i, 0.0), np.where(inside, y - j, 0.0)
        row = np.arange(n)[:, None]
        p, q, r, s = (self.distance[row, j + dy, i + dx] for dy in (0, 1) for dx in (0, 1))
        value = (1.0 - b) * ((1.0 - a) * p + a * q) + b * ((1.0 - a) * r + a * s)
        slope = np.stack([(1.0 - b) * (q - p) + b * (s - r), (1.0 - a) * (r - p) + a * (s - q)], axis=-1)
        return np.where(inside, value, 0.0), self.zoom * np.where(inside[..., None], slope, 0.0)

    def equations(
        self,
        K: Float[ndarray, "3 3"],
        noise: Float[ndarray, "n 21"],
        T: Float[ndarray, "n 4 4"],
        X: Float[ndarray, "n 21 3"],
        J: Float[ndarray, "n 21 3 D"],
    ) -> tuple[Float[ndarray, "n"], Float[ndarray, "n D D"], Float[ndarray, "n D"]]:
        """Compute each frame's cost, J^T J and J^T r, as ``click_equations`` does for clicks."""
        uv, by_joint = project_hand_joints(K, T, X, J)
        off, slope = self.at(uv)
        r = off / noise
        A = (slope[..., None, :] @ by_joint)[..., 0, :] / noise[..., None]
        weighted = A / (1.0 + r * r / CLICK_OUTLIER_SIGMAS**2)[..., None]
        costs = CLICK_OUTLIER_SIGMAS**2 * np.sum(np.log1p(r * r / CLICK_OUTLIER_SIGMAS**2), axis=1)
        return costs, np.swapaxes(weighted, 1, 2) @ A, (r[:, None] @ weighted)[:, 0]
